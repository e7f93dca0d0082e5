"""Tissue and instrument together: exact parts against identities, the density against samples, coverage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from instrument_factory import (
    DEPTH,
    PERFECT,
    QUANTITIES,
    TISSUE,
    Case,
    Specimen,
    covered,
    drawn_instrument,
    drawn_theta,
    every_sample,
    quantities,
    recorded,
    rigid_fit,
    total_of,
)
from scipy.stats import truncnorm

from tissueid.likelihood.instrument_kernels import ALL, instrument_force
from tissueid.likelihood.knot_terms import log_terms, without_effects
from tissueid.likelihood.knots import KnotSums, packed
from tissueid.likelihood.linearise import Optimum
from tissueid.manifest import Calibration, FrameCurve
from tissueid.model.frame import linear_frame
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior.calibration import NUISANCES, TotalPosterior, total_posterior, truncated_moments
from tissueid.posterior.calibration_priors import calibration_priors
from tissueid.posterior.instrument_mode import instrument_mode
from tissueid.priors import CALIBRATION_DEFAULTS, CalibrationPrior, Priors

pytestmark = pytest.mark.needs_jit

EFFECTS = ("gain", "offset")
MODEL = KelvinVoigt(1, 1, DEPTH)
KNOWN = {name: CalibrationPrior(PERFECT[name], 0.0, stated=True) for name in NUISANCES}


def one_specimen(seed: int, case: Case | None = None, **instrument: float) -> Specimen:
    rng = np.random.default_rng(seed)
    case = case or Case()
    return recorded(case, drawn_theta(case.priors, rng), instrument, rng)


def model_static(theta: np.ndarray, depth_mm: float) -> float:
    return float(MODEL.static_force(theta, np.array([depth_mm]))[0])


@pytest.fixture(scope="module")
def soft() -> Specimen:
    """Behind 200 N/mm, 2 ms late, a filter of 4 ms."""
    return one_specimen(1, frame_compliance_mm_per_N=0.005, skew_s=0.002, force_filter_s=0.004)


def test_gains_are_changes_of_scale() -> None:
    """What wrong gains record is what another tissue behind another frame would."""
    rng = np.random.default_rng(2)
    log = recorded(Case(hold_s=1.0), drawn_theta(TISSUE, rng), {}, rng).logs[6]
    gain, stretch, compliance = 1.03, 0.98, 0.002
    theta = np.array([20.0, -1.2, 0.35, 60.0, 10.0])
    powers = DEPTH ** np.array([1.0, 2.0, 3.0, 0.0, 1.0])

    def shown(depth_mm: np.ndarray, tissue: np.ndarray, c: float) -> np.ndarray:
        optimum = Optimum(
            tissue * powers, np.log([0.02]), np.zeros(1), np.zeros(1), np.zeros((1, 4)), DEPTH, 1
        )
        data = every_sample([replace(log, depth_mm=depth_mm)], optimum, ())
        return instrument_force(data, optimum.theta, optimum.log_tau, np.array([1e-3, 2e-3, c]))

    other = theta * gain / stretch ** np.array([1.0, 2.0, 3.0, 1.0, 2.0])
    assert shown(stretch * log.depth_mm, other, compliance * stretch / gain) == pytest.approx(
        gain * shown(log.depth_mm, theta, compliance), rel=1e-9, abs=1e-9
    )


@pytest.fixture(scope="module")
def behind_soft(soft: Specimen) -> TotalPosterior:
    return total_of(soft, 1)


def test_density_on_knots_is_that_on_samples(soft: Specimen, behind_soft: TotalPosterior) -> None:
    """Effects, priors and frame included, at draws of the posterior."""
    total = behind_soft
    optimum, _ = rigid_fit(soft)
    direct = every_sample(soft.logs, optimum, EFFECTS)
    force = np.split(direct.base, direct.first[1:-1])
    samples = []
    for log, one in zip(soft.logs, force, strict=True):
        rows = log.include & ((log.time_s <= log.time_s[-1] - 0.006) | (log.depth_mm[-1] == log.depth_mm[-2]))
        e = np.where(rows, log.force_N - one, 0.0)
        samples.append(
            KnotSums(log.time_s, log.depth_mm, e, rows[:, None].astype(float), float(e @ e), int(rows.sum()))
        )
    behind = total.behind
    data = packed(samples, optimum, EFFECTS)._replace(gamma=behind.data.gamma, delta=behind.data.delta)
    whole = replace(behind, data=data)
    theta = total.theta[:, :5] * DEPTH ** np.array([1.0, 2.0, 3.0, 0.0, 1.0])
    reference = [one.log_density(behind.mode, behind.theta) for one in (behind, whole)]
    differences = []
    for i in range(0, 2_000, 100):
        gains = total.nuisances[i, :2]
        tissue = theta[i] * gains[0] / gains[1] ** np.array([1.0, 2.0, 3.0, 1.0, 2.0])
        point = behind.mode.copy()
        point[:4] = [
            np.log(total.theta[i, 5]),
            *total.nuisances[i, 2:4],
            total.nuisances[i, 4] * gains[1] / gains[0],
        ]
        differences.append(
            [one.log_density(point, tissue) - at for one, at in zip((behind, whole), reference, strict=True)]
        )
    on_knots, on_samples = np.array(differences).T
    # an error of this spread moves no estimate by more than that part of its standard deviation
    assert (on_knots - on_samples).std() < 0.15 * on_samples.std()


def test_instrument_and_tissue_are_found_behind_a_soft_frame(
    soft: Specimen, behind_soft: TotalPosterior
) -> None:
    total = behind_soft
    assert total.sampler.converged
    truth = quantities(soft.theta)[0]
    draws = quantities(total.theta)
    # the frame is seen: its sd is a tenth of its prior's, and the truth within four of them
    frame = total.nuisances[:, NUISANCES.index("frame_compliance_mm_per_N")]
    assert frame.std() < 0.1 * 0.004
    assert frame.mean() == pytest.approx(0.005, abs=4.0 * frame.std())
    assert np.abs(draws.mean(axis=0) - truth).max() > 0.0
    assert (np.abs(draws.mean(axis=0) - truth) < 4.0 * draws.std(axis=0)).all()
    # a rigid fit is wrong by far more than any interval here
    optimum, _ = rigid_fit(soft)
    assert np.exp(optimum.log_tau[0]) > 1.3 * soft.theta[5]


def test_every_draw_is_passive_and_a_seed_repeats_it(soft: Specimen, behind_soft: TotalPosterior) -> None:
    one, two = behind_soft, total_of(soft, 1)
    assert np.array_equal(one.theta, two.theta)
    assert np.array_equal(one.nuisances, two.nuisances)
    assert all(MODEL.is_passive(theta) for theta in one.theta)
    lower = [one.behind.priors.calibration[name].lower for name in NUISANCES]
    assert (one.nuisances >= lower).all()


def test_what_is_known_exactly_stays_where_it_is() -> None:
    case = Case(priors=replace(TISSUE, calibration=KNOWN))
    total = total_of(one_specimen(4, case), 4)
    assert total.nuisances == pytest.approx(np.tile([1.0, 1.0, 0.0, 0.0, 0.0], (2_000, 1)))
    assert [row.stated for row in total.priors] == [True] * 5


def test_knowing_the_instrument_narrows_the_interval() -> None:
    specimen = one_specimen(5)
    known = replace(specimen, case=Case(priors=replace(TISSUE, calibration=KNOWN)))
    wide, narrow = (quantities(total_of(one, 5).theta).std(axis=0) for one in (specimen, known))
    # gains alone are 1 % each; K and tau are as uncertain from noise
    assert (narrow < wide).all()
    static_and_viscosity = [0, 1, 2, 6]
    assert (narrow[static_and_viscosity] < 0.6 * wide[static_and_viscosity]).all()


def test_prior_rows_say_what_the_data_added(behind_soft: TotalPosterior) -> None:
    rows = {row.name: row for row in behind_soft.priors}
    assert tuple(rows) == NUISANCES
    # nothing in a recording tells a gain
    assert abs(rows["force_gain"].shrinkage) < 0.1
    assert rows["frame_compliance_mm_per_N"].shrinkage > 0.8
    assert rows["frame_compliance_mm_per_N"].prior == "normal 0 ± 0.004, not below 0"
    assert not rows["skew_s"].stated


@pytest.mark.parametrize("scatter", [0.02, 0.15])
def test_gains_of_the_logs_do_not_move_the_tissue(scatter: float) -> None:
    """With everything known but 10 gains, the tissue's scale has the posterior of a mean of ln gains."""
    case = Case(gain_sd=scatter, sigma_N=0.1, priors=Priors(calibration=KNOWN))
    rng = np.random.default_rng(7)
    specimen = recorded(replace(case, priors=TISSUE), drawn_theta(TISSUE, rng), {}, rng)
    specimen = replace(specimen, case=replace(case, priors=replace(TISSUE, linear={}, calibration=KNOWN)))
    fit_case = replace(specimen, case=replace(specimen.case, priors=TISSUE))
    optimum, knots = rigid_fit(fit_case)
    total = total_posterior(
        knots, optimum, case.facts, MODEL, specimen.case.priors,
        effects=EFFECTS, gain_sd=float(optimum.gamma.std(ddof=1)), seed=7, draws=4_000,
    )  # fmt: skip
    log_force = np.log(quantities(total.theta)[:, -1])
    powers = DEPTH ** np.array([1.0, 2.0, 3.0, 0.0, 1.0])
    fitted = quantities(np.concatenate([optimum.theta / powers, np.exp(optimum.log_tau)]))[0, -1]
    centre = np.log(fitted) + optimum.gamma.mean()
    spread = optimum.gamma.std(ddof=1) / np.sqrt(10.0)
    # five flat coefficients have a density s^5 in ln s; t with some nine degrees of freedom is wider than
    # a normal by a seventh; the bias of gains that are taken as linear would be -0.5 of the spread
    assert log_force.mean() == pytest.approx(centre + 5.0 * spread**2, abs=0.25 * spread)
    assert log_force.std() == pytest.approx(1.1 * spread, rel=0.3)


