"""Variable projection for pooled and per-log static curves, and profile intervals."""

from __future__ import annotations

import os

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from tissueid.likelihood.basis import kernel_basis
from tissueid.likelihood.identifiability import (
    LEVEL_95,
    MAX_WIDTH,
    ProfileInterval,
    profile_interval,
    width_of,
)
from tissueid.likelihood.objective import (
    PartialObjective,
    PooledObjective,
    cone_start,
    eliminate_static,
    per_log_gram,
    shared_gram,
)
from tissueid.likelihood.sums import LogData, log_sums
from tissueid.model import ContactPath, KelvinVoigt

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"
N = 250 if JIT_OFF else 1500
STEP = 8.0 / N
DEPTH = 4.0
THETA = np.array([18.0, -1.0, 0.4, 25.0, 3.0, 0.4])
BOUNDS = (np.log(STEP / 5.0), np.log(80.0))


def make_logs(sigma=0.2, seed=0, theta=THETA, speeds=(0.7, 2.0, 5.0)):
    rng = np.random.default_rng(seed)
    model = KelvinVoigt(branches=1, stiffness_degree=1, depth_mm=DEPTH)
    logs = []
    for speed in speeds:
        time = np.arange(N) * STEP
        depth = np.minimum(speed * time, DEPTH)
        force = model.force(theta, ContactPath(time, depth)) + sigma * rng.normal(size=N)
        logs.append(LogData(time, depth, force, np.ones(N, dtype=bool), np.zeros(N, dtype=np.int64)))
    return logs


def gram_of(logs):
    basis = kernel_basis(step_s=STEP, length_s=8.0)
    return basis, np.concatenate([log_sums(one, basis, degree=1).gram for one in logs])


def pooled(logs, *, static=True, branches=1, degree=1):
    basis, gram = gram_of(logs)
    return PooledObjective(
        gram=shared_gram(gram.sum(axis=0)) if static else per_log_gram(gram, np.arange(len(logs))),
        basis=basis, scale=DEPTH, branches=branches, degree=degree, columns_degree=1, static=static,
    )  # fmt: skip


def partial_of(logs, weight_gain=1e2, weight_offset=1e4):
    basis, gram = gram_of(logs)
    return PartialObjective(
        gram=gram, basis=basis, scale=DEPTH, branches=1, degree=1, columns_degree=1,
        weight_gain=weight_gain, weight_offset=np.full(len(logs), weight_offset), logs=np.arange(len(logs)),
    )  # fmt: skip


def test_pooled_value_is_that_of_ordinary_least_squares_where_no_bound_is_active():
    logs = make_logs()
    found = pooled(logs).evaluate(np.log([0.3]))
    model = KelvinVoigt(branches=1, stiffness_degree=1, depth_mm=DEPTH)
    design = np.vstack(
        [model.linear_basis(np.log([0.3]), ContactPath(log.time_s, log.depth_mm)) for log in logs]
    )
    force = np.concatenate([log.force_N for log in logs])
    coefficients, squares, _, _ = np.linalg.lstsq(design, force, rcond=None)
    assert found.value == pytest.approx(float(squares[0]), rel=1e-9)
    powers = DEPTH ** np.array([1.0, 2.0, 3.0, 0.0, 1.0])
    np.testing.assert_allclose(found.theta, coefficients * powers, rtol=1e-6)


def test_per_log_value_is_that_of_a_free_cubic_and_constant_for_every_log():
    logs = make_logs()
    found = pooled(logs, static=False).evaluate(np.log([0.3]))
    model = KelvinVoigt(branches=1, stiffness_degree=1, depth_mm=DEPTH)
    rows = []
    for i, log in enumerate(logs):
        own = np.zeros((N, 4 * len(logs)))
        own[:, 4 * i : 4 * i + 4] = log.depth_mm[:, None] ** np.arange(4)
        shared = model.linear_basis(np.log([0.3]), ContactPath(log.time_s, log.depth_mm))[:, 3:]
        rows.append(np.hstack([shared, own]))
    design = np.vstack(rows)
    force = np.concatenate([log.force_N for log in logs])
    coefficients, squares, _, _ = np.linalg.lstsq(design, force, rcond=None)
    assert found.value == pytest.approx(float(squares[0]), rel=1e-7)
    np.testing.assert_allclose(found.theta, coefficients[:2] * [1.0, DEPTH], rtol=1e-5)


