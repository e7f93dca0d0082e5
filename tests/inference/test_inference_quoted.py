"""Quoted numbers of a fit: right, with honest errors, and silent beyond what was seen."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import handles_of, small_recipe, state_of

from tissueid.flags import warning_line
from tissueid.inference.quoted import depth_test
from tissueid.measured.geometry import Geometry, stated_geometry
from tissueid.model.functionals import complex_stiffness, force_after_ramp
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.moduli import Indenter, contact_of
from tissueid.synth import Branch, Hold, Log, Move

TRUE = Branch((30.0,), 0.2)
MODEL = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=4.0)
THETA = MODEL.join(np.array([20.0, -1.2, 0.35]), np.array([[30.0]]), np.array([0.2]))


def fitted(seed=0, recipe=None, **options):
    plan = recipe or small_recipe(branches=(TRUE,))
    # the machine is the truth's: errors of these numbers are those of the noise
    return state_of(handles_of(plan, seed), **{"static": "shared", **options}).fit


def find(numbers, name, **at):
    named = [one for one in numbers if one.name == name]
    (one,) = [one for one in named if all(getattr(one.at, key) == value for key, value in at.items())]
    return one


@pytest.fixture(scope="module")
def fit():
    return fitted(geometry=Geometry(Indenter("sphere", 3.0), thickness_mm=20.0))


def truths():
    def relaxed(speed, time):
        after, peak = (force_after_ramp(MODEL, THETA, 4.0, speed, since) for since in (time, 0.0))
        return 1.0 - after / peak

    storage, loss = complex_stiffness(MODEL, THETA, 2.0, 1.0)
    return {
        ("fraction_relaxed", ("path", "step"), ("time_s", 1.0)): relaxed(None, 1.0),
        ("fraction_relaxed", ("path", "ramp"), ("time_s", 0.1)): relaxed(4.0, 0.1),
        ("storage_stiffness", ("frequency_Hz", 1.0)): storage,
        ("tan_delta", ("frequency_Hz", 1.0)): loss / storage,
        ("dissipated_energy", ("frequency_Hz", 1.0)): np.pi * 0.4**2 * loss,
        ("equilibrium_secant", ("depth_mm", 4.0)): 20.0 - 4.8 + 5.6,
        ("instantaneous_tangent", ("depth_mm", 2.0)): 20.0 - 4.8 + 4.2 + 30.0,
    }


def test_model_numbers_are_the_truth_within_their_errors(fit):
    for (name, *at), truth in truths().items():
        one = find(fit.quoted.model, name, **dict(at))
        assert abs(one.value - truth) < 4.0 * one.stderr, name
        assert one.stderr < 0.02 * abs(truth), name


@pytest.mark.slow
def test_errors_of_model_numbers_are_their_spread():
    table = {key: [] for key in truths()}
    claimed = {}
    for seed in range(60):
        found = fitted(seed)
        for name, *at in table:
            one = find(found.quoted.model, name, **dict(at))
            table[name, *at].append(one.value)
            claimed[name, *at] = one.stderr
    for key, values in table.items():
        # 60 draws know a spread to 9 %
        assert np.std(values, ddof=1) == pytest.approx(claimed[key], rel=0.3), key


def test_measured_and_modelled_fractions_agree(fit):
    model = find(fit.quoted.model, "fraction_relaxed", path="ramp", time_s=1.0)
    holds = [hold for trial in fit.trials for hold in trial.measured.holds if hold.push is not None]
    nearest = min(holds, key=lambda one: abs(one.push.depth_mm - model.at.depth_mm))
    measured = 1.0 - nearest.at(1.0).after_stop_N / nearest.push.peak.force_N
    # 0.2 N of noise on a peak of some 90 N: 3 sd of a single sample
    assert measured == pytest.approx(model.value, abs=6e-3)


def test_nothing_is_said_beyond_the_hold_nor_between_two_samples(fit):
    assert fit.quoted.window_s == pytest.approx(3.0, abs=0.011)
    assert fit.quoted.resolution_s == pytest.approx(0.02)
    for path in ("step", "ramp"):
        late = find(fit.quoted.model, "fraction_relaxed", path=path, time_s=10.0)
        assert late.value is None
        assert "were seen" in late.reason
    frequencies = {one.at.frequency_Hz for one in fit.quoted.model if one.name == "tan_delta"}
    assert frequencies == {0.1, 0.3, 1.0, 3.0}
    asked = fitted(frequencies_Hz=(1.0, 50.0)).quoted.model
    assert find(asked, "tan_delta", frequency_Hz=1.0).value is not None
    assert "outside" in find(asked, "tan_delta", frequency_Hz=50.0).reason


SLOW = small_recipe(branches=(Branch((30.0,), 4.0),), sigma_N=0.05)
#: One slow ramp: the branch is a straight line beside the static force.
STRAIGHT = small_recipe(
    branches=(Branch((5.0,), 0.01),), sigma_N=2.0, logs=(Log("slow", (Move(4.0, 30.0), Hold(2.0))),)
)


@pytest.mark.parametrize(
    ("recipe", "name", "at", "reason"),
    [
        (SLOW, "peak_to_plateau", {"path": "step"}, "plateau was not seen"),
        (STRAIGHT, "loss_stiffness", {"frequency_Hz": 3.0}, "determine"),
    ],
)
def test_what_the_data_do_not_determine_is_null_with_its_reason(recipe, name, at, reason):
    one = find(fitted(recipe=recipe).quoted.model, name, **at)
    assert one.value is None
    assert reason in one.reason


def test_without_a_hold_the_ramp_s_relaxation_is_not_invented():
    plan = small_recipe(branches=(TRUE,))
    quoted = fitted(recipe=replace(plan, logs=plan.logs[:3])).quoted
    assert all(one.value is None for one in quoted.model if one.at.path == "ramp")
    assert quoted.spectra == ()


def test_a_law_without_force_at_a_hold_has_no_fractions_there():
    state = state_of(handles_of(small_recipe(branches=(TRUE,)), 0))
    nothing = np.zeros_like(state.tissue.theta)
    nothing[-1] = 0.2
    quoted, _ = state.quoted(replace(state.tissue, theta=nothing))
    for one in quoted.model:
        if one.name in {"fraction_relaxed", "peak_to_plateau", "tan_delta"}:
            assert one.value is None
            assert one.reason


def test_moduli_are_forces_over_the_tip_s_geometry(fit):
    tip = Indenter("sphere", 3.0)
    depth = fit.depth_mm
    for formula in ("hayes", "dimitriadis", "hertz", "sneddon"):
        contact = contact_of(formula, tip, depth, poisson=0.5, thickness_mm=20.0)
        static = 20.0 * depth - 1.2 * depth**2 + 0.35 * depth**3
        for name, force in (("equilibrium", static), ("instantaneous", static + 30.0 * depth)):
            one = find(fit.quoted.moduli, f"modulus_{name}", formula=formula, depth_mm=depth)
            assert one.value == pytest.approx(1000.0 * contact.modulus_MPa(force), rel=0.01)
            assert one.unit == "kPa"
    (out,) = [flag for flag in fit.flags if flag.code == "modulus_out_of_range"]
    assert out.values["formulas"] == ["hayes", "dimitriadis", "hertz", "sneddon"]
    # the thickness is stated: that is no way out
    assert "thickness" not in warning_line(out.code, out.message)
    assert fit.quoted.assumptions.poisson == 0.5


def test_drainage_under_a_small_tip_is_warned_of(fit):
    tiny = fitted(geometry=Geometry(Indenter("flat", 0.02)))
    flag = next(flag for flag in tiny.flags if flag.code == "poroelastic")
    # a^2/D for D of 1e-2 and 1e-5 mm2/s
    assert (flag.values["from_s"], flag.values["to_s"]) == pytest.approx((0.04, 40.0))
    assert not [flag for flag in fit.flags if flag.code == "poroelastic"]


def test_without_a_tip_there_is_no_modulus():
    assert fitted().quoted.moduli == ()
    assert stated_geometry({}, 10.0, 0.5) is None
    assert stated_geometry({"shape": "other"}, 10.0, 0.5) is None
    known = stated_geometry({"shape": "flat", "radius_mm": 2.0, "material": "steel"}, 10.0, 0.4)
    assert known == Geometry(Indenter("flat", 2.0), 10.0, 0.4)
    for wrong, said in (({"poisson": 0.7}, "Poisson"), ({"thickness_mm": -1.0}, "thickness")):
        with pytest.raises(ValueError, match=said):
            Geometry(Indenter("flat", 2.0), **wrong)


DEPTHS = np.repeat([1.0, 2.0, 4.0, 8.0], 2)
BALL = Geometry(Indenter("sphere", 20.0))


def scattered(times: np.ndarray, sd: float = 0.05) -> list[float]:
    return list(times * np.exp(sd * np.random.default_rng(3).standard_normal(times.size)))


@pytest.mark.parametrize(
    ("depths", "times", "verdict"),
    [
        (DEPTHS, scattered(0.4 * DEPTHS), "drainage"),
        (DEPTHS, scattered(np.full(8, 0.4)), "viscous"),
        (DEPTHS, scattered(0.4 * DEPTHS**0.5), "neither"),
        ([1.0, 2.0, 4.0], [0.2, 3.0, 0.4], "can't decide"),
    ],
)
def test_the_slope_decides(depths: list[float], times: list[float], verdict: str) -> None:
    slope, flags = depth_test(BALL, list(depths), times)
    assert slope.at.verdict == verdict
    assert slope.at.low <= slope.value <= slope.at.high
    assert [flag.code for flag in flags] == ["poroelastic"] * (verdict == "drainage")


def test_without_two_contacts_there_is_no_test_and_a_buried_tip_says_so() -> None:
    slope, flags = depth_test(Geometry(Indenter("sphere", 5.0)), [1.0, 2.0, 4.0], [1.0, 2.0, 4.0])
    assert (slope.value, flags) == (None, ())
    assert "4 mm of depth, 5 mm of radius" in slope.reason
    three, flat = [1.0, 2.0, 4.0], Geometry(Indenter("flat", 5.0))
    for geometry, depths in ((None, three), (flat, three), (BALL, [4.0, 4.0, 4.0]), (BALL, [1.0, 4.0])):
        assert depth_test(geometry, depths, [1.0] * len(depths)) == (None, ())