@pytest.mark.slow
def test_poolings_and_models_are_all_served() -> None:
    """A log of its own, free cubics, K of degree 2, and two branches: draws are finite and passive."""
    specimen = one_specimen(8, Case(hold_s=2.0))
    optimum, knots = rigid_fit(specimen)
    facts = specimen.case.facts
    own = np.outer(
        np.exp(optimum.gamma), np.concatenate([[0.0], optimum.theta[:3] / DEPTH ** np.arange(1.0, 4.0)])
    )
    cases = []
    alone = replace(optimum, gamma=np.zeros(1), delta=optimum.delta[9:], own=np.zeros((1, 4)))
    last = replace(facts, offset_sd_mm=facts.offset_sd_mm[9:], offset_mean_mm=facts.offset_mean_mm[9:])
    cases.append((knots[9:], alone, last, ("offset",), 1))
    free = replace(optimum, theta=optimum.theta[3:], gamma=np.zeros(10), delta=np.zeros(10), own=own)
    cases.append((knots, free, facts, ("static",), 1))
    bent = replace(optimum, theta=np.append(optimum.theta, 5.0), degree=2)
    cases.append((knots, bent, facts, EFFECTS, 1))
    two = replace(
        optimum,
        theta=np.concatenate([optimum.theta, [2.0, 1.0]]),
        log_tau=np.array([optimum.log_tau[0], 0.0]),
    )
    cases.append((knots, two, facts, EFFECTS, 2))
    for sums, at, known, effects, branches in cases:
        model = KelvinVoigt(branches, at.degree, DEPTH)
        total = total_posterior(
            sums, at, known, model, Priors(), effects=effects, gain_sd=0.02, seed=8, draws=200
        )
        assert np.isfinite(total.theta).all()
        assert total.theta.shape == (200, len(model.parameter_names))
        assert all(model.is_passive(theta) for theta in total.theta)
        # whatever the pooling, the force at 4 mm is that of the tissue to within its gains
        static = model.static_force(total.theta.mean(axis=0), np.array([4.0]))[0]
        assert static == pytest.approx(model_static(specimen.theta, 4.0), rel=0.08)


