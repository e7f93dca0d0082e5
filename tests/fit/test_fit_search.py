"""The global search against a dense grid that shares nothing with the node basis."""

from __future__ import annotations

import os

import numpy as np
import pytest
from fit_cases import log_data, sums_of
from scipy.optimize import minimize_scalar

from tissueid.fit.candidates import Candidate, Noise, fit_candidate, objective_for
from tissueid.fit.search import global_minimum, polish, step_in_log_tau, unbounded_covariance
from tissueid.likelihood import partial
from tissueid.likelihood.cone import cone_least_squares
from tissueid.likelihood.objective import Evaluation, cone_start
from tissueid.model.kernels import branch_state

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"
needs_jit = pytest.mark.skipif(JIT_OFF, reason="too slow without compilation")

#: Spacing of the dense grid in ln tau.
DENSE = 0.1
#: The bar: relative to the grid's optimum.
BAR = 1e-6


def random_specimen(seed):
    """Two to four short logs of a random tissue under random ramps, holds and noise."""
    rng = np.random.default_rng(seed)
    step = float(rng.choice([0.002, 0.005, 0.01, 0.02, 0.05]))
    n = int(rng.choice([160, 390]))
    length = step * (n - 1)
    tau = float(np.exp(rng.uniform(np.log(2.0 * step), np.log(length))))
    depth_mm = float(rng.uniform(2.0, 8.0))
    degree = int(rng.integers(0, 3))
    static = np.array([20.0, -1.2, 0.35]) * rng.uniform(0.5, 2.0)
    stiffness = rng.uniform(2.0, 60.0) * np.array([1.0, rng.uniform(-0.1, 0.3), 0.01])[: degree + 1]
    sigma = float(np.exp(rng.uniform(np.log(0.02), np.log(2.0))))
    scatter = float(rng.choice([0.0, 0.05, 0.15]))
    logs = []
    for _ in range(int(rng.integers(2, 5))):
        time = np.arange(n) * step
        if rng.random() < 0.3:
            time = np.concatenate([[0.0], np.cumsum(step * rng.uniform(0.6, 1.4, size=n - 1))])
        corner = rng.uniform(0.1, 1.0) * length
        depth = np.minimum(time / corner, 1.0) * depth_mm * rng.uniform(0.5, 1.0)
        shifted = depth - rng.normal(scale=0.2 * scatter)
        state = branch_state(time, depth, tau, 0.0)
        powers = shifted[:, None] ** np.arange(1.0, 4.0)
        force = powers @ static + (shifted[:, None] ** np.arange(degree + 1)) @ stiffness * state
        force = force * np.exp(scatter * rng.normal()) + sigma * rng.normal(size=n)
        include = depth >= 0.05 * depth_mm
        logs.append(log_data(time, depth, force, include=include))
    return logs, degree


class DenseGrid:
    """Objectives on a grid of ln tau, branch states by the exact recursion at every point."""

    def __init__(self, logs, sums, degree, pooling, noise):
        self.logs, self.sums, self.degree, self.pooling, self.noise = logs, sums, degree, pooling, noise
        self.scale = sums.depth_mm
        self.blocks = np.array([3, degree + 1], dtype=np.int64)
        self.warm = None

    def columns(self, log, log_tau):
        x = log.depth_mm
        state = branch_state(log.time_s, x, float(np.exp(log_tau)), 0.0)
        design = [x**k for k in range(4)] + [state * x**k for k in range(self.degree + 1)]
        return np.column_stack([*design, log.force_N])[log.include]

    def value(self, log_tau):
        made = [self.columns(log, log_tau) for log in self.logs]
        return self.shared(made) if self.pooling == "shared" else self.penalised(made)

    def shared(self, made):
        powers = np.concatenate(
            [self.scale ** -np.arange(1.0, 4.0), self.scale ** -np.arange(self.degree + 1.0)]
        )
        whole = np.vstack(made)[:, 1:]
        design = whole[:, :-1] * powers
        force = whole[:, -1]
        theta = cone_least_squares(design.T @ design, design.T @ force, self.blocks, cone_start(self.blocks))[
            0
        ]
        residual = force - design @ theta
        return float(residual @ residual)

    def penalised(self, made):
        q = np.zeros((len(made), 5 + 2 * (self.degree + 1), 5 + 2 * (self.degree + 1)))
        size = self.degree + 1
        for i, design in enumerate(made):
            gram = design.T @ design
            at = [*range(4 + size), q.shape[1] - 1]  # columns by ln tau are not needed: left zero
            q[i][np.ix_(at, at)] = gram
        gain = self.noise.sigma2 / self.noise.gain_sd**2
        offset = self.noise.sigma2 / self.sums.offset_sd_mm**2
        p, n = int(self.blocks.sum()), len(made)
        starts = [(np.zeros(p), np.zeros(n), np.zeros(n))]
        if self.warm is not None:
            starts.append(self.warm)
        best = None
        for start in starts:
            found = partial.solve(
                q, *start, gain, offset, self.scale, self.degree, 1, self.blocks, cone_start(self.blocks)
            )
            if best is None or found[0] < best[0]:
                best = found
        self.warm = best[1:4]
        return float(best[0])

    def minimum(self, bounds):
        """Dense grid, then a golden-section search around its best points."""
        grid = np.linspace(*bounds, int(np.ceil((bounds[1] - bounds[0]) / DENSE)) + 1)
        values = np.array([self.value(point) for point in grid])
        spacing = grid[1] - grid[0]
        best = values.min()
        for start in grid[np.argsort(values)[:2]]:
            around = np.clip([start - spacing, start + spacing], *bounds)
            found = minimize_scalar(self.value, bounds=around, method="bounded", options={"xatol": 1e-5})
            best = min(best, found.fun)
        return float(best)


