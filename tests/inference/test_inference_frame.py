"""A stated frame is taken off the displacement, and a machine that nobody has is said."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import draw, handle_for, small_recipe, state_of, true_segmentation

import tissueid
from tissueid.inference.frame_effect import beyond_calibration, machine_flags, tip_handles
from tissueid.inference.specimen import FitOptions
from tissueid.manifest import FrameCurve
from tissueid.model.channels import loading_force
from tissueid.model.frame import linear_frame
from tissueid.model.grammar import rebuilt
from tissueid.model.states import branch_states
from tissueid.pipeline import IdentifyOptions
from tissueid.priors import CALIBRATION_DEFAULTS, CalibrationPrior
from tissueid.synth import Branch, as_trials
from tissueid.trial import Source, Trial

STIFFNESS = 200.0
TISSUE = (Branch((30.0,), 0.2),)
#: A frame whose compliance falls from 0.01 to 0.002 mm/N over the first 100 N.
FALLING = FrameCurve(np.array([0.0, 100.0]), np.array([0.01, 0.002]), np.zeros((2, 2)))


def recorded(seed=1, sigma=0.2, give=lambda force: force / STIFFNESS):
    """Recordings, the same behind a frame (the crosshead travels further by what it gives), and handles."""
    recipe = small_recipe(branches=TISSUE, sigma_N=sigma)
    trials = as_trials(draw(recipe, seed))
    quiet = as_trials(draw(replace(recipe, sigma_N=0.0), seed))
    behind = [
        replace(trial, displacement_mm=trial.displacement_mm + give(clean.force_N))
        for trial, clean in zip(trials, quiet, strict=True)
    ]
    pairs = zip(behind, quiet, strict=True)
    return trials, behind, [handle_for(trial, true_segmentation(clean)) for trial, clean in pairs]


def test_a_nonlinear_frame_is_taken_off_as_it_was_calibrated():
    def give(force):
        """Integral of a compliance that falls from 0.01 to 0.002 mm/N over the first 100 N."""
        below = np.minimum(force, 100.0)
        return 0.01 * below - 0.5 * 8e-5 * below**2 + 0.002 * np.maximum(force - 100.0, 0.0)

    trials, _, handles = recorded(3, 0.0, give)
    for trial, handle in zip(trials, tip_handles(handles, FALLING), strict=True):
        # the smoothing law is another one in the tip's travel: some 0.1 N of 200 N, behind 100 N/mm
        assert np.abs(handle.load().displacement_mm - trial.displacement_mm).max() < 5e-3


def test_the_tip_is_where_it_was():
    trials, behind, handles = recorded()
    said = []
    found = tip_handles(handles, linear_frame(STIFFNESS), said.append)
    for trial, before, bent, handle in zip(trials, behind, handles, found, strict=True):
        tip = handle.load()
        assert handle.facts.depth_mm < bent.facts.depth_mm
        speeds = (one.segmentation.of_kind("ramp")[0].speed_mm_s for one in (handle, bent))
        assert next(speeds) < 1.0001 * next(speeds)
        np.testing.assert_array_equal(tip.force_N, trial.force_N)
        assert np.abs(before.displacement_mm - trial.displacement_mm).max() > 0.2
        off = tip.displacement_mm - trial.displacement_mm
        # noise of 0.2 N behind 200 N/mm is 1e-3 mm: of it, a law of fifteen parameters lets little through
        assert np.abs(off).max() < 1e-3
        assert off.std() < 3e-4
        (flag,) = [flag for flag in tip.flags if flag.code == "frame_corrected"]
        given_mm = float(np.ptp(before.displacement_mm - trial.displacement_mm))
        assert flag.values["deflection_mm"] == pytest.approx(given_mm, rel=0.02)
    assert said == ["the frame"]


def test_a_corrected_fit_is_that_of_the_tissue():
    _, _, handles = recorded(seed=2)

    def tau(logs):
        fit = state_of(logs, static="shared").fit
        return fit.parameter("relaxation_time_s"), fit.parameter("viscosity_N_s_per_mm")

    rigid, eta = tau(tip_handles(handles, linear_frame(STIFFNESS)))
    assert abs(rigid.value - 0.2) <= 4.0 * rigid.stderr
    assert abs(eta.value - 6.0) <= 4.0 * eta.stderr
    bent, _ = tau(handles)
    assert abs(bent.value - 0.2) > 10.0 * bent.stderr


def test_forces_far_beyond_the_calibration_are_told():
    curve = replace(FALLING, range_N=(5.0, 100.0))
    assert [beyond_calibration(curve, force) for force in (149.0, 151.0)] == [False, True]
    assert not beyond_calibration(linear_frame(STIFFNESS), 1e9)


FRAME = "frame_compliance_mm_per_N"


@pytest.mark.parametrize(
    ("machine", "name", "words"),
    [
        ((0.0, 0.0, 0.0581), "force_filter_s", "a force filter of 58.1 ms, 11.6 standard deviations off"),
        ((0.0, -0.0131, 0.0), "skew_s", "channels 13.1 ms apart, 6.5 standard deviations off"),
        ((0.0152, 0.0, 0.0), FRAME, "a frame of 65.8 N/mm, 3.8 standard deviations off"),
        # a soft frame is no surprise by itself, one that takes a third of the travel is
        ((0.009, 0.0, 0.0), FRAME, "a frame of 111 N/mm, which would take 29 % of the travel"),
    ],
)
def test_a_machine_that_is_unlikely_is_named_with_its_size(machine, name, words):
    (flag,) = machine_flags(np.array(machine), CALIBRATION_DEFAULTS, force_N=260.0, depth_mm=8.0)
    assert (flag.message, flag.values["name"]) == (f"the fit needs {words}", name)


def test_an_ordinary_machine_and_a_stated_soft_frame_are_not():
    stated = {**CALIBRATION_DEFAULTS, FRAME: CalibrationPrior(0.009, 0.0005, stated=True)}
    for machine, priors, force, depth in (
        ((0.003, 0.004, 0.008), CALIBRATION_DEFAULTS, 20.0, 8.0),
        # of an ordinary machine: a stiff specimen takes little of the travel, which is no miss of the law
        ((0.00067, 0.0, 0.0), CALIBRATION_DEFAULTS, 390.0, 1.0),
        ((0.009, 0.0, 0.0), stated, 260.0, 8.0),
    ):
        assert not machine_flags(np.array(machine), priors, force_N=force, depth_mm=depth)


@pytest.mark.parametrize(("model", "raised"), [("power * prony", True), ("kelvin-voigt", False)])
def test_a_law_that_leans_on_the_machine_says_so(datasets, model, raised):
    (log,) = tissueid.read(datasets / "paper-a-hold-100Hz")
    (fit,) = tissueid.identify([log], options=IdentifyOptions(fit=FitOptions(model=model))).specimens
    assert ("machine_implausible" in {flag.code for flag in fit.flags}) is raised
    # the depth that is claimed is the tip's: behind such a frame no travel of 8 mm was 8 mm of tissue
    assert (fit.depth_mm < 7.0) is raised
    model = rebuilt(fit.model, fit.depth_mm)
    force = loading_force(model, fit.theta, np.array([fit.depth_mm]), speed_mm_s=fit.speeds_mm_s[1])
    assert force[0] == pytest.approx(266.0, rel=0.2)


@pytest.mark.parametrize(("linear", "cubic"), [(40.0, 2000.0), (100.0, 8000.0)])
def test_a_frame_softer_than_the_tissue_leads_no_step_astray(linear, cubic):
    """Ramps of 1 to 100 s; a soft frame stands for the branches that the law lacks."""
    rng, trials = np.random.default_rng(1), []
    for ramp_s in (1.0, 10.0, 100.0):
        time = np.arange(200) * 0.01 * ramp_s
        depth = np.minimum(time / ramp_s, 1.0) * 0.24
        elastic = linear * depth + cubic * depth**3
        force = elastic + 0.1 * rng.normal(size=time.size)
        relaxing = branch_states(time, elastic, np.array([0.1, 0.6, 6.0, 40.0]))
        force += np.array([2.0, 1.0, 3.0, 2.0]) @ relaxing
        trials.append(Trial("soft", time, depth, force, source=Source(f"ramp-{ramp_s:g}.csv")))
    options = IdentifyOptions(fit=FitOptions(static="shared", model="polynomial * tangent * prony:1"))
    (fit,) = tissueid.identify(trials, options=options).specimens
    assert max(trial.nrmsd.range for trial in fit.trials) < 0.05