@pytest.mark.needs_jit
@pytest.mark.parametrize("kind", ["shared", "per-log", "partial"])
def test_gradient_is_the_slope_of_the_projected_value(kind):
    logs = make_logs()
    objective = partial_of(logs) if kind == "partial" else pooled(logs, static=kind == "shared")
    for at in (-3.0, -1.0, 0.5, 2.0):
        h = 1e-3
        up, down = (objective.evaluate(np.array([at + s * h])).value for s in (1.0, -1.0))
        here = objective.evaluate(np.array([at]))
        scale = abs(here.gradient[0]) + 1e-3 * here.value
        assert here.gradient[0] == pytest.approx((up - down) / (2 * h), abs=2e-4 * scale)


def test_gradient_of_two_branches():
    objective = pooled(make_logs(), branches=2, degree=0)
    at, h = np.array([-1.5, 0.8]), 1e-3
    gradient = objective.evaluate(at).gradient
    for j in range(2):
        step = h * np.eye(2)[j]
        slope = (objective.evaluate(at + step).value - objective.evaluate(at - step).value) / (2 * h)
        assert gradient[j] == pytest.approx(slope, rel=1e-3, abs=1e-3 * np.abs(gradient).max())


@pytest.mark.parametrize("static", [True, False])
@pytest.mark.parametrize("degree", [0, 1])
@pytest.mark.parametrize("branches", [1, 2])
def test_values_of_many_points_are_those_of_each(branches, degree, static):
    objective = pooled(make_logs(), static=static, branches=branches, degree=degree)
    times = (0.02, 0.1, 0.4, 3.0)
    points = [np.log(np.array(times[i : i + branches])) for i in range(len(times) - branches + 1)]
    expected = [objective.evaluate(point).value for point in points]
    # one reduction and another round their Gram matrices differently
    np.testing.assert_allclose(objective.values(points), expected, rtol=1e-9)


def test_random_effects_held_at_zero_are_one_shared_curve():
    logs = make_logs()
    shared = pooled(logs).evaluate(np.log([0.3]))
    held = partial_of(logs, weight_gain=1e14, weight_offset=1e14).evaluate(np.log([0.3]))
    assert held.value == pytest.approx(shared.value, rel=1e-7)
    np.testing.assert_allclose(held.theta, shared.theta, rtol=1e-5)


def test_random_effects_never_make_the_fit_worse():
    logs = make_logs()
    shared = pooled(logs).evaluate(np.log([0.4]))
    free = partial_of(logs).evaluate(np.log([0.4]))
    assert free.value <= shared.value * (1 + 1e-10)


def test_eliminating_columns_leaves_the_residual_of_their_regression():
    rng = np.random.default_rng(0)
    static, rest = rng.normal(size=(60, 4)), rng.normal(size=(60, 3))
    both = np.hstack([static, rest])
    left = rest - static @ np.linalg.lstsq(static, rest, rcond=None)[0]
    np.testing.assert_allclose(eliminate_static(both.T @ both, 4), left.T @ left, atol=1e-9)


def test_eliminating_undetermined_columns_is_harmless():
    # a hold at one depth: x, x^2 and x^3 are multiples of the constant
    rng = np.random.default_rng(1)
    static = np.ones((50, 1)) * 3.0 ** np.arange(4)
    rest = rng.normal(size=(50, 2))
    both = np.hstack([static, rest])
    left = rest - rest.mean(axis=0)
    np.testing.assert_allclose(eliminate_static(both.T @ both, 4), left.T @ left, rtol=1e-6, atol=1e-6)


def test_starting_generators_are_block_diagonal():
    start = cone_start(np.array([3, 2, 1]))
    assert start.shape == (6, 6)
    assert np.abs(start[:3, 3:]).max() == 0.0
    assert np.abs(start[3:, :3]).max() == 0.0
    assert np.linalg.matrix_rank(start) == 6


def optimum_of(objective):
    found = minimize_scalar(
        lambda v: objective.evaluate(np.array([v])).value, bounds=(-3.0, 2.0), method="bounded",
        options={"xatol": 1e-7},
    )  # fmt: skip
    return objective.evaluate(np.array([found.x]))


def inverse_log_tau(found):
    return np.linalg.inv(found.curvature)[-1:, -1:]