def test_mode_is_a_maximum_of_the_density(soft: Specimen) -> None:
    optimum, knots = rigid_fit(soft)
    behind = instrument_mode(
        packed(knots, optimum, EFFECTS), optimum, soft.case.facts, MODEL, TISSUE, EFFECTS,
        count=sum(one.count for one in knots), gain_sd=0.02,
    )  # fmt: skip
    top = behind.log_density(behind.mode, behind.theta)
    sd = np.sqrt(np.diag(np.linalg.inv(behind.curvature)))
    falls = []
    for k in range(sd.size):
        for sign in (1.0, -1.0):
            theta, mode = behind.theta.copy(), behind.mode.copy()
            if k < theta.size:
                theta[k] += sign * sd[k]
            else:
                mode[k - theta.size] += sign * sd[k]
            falls.append(top - behind.log_density(mode, theta))
    # one conditional sd or more away; 0.1 is the slope that the last step leaves
    assert min(falls) > -0.1
    assert np.median(falls) > 0.5


@pytest.mark.parametrize(
    "prior",
    [CalibrationPrior(0.0, 0.004, 0.0), CalibrationPrior(0.01, 0.004, 0.0), CalibrationPrior(1.0, 0.01)],
)
def test_moments_of_a_cut_prior(prior: CalibrationPrior) -> None:
    cut = (prior.lower - prior.mean) / prior.sd
    exact = truncnorm(cut, np.inf, loc=prior.mean, scale=prior.sd)
    assert truncated_moments(prior) == pytest.approx((float(exact.mean()), float(exact.std())), rel=1e-9)


