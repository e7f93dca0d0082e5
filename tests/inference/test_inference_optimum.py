"""Constrained steps and optima against scipy and closed forms; priors against the density they stand for."""

from functools import partial

import numpy as np
import pytest
from inference_cases import handles_of, identified, log_data, point_of, ramp_hold, small_recipe, system_of
from scipy.interpolate import BPoly
from scipy.linalg import cho_solve, null_space
from scipy.optimize import minimize

from tissueid.inference.channel_law import kelvin_voigt_law
from tissueid.inference.engine import refit
from tissueid.inference.law import bernstein
from tissueid.inference.noise import Memory
from tissueid.inference.optimum import _factor, covariance_of, minimise, nearest_in_cone, prior_cost
from tissueid.inference.prior import Scatter, calibration_priors, prior_rows, suited, time_bounds
from tissueid.inference.system import SHAPE, Effects
from tissueid.manifest import Calibration, FrameCurve
from tissueid.model.base import ContactPath
from tissueid.model.frame import linear_frame
from tissueid.priors import CALIBRATION_DEFAULTS, WEAK_FACTOR, CalibrationPrior, Priors, SpreadPrior
from tissueid.synth import Hold, Log, Move


@pytest.mark.parametrize("seed", range(12))
def test_the_nearest_point_is_that_of_scipy(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    root = rng.standard_normal((n, n)) * 10.0 ** rng.uniform(-1.0, 1.0, n)[:, None]
    covariance = root @ root.T
    centre = 3.0 * np.sqrt(np.diag(covariance)) * rng.standard_normal(n)
    cone = rng.standard_normal((2 * n, n)) / np.sqrt(np.diag(covariance))
    least = -np.abs(rng.standard_normal(2 * n))
    found = nearest_in_cone(centre, covariance, cone, least)
    assert (cone @ found >= least - 1e-8).all()
    inverse = np.linalg.inv(root)

    def distance(x):
        return float(((inverse @ (x - centre)) ** 2).sum())

    # in whitened coordinates, from the known inside
    there = minimize(
        lambda z: float(z @ z), -inverse @ centre, jac=lambda z: 2.0 * z, method="SLSQP",
        constraints={"type": "ineq", "fun": lambda z: cone @ (centre + root @ z) - least,
                     "jac": lambda z: cone @ root},
        options={"ftol": 1e-12, "maxiter": 500},
    )  # fmt: skip
    # 8: no digit is left to gain
    assert there.status in {0, 8}
    assert distance(found) == pytest.approx(float(there.fun), rel=1e-6, abs=1e-9)
    np.testing.assert_allclose(inverse @ found, inverse @ (centre + root @ there.x), atol=1e-4)


def test_a_point_inside_stays_and_a_bound_that_is_none_is_not_looked_at():
    centre = np.array([1.0, 2.0])
    assert nearest_in_cone(centre, np.eye(2), np.eye(2), np.zeros(2)) is centre
    found = nearest_in_cone(np.array([-1.0, -5.0]), np.eye(2), np.eye(2), np.array([0.0, -1e300]))
    np.testing.assert_allclose(found, [0.0, -5.0], atol=1e-12)


def test_a_covariance_is_the_inverse_and_a_flat_direction_is_wide():
    root = np.random.default_rng(2).standard_normal((4, 4)) * 100.0
    np.testing.assert_allclose(covariance_of(root @ root.T), np.linalg.inv(root @ root.T), rtol=1e-5)
    flat = covariance_of(np.diag([4.0, 0.0]))
    assert flat[0, 0] == pytest.approx(0.25, rel=1e-5)
    assert flat[1, 1] >= 1e5


def fitted(theta, *, start, sigma=0.1, degree=0, seed=1):
    """One log of samples, contact known, from a start."""
    law = kelvin_voigt_law(1, degree, 4.0)
    time, depth = ramp_hold(100.0, 4.0, 4.0, 3.0)
    force = law.model().force(np.asarray(theta), ContactPath(time, depth))
    log = log_data(time, depth, force + sigma * np.random.default_rng(seed).standard_normal(time.size))
    system = system_of([log], law)
    found = minimise(
        system, point_of(law, start),
        partial(prior_rows, system, Scatter(), Priors(), machine=False), machine=False,
    )  # fmt: skip
    return law, system, found


def objective_about(system, found, free):
    """Objective by steps of some shared parameters, in their standard errors, from an optimum."""
    sd = np.sqrt(np.diag(found.covariance))[free]

    def objective(by):
        shared = found.point.shared.copy()
        shared[free] += by * sd
        point = found.point.moved(shared)
        left = (system.force - system.predict(point)) / found.noise.sigma_N
        return float(left @ left) + prior_cost(found.prior, point)

    return objective, sd


def test_the_optimum_is_one_of_the_objective():
    _, system, found = fitted([20.0, -1.2, 0.35, 30.0, 0.2], start=[15.0, 0.0, 0.1, 50.0, 0.5])
    assert found.converged
    assert not found.active.any()
    objective, sd = objective_about(system, found, np.r_[0, 4:8])
    better = minimize(objective, np.zeros(5), method="Nelder-Mead", options={"maxfev": 600})
    # steps end at a hundredth of a standard error
    assert better.fun >= objective(np.zeros(5)) - 0.01
    assert abs(np.exp(found.point.log_times[0]) - 0.2) < 4.0 * 0.2 * sd[0]
    assert found.noise.sigma_N == pytest.approx(0.1, rel=0.12)


def test_an_optimum_on_the_cone_is_passive_and_no_better_point_is():
    # K falls to less than none: the bound holds it
    falling = [20.0, 0.0, 0.0, 30.0, -9.0, 0.2]
    law, system, found = fitted(falling, start=[20.0, 0.0, 0.0, 20.0, 0.0, 0.3], degree=1)
    assert found.active.any()
    assert law.model().is_passive(law.theta(found.point.log_times, found.point.linear)[0])
    free, used = np.r_[0, 4 : 4 + law.linear], found.prior.least > -1e200
    objective, sd = objective_about(system, found, free)
    slack = (found.prior.cone @ found.point.shared - found.prior.least)[used]
    rows = found.prior.cone[used][:, free] * sd
    there = minimize(
        objective, np.zeros(free.size), method="SLSQP",
        constraints={"type": "ineq", "fun": lambda by: slack + rows @ by},
    )  # fmt: skip
    assert objective(np.zeros(free.size)) <= there.fun + 0.02


def test_a_frame_of_which_little_is_known_is_found_along_its_bent_valley():
    """Frame and polynomials trade places over many standard errors before one of them fits worse."""
    plan = small_recipe(rate_Hz=100.0, sigma_N=0.02, logs=(Log("one", (Move(8.0, 240.0), Hold(20.0))),))
    ours = identified(handles_of(plan, 1, sd_mm=0.02), machine=True)
    found, start = ours.optimum, ours.optimum.point.shared
    start[ours.law.times] += 1e-3
    begun = ours.optimum.point.moved(start, ours.optimum.point.own)
    again = refit(ours, machine=True, start=begun, steps=8, noise=found.noise)
    assert found.converged
    assert again.converged
    assert again.normal.objective == pytest.approx(found.normal.objective, abs=0.1)


def test_what_is_held_stays():
    _, system, found = fitted([20.0, -1.2, 0.35, 30.0, 0.2], start=[20.0, -1.2, 0.35, 30.0, 0.2])
    start = found.point.moved(found.point.shared + np.eye(8)[0])
    kept = minimise(
        system, start,
        partial(prior_rows, system, Scatter(), Priors(), machine=False),
        machine=False, held=np.array([0]), noise=found.noise,
    )  # fmt: skip
    assert kept.point.log_times[0] == pytest.approx(start.log_times[0], abs=1e-9)
    assert kept.normal.objective > found.normal.objective + 10.0


def test_logs_own_parameters_are_eliminated_exactly():
    """The Schur complement against the whole problem's inverse."""
    ours = identified(handles_of(small_recipe(cv_both=0.05), 1), pooling="scaled")
    normal, prior = ours.optimum.normal, ours.optimum.prior
    s, (logs, q) = normal.shared.shape[1], ours.optimum.point.own.shape
    whole = np.zeros((s + logs * q, s + logs * q))
    wide = np.zeros((normal.residual.size, s + logs * q))
    wide[:, :s] = normal.shared
    for i in range(logs):
        at = slice(s + i * q, s + (i + 1) * q)
        wide[ours.system.log == i, at] = normal.own[ours.system.log == i]
        whole[at, at] = np.diag(prior.own[i])
    whole[:s, :s] = prior.rows.T @ prior.rows
    whole += wide.T @ wide
    k = np.r_[0 : ours.law.times, ours.law.times + 3 : s]
    every = np.r_[k, s : s + logs * q]
    # shapes have mean zero: what is left of the whole problem is that of the others
    held = np.zeros((SHAPE, s + logs * q))
    for j in range(SHAPE):
        held[j, s + q - SHAPE + j :: q] = 1.0
    free = null_space(held[:, every])
    whole = whole[np.ix_(every, every)]
    expected = (free @ np.linalg.inv(free.T @ whole @ free) @ free.T)[: k.size, : k.size]
    found = np.linalg.inv(normal.hessian[np.ix_(k, k)])
    sd = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / sd / sd[:, None], expected / sd / sd[:, None], atol=1e-6)
    assert ours.optimum.noise.memory == Memory()
    np.testing.assert_allclose(ours.optimum.point.own[:, -SHAPE:].sum(axis=0), 0.0, atol=1e-12)