@pytest.mark.parametrize("kind", ["shared", "per-log", "partial"])
def test_profile_interval_of_a_well_determined_time_is_two_standard_errors_wide(kind):
    logs = make_logs(sigma=0.2)
    objective = partial_of(logs) if kind == "partial" else pooled(logs, static=kind == "shared")
    found = optimum_of(objective)
    sigma2 = 0.04
    inverse = inverse_log_tau(found)
    interval = profile_interval(objective, found, 0, sigma2=sigma2, inverse=inverse, bounds=BOUNDS)
    sd = float(np.sqrt(sigma2 * inverse[0, 0]))
    assert sd < 0.05
    assert interval.identified
    # the likelihood is a parabola to about sd, relative
    assert interval.high - found.log_tau[0] == pytest.approx(1.96 * sd, rel=3 * sd + 1e-3)
    assert found.log_tau[0] - interval.low == pytest.approx(1.96 * sd, rel=3 * sd + 1e-3)


def test_profile_interval_ends_where_the_sum_of_squares_has_risen_by_its_level():
    objective = pooled(make_logs())
    found = optimum_of(objective)
    sigma2 = 400.0  # so wide that it is no parabola
    interval = profile_interval(
        objective, found, 0, sigma2=sigma2, inverse=inverse_log_tau(found), bounds=BOUNDS
    )
    for end, is_open in ((interval.low, interval.open_low), (interval.high, interval.open_high)):
        rise = objective.evaluate(np.array([end])).value - found.value
        if is_open:
            assert rise < LEVEL_95 * sigma2
        else:
            assert rise == pytest.approx(LEVEL_95 * sigma2, rel=2e-3)


def test_interval_of_a_time_that_the_data_do_not_show_is_open_at_a_bound():
    logs = make_logs(sigma=2.0, theta=np.array([18.0, -1.0, 0.4, 0.02, 0.0, 0.4]))
    objective = pooled(logs, degree=0)
    found = objective.evaluate(np.log([0.4]))
    interval = profile_interval(objective, found, 0, sigma2=4.0, inverse=np.array([[np.inf]]), bounds=BOUNDS)
    assert interval.open_low
    assert interval.low == BOUNDS[0]
    assert interval.open_high
    assert interval.high == BOUNDS[1]
    assert not interval.identified


def test_a_closed_interval_wider_than_a_factor_e_is_not_identified():
    assert ProfileInterval(0.0, MAX_WIDTH * 0.99, False, False).identified
    assert not ProfileInterval(0.0, MAX_WIDTH * 1.01, False, False).identified
    assert not ProfileInterval(0.0, 0.1, True, False).identified
    assert not ProfileInterval(0.0, 0.1, False, True).identified


def test_width_of_a_positive_estimate():
    assert width_of(2.0, 0.1) == pytest.approx(2 * 1.959964 * 0.05, rel=1e-6)
    assert width_of(0.0, 0.1) == np.inf
    assert width_of(-1.0, 0.1) == np.inf
    assert width_of(1.0, np.inf) == np.inf


def test_interval_of_one_of_two_branches_follows_the_other():
    """Profiling over the other branch can only widen the interval that holds it fixed."""
    model = KelvinVoigt(branches=2, stiffness_degree=0, depth_mm=DEPTH)
    truth = np.array([18.0, -1.0, 0.4, 25.0, 0.2, 12.0, 1.5])
    rng = np.random.default_rng(3)
    logs = []
    for log in make_logs():
        force = model.force(truth, ContactPath(log.time_s, log.depth_mm)) + 0.05 * rng.normal(size=N)
        logs.append(LogData(log.time_s, log.depth_mm, force, log.include, log.fold))
    objective = pooled(logs, branches=2, degree=0)
    found = objective.evaluate(np.log([0.2, 1.5]))
    for _ in range(12):  # Gauss-Newton to the optimum
        step = -0.5 * np.linalg.inv(found.curvature)[-2:, -2:] @ found.gradient
        found = objective.evaluate(found.log_tau + step)
    inverse = np.linalg.inv(found.curvature)[-2:, -2:]
    for branch in range(2):
        interval = profile_interval(objective, found, branch, sigma2=0.0025, inverse=inverse, bounds=BOUNDS)
        sd = float(np.sqrt(0.0025 * inverse[branch, branch]))
        alone = float(np.sqrt(0.0025 / found.curvature[-2:, -2:][branch, branch]))
        assert interval.width == pytest.approx(2 * 1.96 * sd, rel=0.15)
        assert interval.width > 2 * 1.96 * alone