def test_priors_of_an_unknown_instrument_are_the_defaults() -> None:
    assert calibration_priors(None) == CALIBRATION_DEFAULTS
    assert dict(calibration_priors(Calibration())) == dict(CALIBRATION_DEFAULTS)


def test_a_study_states_the_instrument() -> None:
    stated = calibration_priors(
        Calibration(
            {
                "load_cell_class": 0.5,
                "displacement_class": 1.0,
                "skew_s": 0.004,
                "skew_s_sd": 0.001,
                "force_filter_s": 0.01,
            }
        )
    )
    assert stated["force_gain"] == CalibrationPrior(1.0, 0.0025, stated=True)
    assert stated["displacement_gain"] == CalibrationPrior(1.0, 0.005, stated=True)
    assert stated["skew_s"] == CalibrationPrior(0.004, 0.001, stated=True)
    assert stated["force_filter_s"] == CalibrationPrior(0.01, 0.002, 0.0, stated=True)
    assert stated["frame_compliance_mm_per_N"] == CALIBRATION_DEFAULTS["frame_compliance_mm_per_N"]


def test_a_filter_stated_as_none_may_still_be_short() -> None:
    assert calibration_priors(Calibration({"force_filter_s": 0.0}))["force_filter_s"].sd == pytest.approx(
        2e-4
    )


def test_a_known_frame_leaves_its_own_uncertainty() -> None:
    frame = calibration_priors(Calibration({}, linear_frame(500.0, 50.0)))["frame_compliance_mm_per_N"]
    assert frame.mean == 0.0
    assert frame.lower == -np.inf
    # sd(1/k) = sd(k) / k^2
    assert frame.sd == pytest.approx(50.0 / 500.0**2)
    bare = calibration_priors(Calibration({}, linear_frame(500.0)))["frame_compliance_mm_per_N"]
    assert bare.sd == pytest.approx(0.25 / 500.0)


def test_a_calibrated_curve_counts_at_the_largest_calibrated_force() -> None:
    covariance = np.diag([1e-8, 4e-8])
    curve = FrameCurve(np.array([0.0, 100.0]), np.array([2e-3, 1e-3]), covariance, range_N=(5.0, 100.0))
    sd = calibration_priors(Calibration({}, curve))["frame_compliance_mm_per_N"].sd
    # u(100) = 50 (c0 + c1)
    assert sd == pytest.approx(np.sqrt(50.0**2 * 5e-8) / 100.0)