FRAME = "frame_compliance_mm_per_N"
LAW = kelvin_voigt_law(1, 1, 4.0)
THETA = np.array([20.0, -1.2, 0.35, 60.0, 8.0, 0.5])


def case(effects=None, logs=1):
    time, depth = ramp_hold(100.0, 4.0, 4.0, 3.0)
    log = log_data(time, depth, LAW.model().force(THETA, ContactPath(time, depth)))
    effects = effects or Effects()
    return system_of([log] * logs, LAW, effects=effects), point_of(LAW, THETA, logs=logs, own=effects.size)


@pytest.mark.parametrize("powers", [1, 2, 3, 5])
def test_bernstein_coefficients_are_those_of_the_same_polynomial(powers):
    c = np.random.default_rng(powers).standard_normal(powers)
    u = np.linspace(0.0, 1.0, 17)
    found = BPoly((bernstein(powers) @ c)[:, None], [0.0, 1.0])(u)
    np.testing.assert_allclose(found, np.polynomial.polynomial.polyval(u, c), atol=1e-12)


def test_a_weak_prior_is_of_the_largest_force_and_state():
    system, point = case()
    prior = prior_rows(system, Scatter(), Priors(), point, machine=False)
    state = 4.0 * 0.5 * -np.expm1(-1.0 / 0.5) / 4.0
    sd = WEAK_FACTOR * np.abs(system.force).max()
    static = np.array([80.0, -19.2, 22.4])
    expected = ((bernstein(3) @ static) ** 2).sum() / sd**2
    expected += ((bernstein(2) @ np.array([240.0, 128.0])) ** 2).sum() * state**2 / sd**2
    # the largest state is read at the points of the blocks
    assert prior_cost(prior, point) == pytest.approx(expected, rel=1e-4)