def attained(logs, sums, degree, solution):
    """The objective at the fit's own parameters, sample by sample."""
    found, noise = solution.evaluation, solution.noise
    gamma = found.gamma if found.gamma.size else np.zeros(len(logs))
    delta = found.delta if found.delta.size else np.zeros(len(logs))
    total = 0.0
    for i, log in enumerate(logs):
        u = (log.depth_mm - delta[i]) / sums.depth_mm
        state = branch_state(log.time_s, log.depth_mm, float(np.exp(found.log_tau[0])), 0.0)
        force = (u[:, None] ** np.arange(1.0, 4.0)) @ found.theta[:3]
        force += (u[:, None] ** np.arange(degree + 1)) @ found.theta[3:] * state
        total += float(((log.force_N - np.exp(gamma[i]) * force)[log.include] ** 2).sum())
    if found.gamma.size:
        total += noise.sigma2 * float((gamma**2).sum() / noise.gain_sd**2)
        total += noise.sigma2 * float((delta**2 / sums.offset_sd_mm**2).sum())
    return total


def compare(pooling, seeds):
    """How far the fit lies above the dense grid's optimum, specimen by specimen."""
    excess = []
    for seed in seeds:
        logs, degree = random_specimen(seed)
        sums = sums_of(logs, degree=degree)
        solution = fit_candidate(sums, Candidate(branches=1, degree=degree, pooling=pooling))
        value = attained(logs, sums, degree, solution)
        assert solution.evaluation.value == pytest.approx(value, rel=BAR), seed
        best = DenseGrid(logs, sums, degree, pooling, solution.noise).minimum(sums.log_tau_bounds)
        excess.append((value - best) / best)
    return np.array(excess)


def report(pooling, excess):
    print(  # noqa: T201
        f"\n{pooling}: {excess.size} random specimens, {int((excess <= BAR).sum())} within {BAR:g} of the "
        f"dense grid's optimum; largest excess {excess.max():.2e}, lowest {excess.min():.2e}"
    )


@needs_jit
@pytest.mark.parametrize("pooling", ["shared", "partial"])
def test_optimum_of_random_specimens_is_that_of_a_dense_grid(pooling):
    excess = compare(pooling, range(20))
    report(pooling, excess)
    assert excess.max() <= BAR, np.flatnonzero(excess > BAR)


@pytest.mark.slow
@needs_jit
@pytest.mark.parametrize("pooling", ["shared", "partial"])
def test_optimum_of_a_thousand_random_specimens_is_that_of_a_dense_grid(pooling):
    excess = compare(pooling, range(1000))
    report(pooling, excess)
    assert excess.max() <= BAR, np.flatnonzero(excess > BAR)


class Landscape:
    """A made-up objective of ln tau, to see what the search alone does."""

    def __init__(self, function, branches=1):
        self.function, self.branches, self.calls = function, branches, 0
        self.blocks = np.array([1], dtype=np.int64)

    def values(self, points):
        return np.array([self.evaluate(point).value for point in points])

    def evaluate(self, log_tau, warm=None):
        self.calls += 1
        log_tau = np.asarray(log_tau, dtype=float)
        h = 1e-6
        unit = np.eye(log_tau.size)
        gradient = np.array(
            [(self.function(log_tau + h * e) - self.function(log_tau - h * e)) / (2 * h) for e in unit]
        )
        n = 1 + log_tau.size
        return Evaluation(
            value=float(self.function(log_tau)), log_tau=log_tau, theta=np.ones(1), gradient=gradient,
            generators=np.ones((1, 1)), weights=np.ones(1), curvature=np.eye(n),
        )  # fmt: skip


def test_the_deeper_of_two_valleys_is_found_wherever_it_lies():
    for deep in np.linspace(-6.0, 4.0, 21):
        shallow = deep + 4.0 if deep < 0 else deep - 4.0

        def valley(v, deep=deep, shallow=shallow):
            return 10.0 - 2.0 * np.exp(-((v[0] - deep) ** 2)) - 1.9 * np.exp(-((v[0] - shallow) ** 2))

        found = global_minimum(Landscape(valley), (-7.0, 5.0))
        assert found.log_tau[0] == pytest.approx(deep, abs=1e-2)