def _rates(specimens: int, seed: int, frame_N_per_mm: float | None = None, **case: float) -> np.ndarray:
    """Share of specimens whose total intervals hold the truth, for each of QUANTITIES."""
    how = Case(**case)  # type: ignore[arg-type]
    hits = []
    for i in range(specimens):
        rng = np.random.default_rng([seed, i])
        theta, instrument = drawn_theta(TISSUE, rng), drawn_instrument(TISSUE, rng)
        if frame_N_per_mm is not None:
            instrument["frame_compliance_mm_per_N"] = 1.0 / frame_N_per_mm
        total = total_of(recorded(how, theta, instrument, rng), i)
        hits.append(covered(quantities(total.theta), quantities(theta)[0]))
    return np.mean(hits, axis=0)


def test_total_interval_covers_in_a_few_specimens() -> None:
    rates = _rates(6, 31)
    # of 6 at 95 % fewer than 4 are covered once in 450
    assert dict(zip(QUANTITIES, rates >= 4 / 6, strict=True)) == dict.fromkeys(QUANTITIES, True)
    assert rates.mean() > 0.8


@pytest.mark.slow
@pytest.mark.parametrize("frame_N_per_mm", [200.0, 1_000.0])
def test_total_interval_covers_behind_an_unknown_frame(frame_N_per_mm: float) -> None:
    rates = _rates(300, 32, frame_N_per_mm)
    # lower 99 % bound of the mean over quantities; of each: not below 92 % by more than chance
    assert rates.mean() >= 0.92
    assert rates.min() >= 0.92 - 2.33 * np.sqrt(0.92 * 0.08 / 300)


@pytest.mark.slow
@pytest.mark.parametrize(("phi", "gain_sd"), [(0.0, 0.02), (0.9, 0.02), (0.0, 0.15)])
def test_total_interval_is_calibrated_for_defects_from_their_priors(phi: float, gain_sd: float) -> None:
    rates = _rates(300, 33, phi=phi, gain_sd=gain_sd)
    # ten quantities, family-wise 99 %: 3.3 standard errors
    error = 3.3 * np.sqrt(0.95 * 0.05 / 300)
    assert (np.abs(rates - 0.95) <= error).all()


def pulled(seed: int) -> np.ndarray:
    """How far a recording without noise pulls the posterior from its truth, in standard deviations.

    Tissue (5), ln tau, skew, filter, compliance: a step of Newton from the truth, effects integrated.
    """
    rng = np.random.default_rng(seed)
    truth = drawn_theta(TISSUE, rng)
    defects = drawn_instrument(TISSUE, rng) | {"force_gain": 1.0, "displacement_gain": 1.0}
    exact = recorded(Case(hold_s=1.0, sigma_N=0.0, gain_sd=0.0, offset_sd_mm=0.0), truth, defects, rng)
    specimen = replace(exact, case=Case(hold_s=1.0), logs=exact.logs)
    about, knots = rigid_fit(specimen)
    scales = DEPTH ** np.array([1.0, 2.0, 3.0, 0.0, 1.0])
    logs = len(knots)
    data = packed(knots, about, EFFECTS)._replace(gamma=np.zeros(logs), delta=np.zeros(logs))
    instrument = np.array([defects[name] for name in NUISANCES[2:]])
    curvature, slope, _, _ = without_effects(
        *log_terms(data, truth[:5] * scales, np.log(truth[5:]), instrument, ALL),
        np.ones(logs), np.full((logs, 2), 0.02**-2.0), np.zeros((logs, 2)), 1.0,
    )  # fmt: skip
    # coefficients by powers of u, known to 15 % of the whole force and stiffness
    tissue = 0.15 * np.array([33.0 * DEPTH] * 3 + [143.0] * 2)
    known = [truncated_moments(TISSUE.calibration[name])[1] for name in NUISANCES[2:]]
    covariance = np.linalg.inv(curvature + np.diag(np.concatenate([tissue, [0.4], known]) ** -2.0))
    return np.asarray(covariance @ slope / np.sqrt(np.diag(covariance)))


def test_recordings_without_noise_do_not_pull_the_posterior_from_their_truth() -> None:
    found = np.array([pulled(seed) for seed in range(12)])
    # between knots differences are taken as linear: that much is left of static terms and the frame
    assert np.abs(found.mean(axis=0)).max() < 0.05
    # relaxation time and K: 0.1 where a filter's force goes straight from knot to knot
    assert np.abs(found[:, 3:6].mean(axis=0)).max() < 0.02
