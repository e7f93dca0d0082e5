"""Levenberg-Marquardt on the compressed residual against lmfit and paper A's own on raw samples."""

from __future__ import annotations

import os

import lmfit
import numpy as np
import pytest
from fit_cases import draw, log_data, small_recipe, specimen_sums, sums_of

from tissueid.fit.candidates import Candidate, fit_candidate
from tissueid.fit.estimates import estimate_tissue
from tissueid.fit.lm import levenberg_marquardt
from tissueid.model import ContactPath, KelvinVoigt

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"
needs_jit = pytest.mark.skipif(JIT_OFF, reason="too slow without compilation")

N = 5000
STEP = 2e-3
DEPTH = 5.0
#: A Gram matrix holds the residual as a difference of sums of squares of the force.
OF_FORCE_SQUARED = 1e-14
TAU = 0.8
TRUTH = {0: np.array([20.0, -1.2, 0.35, 25.0, TAU]), 1: np.array([20.0, -1.2, 0.35, 20.0, 3.0, TAU])}


def one_log(degree, sigma=0.05):
    """Two ramps with holds between and after: tau, K and the static curve are all well determined."""
    rng = np.random.default_rng(11)
    time = np.arange(N) * STEP
    depth = np.interp(time, [0.0, 0.5, 3.5, 4.5, 10.0], [0.0, 2.5, 2.5, DEPTH, DEPTH])
    model = KelvinVoigt(branches=1, stiffness_degree=degree, depth_mm=DEPTH)
    path = ContactPath(time, depth)
    force = model.force(TRUTH[degree], path) + sigma * rng.normal(size=N)
    return model, path, force


def cone_polynomial(p):
    """Coefficients by powers of u of (p0 (1-u) - p2 u)^2 + 2 w u (1-u), written out."""
    if len(p) == 1:
        return np.array([p[0] ** 2])
    if len(p) == 2:
        return np.array([p[0] ** 2, p[1] ** 2 - p[0] ** 2])
    p0, w, p2 = p
    return np.array([p0**2, -2.0 * p0**2 - 2.0 * p0 * p2 + 2.0 * w, p0**2 + 2.0 * p0 * p2 + p2**2 - 2.0 * w])


def raw_lmfit(model, path, force, start):
    """lmfit on all N residuals, in the cone coordinates and ln tau."""
    names = ["p0", "w", "p2"] + [f"k{i}" for i in range(model.stiffness_degree + 1)]

    def theta_of(values):
        static = cone_polynomial(values[:3]) / DEPTH ** np.arange(1.0, 4.0)
        stiffness = cone_polynomial(values[3:-1]) / DEPTH ** np.arange(model.stiffness_degree + 1.0)
        return np.concatenate([static, stiffness, [np.exp(values[-1])]])

    def residual(parameters):
        values = np.array([one.value for one in parameters.values()])
        return model.force(theta_of(values), path) - force

    def jacobian(parameters):
        values = np.array([one.value for one in parameters.values()])
        by_theta = model.jacobian(theta_of(values), path)
        h = 1e-6
        change = np.column_stack(
            [(theta_of(values + h * e) - theta_of(values - h * e)) / (2 * h) for e in np.eye(values.size)]
        )
        return by_theta @ change

    parameters = lmfit.Parameters()
    for name, value in zip(names, start[:-1], strict=True):
        parameters.add(name, value=value, min=0.0 if name == "w" else -np.inf)
    parameters.add("ln_tau", value=start[-1])
    found = lmfit.minimize(
        residual, parameters, method="leastsq", Dfun=jacobian, ftol=1e-15, xtol=1e-15, gtol=0.0, max_nfev=500
    )
    return theta_of(np.array([one.value for one in found.params.values()])), float(found.chisqr)


def compressed(degree, model, path, force):
    sums = sums_of([log_data(path.time_s, path.depth_mm, force)], degree=degree)
    solution = fit_candidate(sums, Candidate(1, degree, "shared"))
    bounds = sums.log_tau_bounds
    rough = solution.objective.evaluate(np.log([1.3 * TAU]))
    lm = levenberg_marquardt(solution.objective, rough, bounds)
    u = DEPTH ** np.concatenate([np.arange(1.0, 4.0), np.arange(degree + 1.0)])
    return sums, solution, lm, np.concatenate([lm.theta / u, np.exp(lm.log_tau)])


@needs_jit
@pytest.mark.parametrize("degree", [0, 1])
def test_compressed_fit_equals_lmfit_on_all_raw_samples(degree):
    model, path, force = one_log(degree)
    _, _, lm, theta = compressed(degree, model, path, force)
    start = np.array([9.0, 100.0, 9.0] + [5.0] * (degree + 1) + [np.log(0.6)])
    raw, chisqr = raw_lmfit(model, path, force, start)
    assert lm.converged
    np.testing.assert_allclose(theta, raw, rtol=1e-8)
    assert lm.value == pytest.approx(chisqr, rel=1e-8, abs=OF_FORCE_SQUARED * float(force @ force))


