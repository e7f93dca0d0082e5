"""Truths follow their priors, their numbers are the model's own, and recordings are those of closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from law_cases import LAWS, SPECTRUM, law_bundle
from scipy.stats import kstest

from tissueid.errors import BundleError, InputError
from tissueid.model.base import ContactPath
from tissueid.model.channels import loading_force
from tissueid.model.grammar import parsed
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.priors import CALIBRATION_DEFAULTS, Priors, SpreadPrior
from tissueid.selfcheck import truth as draws
from tissueid.selfcheck.protocol import Centre, Protocol, of_bundle, of_program
from tissueid.selfcheck.tissue import TissueCheck, tissue_check
from tissueid.selfcheck.truth import ProtocolLog, Widths, centred_priors, noise, recorded_force
from tissueid.synth import Hold, Log, Move
from tissueid.synth.recipe import Branch
from tissueid.synth.simulate import Body, tissue_force
from tissueid.synth.simulate import Path as SynthPath

MODEL = kelvin_voigt(branches=2, stiffness_degree=1, depth_mm=8.0)
THETA = np.array([20.0, -1.2, 0.35, 63.0, 10.0, 0.02, 8.0, 1.0, 0.6])
DRAWN = 2000


def truths(priors: Priors, *, defects: bool = False, pooling: str = "partial", count: int = DRAWN) -> list:
    logs = tuple(ProtocolLog("log", np.arange(2.0), np.arange(2.0), sd) for sd in (0.01, 0.02))
    centre = Centre(MODEL, THETA, sigma_N=0.5, phi=0.9, pooling=pooling)
    check = tissue_check(Protocol("two logs", logs, (1.0, 1.0)), centre, defects=defects)
    check = replace(check, priors=priors)
    rng = np.random.default_rng(17)
    return [check.truth(rng) for _ in range(count)]


def priors_for(**options: object) -> Priors:
    return centred_priors(MODEL, THETA, sigma_N=0.5, phi=0.9, **options)


def test_truths_are_passive_ascending_and_follow_their_priors():
    priors = priors_for()
    found = truths(priors)
    theta = np.array([one.theta for one in found])
    assert all(MODEL.is_passive(row) for row in theta)
    assert (theta[:, 5] < theta[:, 8]).all()
    # far from the cone's faces the cut takes nothing: three coefficients of F_s are normal
    for k, name in enumerate(MODEL.parameter_names[:3]):
        mean, sd = priors.linear[name]
        assert kstest((theta[:, k] - mean) / sd, "norm").pvalue > 1e-4, name
    ln_tau = np.log(theta[:, 5] / 0.02) / priors.relaxation_time_s[0].sd_ln
    assert kstest(ln_tau, "norm").pvalue > 1e-4
    assert kstest([np.log(one.sigma_N / 0.5) / 0.3 for one in found], "norm").pvalue > 1e-4
    low, high = priors.phi
    assert kstest([(one.phi - low) / (high - low) for one in found], "uniform").pvalue > 1e-4
    assert kstest([one.gain_sd / priors.gain_sd for one in found], "halfnorm").pvalue > 1e-4
    assert kstest([one.offset_mm[1] / 0.02 for one in found], "norm").pvalue > 1e-4
    assert kstest([np.log(one.gain[0]) / one.gain_sd for one in found], "norm").pvalue > 1e-4


def test_a_prior_that_reaches_beyond_the_cone_is_cut_there():
    wide = {"stiffness_0_N_per_mm": (0.0, 10.0), "stiffness_1_N_per_mm2": (0.0, 1e-9)}
    stated = Priors(linear={**priors_for().linear, **wide})
    theta = np.array([one.theta for one in truths(priors_for(stated=stated))])
    # a constant K with mean 0 is half-normal once it may not be negative
    assert kstest(theta[:, 3] / 10.0, "halfnorm").pvalue > 1e-4


def test_calibration_nuisances_follow_their_priors_and_are_cut():
    found = truths(priors_for(), defects=True)
    for name, prior in CALIBRATION_DEFAULTS.items():
        values = np.array([(one.calibration[name] - prior.mean) / prior.sd for one in found])
        shape = "halfnorm" if np.isfinite(prior.lower) else "norm"
        assert kstest(values, shape).pvalue > 1e-4, name
    # one tissue for all logs has no gains
    one = truths(priors_for(), pooling="shared", count=1)[0]
    assert (one.calibration, one.gain_sd, one.gain.tolist()) == ({}, 0.0, [1.0, 1.0])


def test_what_a_study_states_stays():
    stated = Priors(
        linear={name: (mean, 2.0) for name, mean in zip(MODEL.parameter_names[:3], THETA[:3], strict=True)},
        relaxation_time_s=(SpreadPrior(0.03, 0.1),),
        sigma_N=SpreadPrior(1.5, 0.05),
        phi=(0.5, 0.6),
        gain_sd=0.2,
    )
    priors = priors_for(stated=stated)
    assert priors.linear["static_2_N_per_mm2"] == (-1.2, 2.0)
    assert priors.relaxation_time_s[0] == SpreadPrior(0.03, 0.1)
    assert priors.relaxation_time_s[1].median == pytest.approx(0.6, rel=1e-12)
    assert (priors.sigma_N, priors.phi, priors.gain_sd) == (SpreadPrior(1.5, 0.05), (0.5, 0.6), 0.2)
    # what it does not state is centred: 20 % of K at full depth over the power of it
    widened = priors_for(stated=stated, widths=Widths(curve=0.2))
    assert widened.linear["stiffness_1_N_per_mm2"] == pytest.approx((10.0, 0.2 * (63.0 + 80.0) / 8.0))


@pytest.mark.parametrize(
    ("stated", "says"),
    [
        (
            {"linear": {"static_1_N_per_mm": (20.0, 1.0)}},
            "states static_1_N_per_mm and not static_2_N_per_mm2, ",
        ),
        (
            {"linear": {"stiffness_0_N_per_mm": (-50.0, 0.1), "stiffness_1_N_per_mm2": (0.0, 0.1)}},
            "leave no passive tissue",
        ),
        ({"relaxation_time_s": (SpreadPrior(10.0, 0.01), SpreadPrior(0.1, 0.01))}, "do not ascend"),
    ],
    ids=["curve in part", "not passive", "times that fall"],
)
def test_priors_that_make_no_tissue_are_refused(stated, says):
    with pytest.raises(InputError, match=says):
        truths(priors_for(stated=Priors(**stated)))


def test_numbers_are_those_of_the_contact_model():
    points = draws.force_points(8.0, (0.5, 8.0))
    assert points == ((2.0, 8.0), (4.0, 2.0), (8.0, 0.5))
    theta = np.array([THETA, THETA * 1.1])
    numbers = draws.numbers_of(MODEL, theta, points)
    for depth, speed in points:
        expected = [loading_force(MODEL, row, np.array([depth]), speed_mm_s=speed)[0] for row in theta]
        # the same closed form, summed in another order
        found = numbers[f"force_N at {depth:.3g} mm, {speed:.3g} mm/s"]
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert numbers["viscosity_N_s_per_mm_b2"][0] == pytest.approx((8.0 + 4.0) * 0.6, rel=1e-12)
    assert numbers["relaxation_time_s"][0] == 0.02


def test_every_prior_is_said_with_its_numbers():
    words = draws.prior_words(priors_for(), correlated=True, pooling="partial", defects=True)
    assert words["static_1_N_per_mm"].startswith("normal, 20 ± ")
    assert words["relaxation_time_s_b2"] == "log-normal, median 0.6, sd of ln 0.4"
    assert words["gain_sd"] == "half-normal, scale 0.05"
    assert words["force_filter_s"] == "normal, 0 ± 0.005, not below 0"
    assert "phi" not in draws.prior_words(priors_for(), correlated=False, pooling="shared", defects=False)


def check_of(name: str, *, stated: Priors | None = None, widths: Widths | None = None) -> TissueCheck:
    logs = (Log("ramp", (Move(4.0, 240.0),)), Log("hold", (Move(4.0, 480.0), Hold(1.0))))
    protocol = of_program(logs, rate_Hz=100.0, contact_sd_mm=0.0, words="two logs")
    model = parsed(name).model(4.0, 0.01, 2.0)
    centre = Centre(model, np.array(LAWS[name]), sigma_N=0.05, pooling="shared")
    return tissue_check(protocol, centre, stated=stated, widths=widths)


@pytest.mark.parametrize("name", LAWS)
def test_truths_are_passive_tissues_around_the_middle_and_are_recorded(name):
    check = check_of(name)
    rng = np.random.default_rng(51)

    truths = [check.truth(rng) for _ in range(60)]

    theta = np.array([one.theta for one in truths])
    model = check.model
    assert all(model.is_passive(one) for one in theta)
    specs = [model.parameters[k] for k in model.shape_places]
    shapes = theta[:, model.shape_places]
    assert (shapes >= [one.lower for one in specs]).all()
    assert (shapes <= [one.upper for one in specs]).all()
    # 15 % for what is no time, 40 % for a time: medians of 60 within three of their errors
    middle = np.median(np.log(shapes), axis=0) - np.log(np.array(LAWS[name])[model.shape_places])
    wide = [0.4 if one.name.startswith("relaxation_time") else 0.15 for one in specs]
    assert (np.abs(middle) < 3.0 * 1.25 * np.array(wide) / np.sqrt(60.0)).all()
    ramp, hold = check.trials(truths[0], rng)
    measured = hold.displacement_mm - hold.displacement_mm[0] + check.logs[1].depth_mm[0]
    force = model.force(theta[0], ContactPath(hold.time_s, np.maximum(measured, 0.0)))
    assert np.sqrt(np.mean((hold.force_N - force) ** 2)) == pytest.approx(truths[0].sigma_N, rel=0.15)
    assert ramp.force_N.max() > 10.0 * truths[0].sigma_N
    assert check.fit.model == name


@pytest.mark.parametrize("name", LAWS)
def test_numbers_that_are_checked_are_those_of_the_law(name):
    check, theta = check_of(name), np.array([LAWS[name], LAWS[name]])

    found = check._numbers(type("Fit", (), {"depth_mm": 4.0})(), theta)

    assert set(check.model.parameter_names) < set(found)
    forces = [value for key, value in found.items() if key.startswith("force_N")]
    slow = np.linspace(0.0, 4.0, 4001)
    dense = check.model.force(theta[0], ContactPath(slow / 4.0, slow))
    # at the largest depth and the slowest speed: 240 mm/min
    assert forces[-1][0] == pytest.approx(dense[-1], rel=1e-3)


def test_a_stated_prior_of_a_shape_stays_within_its_bounds():
    stated = Priors(shapes={"static_exponent": SpreadPrior(1.5, 0.01)})

    check = check_of("power * stretched", stated=stated)

    assert check.priors.shapes["static_exponent"].median == 1.5
    assert check.priors.shapes["relaxation_exponent"].median == LAWS["power * stretched"][4]
    drawn = [check.truth(np.random.default_rng(k)).theta[1] for k in range(20)]
    assert np.std(np.log(drawn)) < 0.02
    beyond = Priors(shapes={"static_exponent": SpreadPrior(9.0, 0.001)})
    with pytest.raises(InputError, match=r"the prior of static_exponent leaves nothing from 0\.5 to 4"):
        check_of("power * stretched", stated=beyond).truth(np.random.default_rng(1))


def test_the_program_of_a_bundle_of_any_law_keeps_its_depth_and_speeds_and_a_spectrum_has_none():
    bundle = law_bundle("power * stretched", LAWS["power * stretched"])
    protocol, centre = of_bundle(bundle, where="bundle.h5")
    assert centre.model.name == "power * stretched"
    assert protocol.depth_mm <= 6.0 * (1.0 + 1e-9)
    assert protocol.speeds_mm_s == (1.0, 4.0)
    with pytest.raises(BundleError, match="its times follow the recordings; fit another law"):
        of_bundle(law_bundle(*SPECTRUM), where="bundle.h5")


HOLD_MODEL = kelvin_voigt(branches=1, stiffness_degree=1, depth_mm=8.0)
HOLD_THETA = np.array([20.0, -1.2, 0.35, 63.62, 10.0, 0.2])
#: 10 N/mm, and nothing that relaxes.
ELASTIC = (kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=8.0), np.array([10.0, 0.0, 0.0, 0.0, 1.0]))
SPEED, CORNER = 4.0, 1.5
TIME = np.arange(0.0, 4.0, 0.01)
DEPTH = np.minimum(SPEED * TIME, SPEED * CORNER)


def log(time: np.ndarray = TIME, depth: np.ndarray = DEPTH) -> ProtocolLog:
    return ProtocolLog("hold", time, depth, 0.01)


def force(
    theta=HOLD_THETA, *, gain: float = 1.0, offset_mm: float = 0.0, one: ProtocolLog | None = None, **defects
):
    return recorded_force(
        HOLD_MODEL, theta, one or log(), gain=gain, offset_mm=offset_mm, calibration=defects
    )


def oracle(path: SynthPath, *, offset_mm: float) -> np.ndarray:
    """The closed form, which shares no code with the contact model."""
    return tissue_force(path, TIME, Body((20.0, -1.2, 0.35), (Branch((63.62, 10.0), 0.2),), offset_mm))


@pytest.mark.parametrize("offset_mm", [0.0, 0.053, -0.02])
def test_a_perfect_chain_records_what_the_oracle_computes(offset_mm):
    path = SynthPath(np.array([0.0, CORNER, 4.0]), np.array([0.0, 6.0, 6.0]))
    # closed form against recursion; the tissue is met between two samples, or is indented and relaxed
    np.testing.assert_allclose(force(offset_mm=offset_mm), oracle(path, offset_mm=offset_mm), atol=1e-9)


def test_there_is_no_force_in_air_and_none_of_an_approach():
    # 1 mm in air first: contact at 0.25 s, between two samples where it is offset
    path = SynthPath(np.array([0.0, CORNER + 0.25, 4.0]), np.array([-1.0, 6.0, 6.0]))
    one = log(depth=path.at(TIME))
    for offset in (0.0, 0.033):
        found = force(one=one, offset_mm=offset)
        np.testing.assert_allclose(found, oracle(path, offset_mm=offset), atol=1e-9)
        assert (found[one.depth_mm < offset] == 0.0).all()
    # a filter and a late force begin with the contact, not with the record
    assert (force(one=one, force_filter_s=0.01, skew_s=0.002)[:24] == 0.0).all()


def test_trials_are_what_a_machine_exports():
    truth = draws.Truth(
        HOLD_THETA, np.array([1.0, 1.1]), np.array([1.0, 1.5]), np.array([0.0, 0.02]), 0.3, 0.0, 0.05
    )
    logs = (log(), ProtocolLog("later", TIME - 1.0, DEPTH - 4.0, 0.01))
    centre = Centre(HOLD_MODEL, HOLD_THETA, sigma_N=0.3)
    check = tissue_check(Protocol("two logs", logs, (SPEED, SPEED)), centre)
    trials = check.trials(truth, np.random.default_rng(6))
    assert [trial.name for trial in trials] == ["hold", "later"]
    np.testing.assert_allclose(trials[1].time_s, TIME, atol=1e-12)
    np.testing.assert_array_equal(trials[1].displacement_mm, logs[1].depth_mm)
    for trial, one, gain, slower, offset in zip(
        trials, logs, truth.gain, truth.slower, truth.offset_mm, strict=True
    ):
        own = np.where(np.arange(HOLD_THETA.size) == HOLD_MODEL.time_places, slower, 1.0) * HOLD_THETA
        left = trial.force_N - force(own, one=one, gain=gain, offset_mm=offset)
        # standard error of an sd of 400 samples is 0.01
        assert left.std() == pytest.approx(0.3, abs=0.04)
    # and in air, of 100 samples
    assert trials[1].force_N[logs[1].depth_mm < 0.0].std() == pytest.approx(0.3, abs=0.08)


def test_gains_of_logs_and_channels_and_a_delay_act_on_the_force():
    np.testing.assert_allclose(force(gain=1.1), 1.1 * force(), rtol=1e-12)
    np.testing.assert_allclose(force(force_gain=1.02), 1.02 * force(), rtol=1e-12)
    # 8 mm recorded by a channel that reads 2 % too much are 8 / 1.02 mm
    smaller = log(depth=DEPTH / 1.02)
    np.testing.assert_allclose(force(displacement_gain=1.02), force(one=smaller), rtol=1e-12)
    # two samples late, between corners; sub-steps are joined by lines
    np.testing.assert_allclose(force(skew_s=0.02)[10:140], force()[8:138], atol=2e-3)


def test_a_filtered_ramp_lags_by_its_time_constant_on_any_clock():
    uneven = np.sort(np.concatenate([[0.0], np.random.default_rng(4).uniform(0.0, 1.4, 300)]))
    for time in (TIME[TIME < CORNER], uneven):
        one = log(time, SPEED * time)
        found = recorded_force(*ELASTIC, one, gain=1.0, offset_mm=0.0, calibration={"force_filter_s": 0.03})
        # low-pass of a ramp from rest: rate (t - tau (1 - exp(-t / tau)))
        expected = 10.0 * SPEED * (time + 0.03 * np.expm1(-time / 0.03))
        np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("give", [0.0005, 0.004, 0.02])
def test_the_tip_is_where_the_frame_leaves_it(give):
    found = force(frame_compliance_mm_per_N=give)
    # where the tip is followed between samples it is where every one of ten times as many leaves it
    fine = np.arange(0.0, 3.9901, 0.001)
    one = log(fine, np.interp(fine, TIME, DEPTH))
    finer = force(one=one, frame_compliance_mm_per_N=give)
    expected = HOLD_MODEL.force(HOLD_THETA, ContactPath(fine, one.depth_mm - give * finer))
    np.testing.assert_allclose(finer, expected, atol=2e-4)
    # tips on lines over an eighth of a sample, squared
    np.testing.assert_allclose(found, finer[::10], atol=2e-4)
    assert found.max() < force().max()


def test_noise_is_stationary_with_the_stated_correlation():
    rng = np.random.default_rng(8)
    time = np.arange(40_000) * 0.01
    told = {"sigma_N": 2.0, "reference_step_s": 0.01, "rng": rng}
    found = noise(time, phi=0.9, white_share=0.0, **told)
    # standard error of the sd of an AR(1): sd sqrt((1 + phi^2) / (1 - phi^2) / 2 n)
    assert found.std() == pytest.approx(2.0, abs=4 * 2.0 * np.sqrt(9.5 / 80_000))
    assert np.corrcoef(found[1:], found[:-1])[0, 1] == pytest.approx(0.9, abs=4 * np.sqrt(0.19 / 40_000))
    mixed = noise(time, phi=0.9, white_share=0.5, **told)
    assert np.corrcoef(mixed[1:], mixed[:-1])[0, 1] == pytest.approx(0.45, abs=0.03)
    white = noise(time, phi=0.0, white_share=0.0, **told)
    assert np.corrcoef(white[1:], white[:-1])[0, 1] == pytest.approx(0.0, abs=4 / 200)


def test_noise_on_unequal_steps_loses_correlation_with_time():
    rng = np.random.default_rng(9)
    time = np.concatenate([[0.0, 0.01], 0.03 + np.arange(8) * 0.01])
    told = {"sigma_N": 1.0, "phi": 0.8, "reference_step_s": 0.01, "white_share": 0.0}
    many = np.array([noise(time, **told, rng=rng) for _ in range(20_000)])
    correlation = np.corrcoef(many.T)
    # 0.8 over 10 ms, 0.8^2 over 20 ms; standard error of a correlation
    assert correlation[0, 1] == pytest.approx(0.8, abs=4 * 0.36 / np.sqrt(20_000))
    assert correlation[1, 2] == pytest.approx(0.64, abs=4 * 0.59 / np.sqrt(20_000))
    np.testing.assert_allclose(many.std(axis=0), 1.0, atol=4 / np.sqrt(40_000))