def test_stated_priors_are_standardised():
    system, point = case()
    priors = Priors(
        linear={"static_2_N_per_mm2": (-1.0, 0.5)},
        relaxation_time_s=(SpreadPrior(0.4, 0.3),),
        calibration={"skew_s": CalibrationPrior(0.004, 0.001, stated=True)},
    )
    weak = prior_cost(prior_rows(system, Scatter(), Priors(), point, machine=False), point)
    told = prior_cost(prior_rows(system, Scatter(), priors, point, machine=True), point)
    expected = (-0.2 / 0.5) ** 2 + (np.log(0.5 / 0.4) / 0.3) ** 2 + 4.0**2
    assert told - weak == pytest.approx(expected, rel=1e-9)


def test_bounds_are_the_passive_set_the_times_and_the_machine():
    system, point = case()
    prior = prior_rows(system, Scatter(), Priors(), point, machine=True)
    low, high = time_bounds(system)
    assert (low, high) == pytest.approx((np.log(0.2 * 0.01), np.log(40.0)), abs=0.02)
    rows = [(0, low - 0.01), (0, high + 0.01), (1, -1e-6), (3, -1e-6), (4, -1.0), (7, -1.0)]
    # a skew may have either sign
    for k, value, allowed in (*((*one, False) for one in rows), (0, point.shared[0], True), (2, -0.01, True)):
        moved = np.where(np.arange(point.shared.size) == k, value, point.shared)
        assert bool((prior.cone @ moved >= prior.least).all()) is allowed, k