@needs_jit
@pytest.mark.parametrize("degree", [0, 1])
def test_standard_errors_are_those_of_a_fit_to_all_samples(degree):
    """Degrees of freedom count the N samples, not the rows of the compressed residual."""
    model, path, force = one_log(degree)
    sums, solution, _, theta = compressed(degree, model, path, force)
    parameters = lmfit.Parameters()
    for i, value in enumerate(theta):
        parameters.add(f"t{i}", value=value)

    def values_of(parameters):
        return np.array([one.value for one in parameters.values()])

    found = lmfit.minimize(
        lambda p: model.force(values_of(p), path) - force, parameters, method="leastsq",
        Dfun=lambda p: model.jacobian(values_of(p), path), xtol=1e-12, ftol=1e-15,
    )  # fmt: skip
    raw = np.array([one.stderr for one in found.params.values()])
    assert found.nfree == N - theta.size
    tissue = estimate_tissue(sums, solution)
    np.testing.assert_allclose(np.sqrt(np.diag(tissue.covariance)), raw, rtol=1e-5)
    assert solution.noise.sigma2 == pytest.approx(found.redchi, rel=1e-8)


def paper_a(model, path, force, weights, rounds=200):
    """Equations (10) to (13): E = e'e/2, e = F_exp - F_model, J = de/dw, w <- w - (J'J + mu I)^-1 J'e."""
    mu = 1e-2
    error = force - model.force(weights, path)
    for _ in range(rounds):
        jacobian = -model.jacobian(weights, path)
        slope, curvature = jacobian.T @ error, jacobian.T @ jacobian
        while True:
            step = np.linalg.solve(curvature + mu * np.eye(weights.size), slope)
            trial = weights - step
            if trial[-1] > 0.0:
                left = force - model.force(trial, path)
                if left @ left <= error @ error:
                    break
            mu *= 10.0
            if mu > 1e12:
                return weights, float(error @ error)
        weights, error, mu = trial, left, mu / 10.0
        if np.abs(step / weights).max() < 1e-13:
            break
    return weights, float(error @ error)


@needs_jit
@pytest.mark.parametrize("degree", [0, 1])
def test_the_papers_own_levenberg_marquardt_ends_at_the_same_optimum(degree):
    model, path, force = one_log(degree)
    _, _, lm, theta = compressed(degree, model, path, force)
    start = TRUTH[degree] * np.where(np.arange(TRUTH[degree].size) % 2 == 0, 1.2, 0.85)
    weights, squares = paper_a(model, path, force, start)
    np.testing.assert_allclose(weights, theta, rtol=1e-7)
    assert squares == pytest.approx(lm.value, rel=1e-8, abs=OF_FORCE_SQUARED * float(force @ force))


@pytest.mark.parametrize("pooling", ["shared", "partial", "per-log"])
def test_both_optimisers_end_at_the_same_optimum(pooling):
    recipe = small_recipe(rate_Hz=20.0 if JIT_OFF else 100.0, cv_both=0.1 if pooling != "shared" else 0.0)
    sums = specimen_sums(draw(recipe, 2), degree=0, offset_sd_mm=0.02)
    solution = fit_candidate(sums, Candidate(1, 0, pooling))
    found = solution.evaluation
    rough = solution.objective.evaluate(found.log_tau + 0.1, found)
    lm = levenberg_marquardt(solution.objective, rough, sums.log_tau_bounds)
    assert lm.converged
    assert lm.value == pytest.approx(found.value, rel=1e-8)
    sd = np.sqrt(solution.noise.sigma2 * np.linalg.inv(found.curvature)[-1, -1])
    assert abs(lm.log_tau[0] - found.log_tau[0]) <= 1e-3 * sd
    np.testing.assert_allclose(lm.theta, found.theta, rtol=1e-3)


def test_a_far_start_is_recovered_from():
    _, path, force = one_log(0)
    thin = slice(None, None, 25)
    sums = sums_of([log_data(path.time_s[thin], path.depth_mm[thin], force[thin])], degree=0)
    solution = fit_candidate(sums, Candidate(1, 0, "shared"))
    for factor in (0.2, 5.0):
        rough = solution.objective.evaluate(solution.evaluation.log_tau + np.log(factor))
        lm = levenberg_marquardt(solution.objective, rough, sums.log_tau_bounds)
        assert lm.value == pytest.approx(solution.evaluation.value, rel=1e-7)


def test_result_is_passive_where_a_bound_is_active():
    model, path, force = one_log(1)
    thin = slice(None, None, 25)
    falling = force - 15.0 * model.states(np.array([TAU]), path)[0] * path.depth_mm / DEPTH * 2.5
    sums = sums_of([log_data(path.time_s[thin], path.depth_mm[thin], falling[thin])], degree=1)
    solution = fit_candidate(sums, Candidate(1, 1, "shared"))
    lm = levenberg_marquardt(solution.objective, solution.evaluation, sums.log_tau_bounds)
    assert lm.theta[3] >= 0.0
    assert lm.theta[3:].sum() >= 0.0
    assert solution.evaluation.value <= lm.value * (1 + 1e-9)