def test_an_optimum_at_a_bound_is_returned_at_the_bound():
    found = global_minimum(Landscape(lambda v: 5.0 + v[0]), (-3.0, 2.0))
    assert found.log_tau[0] == pytest.approx(-3.0, abs=1e-9)


def test_branches_come_out_in_ascending_order():
    def valley(v):
        # two distinguishable branches: lowest where the first is the slower one
        return 5.0 + (v[0] - 1.0) ** 2 + (v[1] + 1.0) ** 2

    found = global_minimum(Landscape(lambda v: min(valley(v), valley(v[::-1])), branches=2), (-4.0, 4.0))
    np.testing.assert_allclose(found.log_tau, [-1.0, 1.0], atol=1e-4)


def test_polish_never_ends_above_its_start():
    rng = np.random.default_rng(0)

    def bumpy(v):
        return 3.0 + np.sin(3.0 * v[0]) + 0.1 * v[0] ** 2

    for start in rng.uniform(-4.0, 4.0, size=20):
        found = polish(Landscape(bumpy), np.array([start]), (-5.0, 5.0))
        assert found.value <= bumpy([start])


def test_no_branch_needs_no_search():
    logs, _ = random_specimen(0)
    sums = sums_of(logs, degree=0)
    objective = objective_for(sums, Candidate(0, 0, "shared"), Noise(1.0, 0.1))
    found = global_minimum(objective, sums.log_tau_bounds)
    x = np.concatenate([log.depth_mm[log.include] for log in logs])
    y = np.concatenate([log.force_N[log.include] for log in logs])
    design = x[:, None] ** np.arange(1.0, 4.0)
    assert found.value == pytest.approx(float(np.linalg.lstsq(design, y, rcond=None)[1][0]), rel=1e-7)


@needs_jit
def test_two_and_three_branches_of_noise_free_data_are_found_from_nothing():
    time = np.arange(4000) * 0.01
    depth = np.minimum(time * 8.0, 4.0)
    truth = np.array([0.08, 0.9, 9.0])
    state = np.array([branch_state(time, depth, float(tau), 0.0) for tau in truth])
    for count in (2, 3):
        used = slice(3 - count, 3)
        force = 15.0 * depth + 0.5 * depth**3 + np.array([12.0, 10.0, 8.0])[used] @ state[used]
        other = np.minimum(time * 0.5, 4.0)
        slow = np.array([branch_state(time, other, float(tau), 0.0) for tau in truth])
        second = 15.0 * other + 0.5 * other**3 + np.array([12.0, 10.0, 8.0])[used] @ slow[used]
        rng = np.random.default_rng(count)
        noise = 1e-3 * rng.normal(size=(2, time.size))
        logs = [log_data(time, depth, force + noise[0]), log_data(time, other, second + noise[1])]
        sums = sums_of(logs, degree=0)
        seeds = []
        for branches in range(1, count + 1):
            solution = fit_candidate(sums, Candidate(branches, 0, "shared"), seeds=seeds)
            seeds = [solution.evaluation.log_tau]
        np.testing.assert_allclose(np.exp(solution.evaluation.log_tau), truth[used], rtol=2e-2)


def test_gauss_newton_step_points_to_the_optimum():
    logs, degree = random_specimen(3)
    sums = sums_of(logs, degree=degree)
    solution = fit_candidate(sums, Candidate(1, degree, "shared"))
    best = solution.evaluation
    off = solution.objective.evaluate(best.log_tau + 0.01)
    step = step_in_log_tau(off, solution.objective.blocks)
    assert off.log_tau + step == pytest.approx(best.log_tau, abs=2e-3)


def test_covariance_is_the_inverse_curvature_where_nothing_binds():
    logs, _ = random_specimen(3)
    sums = sums_of(logs, degree=0)
    solution = fit_candidate(sums, Candidate(1, 0, "shared"))
    inverse, bounded = unbounded_covariance(solution.evaluation, solution.objective.blocks)
    assert not bounded
    scale = np.sqrt(np.diag(solution.evaluation.curvature))
    product = (inverse * scale) @ (solution.evaluation.curvature / scale[:, None])
    np.testing.assert_allclose(product, np.eye(scale.size), atol=1e-4)


def test_time_of_a_branch_without_stiffness_has_no_finite_variance():
    evaluation = Evaluation(
        value=1.0, log_tau=np.zeros(1), theta=np.array([1.0, 0.0]), generators=np.eye(2),
        weights=np.array([1.0, 0.0]), gradient=np.zeros(1), curvature=np.diag([2.0, 3.0, 0.0]),
    )  # fmt: skip
    inverse, bounded = unbounded_covariance(evaluation, np.array([1, 1]))
    assert bounded
    assert inverse[0, 0] == pytest.approx(0.5)
    assert inverse[1, 1] == 0.0
    assert np.isinf(inverse[2, 2])
    assert (step_in_log_tau(evaluation, np.array([1, 1])) == 0.0).all()