def test_own_parameters_have_the_scatter_between_logs():
    effects = Effects(gain=True, shape=True)
    system, point = case(effects, logs=2)
    prior = prior_rows(system, Scatter(0.2, 0.03), Priors(), point, machine=False)
    own = np.zeros((2, effects.size))
    own[1] = [0.1, 0.002, 0.2, -0.1]
    moved = point.moved(point.shared, own)
    expected = (0.1 / 0.2) ** 2 + (0.002 / (0.02 / 4.0)) ** 2
    expected += (0.2**2 + 0.1**2) / 0.03**2
    assert prior_cost(prior, moved) - prior_cost(prior, point) == pytest.approx(expected, rel=1e-9)


def test_a_study_states_the_instrument_and_the_rest_has_defaults():
    assert calibration_priors(None) == CALIBRATION_DEFAULTS
    assert dict(calibration_priors(Calibration())) == dict(CALIBRATION_DEFAULTS)
    values = {"load_cell_class": 0.5, "displacement_class": 1.0, "skew_s": 0.004, "skew_s_sd": 0.001}
    assert calibration_priors(Calibration({**values, "force_filter_s": 0.01})) == {
        "force_gain": CalibrationPrior(1.0, 0.0025, stated=True),
        "displacement_gain": CalibrationPrior(1.0, 0.005, stated=True),
        "skew_s": CalibrationPrior(0.004, 0.001, stated=True),
        "force_filter_s": CalibrationPrior(0.01, 0.002, 0.0, stated=True),
        FRAME: CALIBRATION_DEFAULTS[FRAME],
    }
    # a filter stated as none may still be short
    assert calibration_priors(Calibration({"force_filter_s": 0.0}))["force_filter_s"].sd == 2e-4


CURVE = FrameCurve(
    np.array([0.0, 100.0]), np.array([2e-3, 1e-3]), np.diag([1e-8, 4e-8]), range_N=(5.0, 100.0)
)


@pytest.mark.parametrize(
    ("frame", "sd"),
    [
        # sd(1/k) = sd(k) / k^2; of a bare number a quarter; u(100) = 50 (c0 + c1) at the largest force
        (linear_frame(500.0, 50.0), 50.0 / 500.0**2),
        (linear_frame(500.0), 0.25 / 500.0),
        (CURVE, np.sqrt(50.0**2 * 5e-8) / 100.0),
    ],
)
def test_a_known_frame_leaves_its_own_uncertainty(frame, sd):
    found = calibration_priors(Calibration({}, frame))[FRAME]
    assert (found.mean, found.lower) == (0.0, -np.inf)
    assert found.sd == pytest.approx(sd)


def test_an_unstated_frame_is_no_softer_than_suits_the_specimen():
    """A frame of 250 N/mm under 20 kN would bend by 80 mm."""
    assert suited(Priors(), 100.0, 4.0) == Priors()
    assert suited(Priors(), 20_000.0, 4.0).calibration[FRAME].sd == pytest.approx(3e-5)
    stated = Priors(calibration={FRAME: CalibrationPrior(0.0, 0.01, 0.0, stated=True)})
    assert suited(stated, 20_000.0, 4.0) == stated


def test_a_matrix_that_rounding_has_bent_still_gives_a_step():
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((4, 3)) @ rng.standard_normal((3, 6))
    bent = rows.T @ rows
    bent /= np.sqrt(np.outer(np.diag(bent), np.diag(bent)))
    bent[0, 1] += 1e-3
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(bent.T)
    step = cho_solve(_factor(bent), np.ones(6))
    assert np.isfinite(step).all()
    assert step @ np.ones(6) > 0.0
