"""Constrained steps: nearest points against scipy, optima against a closed form and a general optimiser."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from inference_cases import (
    draw,
    handles_for,
    identified,
    log_data,
    point_of,
    ramp_hold,
    small_recipe,
    system_of,
)
from scipy.linalg import null_space
from scipy.optimize import minimize

from tissueid.inference.channel_law import kelvin_voigt_law
from tissueid.inference.noise import Memory
from tissueid.inference.optimum import covariance_of, minimise, nearest_in_cone, prior_cost
from tissueid.inference.prior import Scatter, prior_rows
from tissueid.inference.system import SHAPE
from tissueid.model.base import ContactPath
from tissueid.priors import Priors


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
    ours = identified(handles_for(draw(small_recipe(cv_both=0.05), 1)), pooling="scaled")
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
