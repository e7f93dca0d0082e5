"""Random gains and contact offsets: the quadratic forms against plain evaluation on samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from tissueid.likelihood import partial
from tissueid.likelihood.objective import cone_start
from tissueid.model.kernels import branch_sensitivity

SCALE = 5.0
TAUS = np.array([0.3, 2.0])
SIGMA = 0.2
SD_GAIN, SD_OFFSET = 0.1, 0.08


def make_logs(logs=3, n=120, seed=0, *, branches=1, degree=1, noise=SIGMA):
    """Depth, branch states with slopes by ln tau, and force of a few logs, with scatter between them."""
    rng = np.random.default_rng(seed)
    out = []
    for i in range(logs):
        time = np.arange(n) * 0.05
        depth = np.minimum((0.8 + 0.7 * i) * time, 3.0 + 0.6 * i)
        pairs = [branch_sensitivity(time, depth, float(tau)) for tau in TAUS[:branches]]
        state = np.array([s for s, _ in pairs])
        slope = np.array([d * tau for (_, d), tau in zip(pairs, TAUS, strict=False)])
        gamma, delta = rng.normal(scale=0.1), rng.normal(scale=0.05)
        truth = evaluate(depth, state, theta_true(branches, degree), gamma, delta, degree)
        out.append((depth, state, slope, truth + noise * rng.normal(size=n)))
    return out


def theta_true(branches, degree):
    """By powers of u: the static curve, then every K."""
    return np.concatenate([[60.0, -8.0, 12.0], np.tile([25.0, 9.0, 4.0][: degree + 1], branches)])


def evaluate(depth, state, theta, gamma, delta, degree):
    """The force law, written out."""
    u = (depth - delta) / SCALE
    force = theta[0] * u + theta[1] * u**2 + theta[2] * u**3
    for j in range(state.shape[0]):
        k = theta[3 + j * (degree + 1) : 3 + (j + 1) * (degree + 1)]
        force = force + sum(k[m] * u**m for m in range(degree + 1)) * state[j]
    return np.exp(gamma) * force


def grams(logs, degree):
    """Reduced Gram matrices, made from the samples directly."""
    out = []
    for depth, state, slope, force in logs:
        columns = [np.ones_like(depth), depth, depth**2, depth**3]
        columns += [s * depth**k for s in state for k in range(degree + 1)]
        columns += [s * depth**k for s in slope for k in range(degree + 1)]
        design = np.column_stack([*columns, force])
        out.append(design.T @ design)
    return np.array(out)


def direct(logs, theta, gamma, delta, degree, weight_gain, weight_offset):
    total = 0.0
    for i, (depth, state, _, force) in enumerate(logs):
        total += float(((force - evaluate(depth, state, theta, gamma[i], delta[i], degree)) ** 2).sum())
    return total + weight_gain * float(gamma @ gamma) + float(weight_offset @ delta**2)


def weights_for(logs):
    return SIGMA**2 / SD_GAIN**2, np.full(len(logs), SIGMA**2 / SD_OFFSET**2)


@pytest.mark.parametrize("branches", [0, 1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_objective_is_the_penalised_sum_of_squares_over_samples(branches, degree):
    logs = make_logs(branches=branches, degree=degree)
    q = grams(logs, degree)
    gain, offset = weights_for(logs)
    rng = np.random.default_rng(1)
    for _ in range(5):
        theta = theta_true(branches, degree) * rng.uniform(0.5, 1.5, size=3 + branches * (degree + 1))
        gamma, delta = rng.normal(scale=0.2, size=3), rng.normal(scale=0.2, size=3)
        expected = direct(logs, theta, gamma, delta, degree, gain, offset)
        found = partial.objective(q, theta, gamma, delta, gain, offset, SCALE, degree, branches)
        assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_column_weights_shift_and_scale_the_polynomials(degree):
    rng = np.random.default_rng(2)
    depth = rng.uniform(0.0, 5.0, size=40)
    state = rng.normal(size=(2, 40))
    theta = theta_true(2, degree)
    gamma, delta = 0.13, -0.21
    matrix, shifted = partial.coefficients(gamma, delta, SCALE, degree, 2)
    columns = np.column_stack(
        [depth**k for k in range(4)] + [s * depth**k for s in state for k in range(degree + 1)]
    )
    expected = evaluate(depth, state, theta, gamma, delta, degree)
    np.testing.assert_allclose(columns @ matrix @ theta, expected, rtol=1e-12, atol=1e-11)
    h = 1e-6
    slope = (
        evaluate(depth, state, theta, gamma, delta + h, degree)
        - evaluate(depth, state, theta, gamma, delta - h, degree)
    ) / (2 * h)
    np.testing.assert_allclose(columns @ shifted @ theta, slope, rtol=1e-7, atol=1e-7)


def effects_at(logs, theta, weight_gain, weight_offset, degree):
    """Gains and offsets that minimise the objective at a fixed theta, from the samples."""
    found = []
    for i, (depth, state, _, force) in enumerate(logs):

        def residual(v, depth=depth, state=state, force=force, i=i):
            misfit = force - evaluate(depth, state, theta, v[0], v[1], degree)
            return np.append(misfit, [np.sqrt(weight_gain) * v[0], np.sqrt(weight_offset[i]) * v[1]])

        found.append(least_squares(residual, [0.0, 0.0], jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-13).x)
    return np.array(found).T


@pytest.mark.parametrize(("branches", "degree"), [(1, 0), (1, 1), (2, 1), (1, 2)])
def test_quadratic_form_has_the_value_and_the_gradient_of_the_objective(branches, degree):
    logs = make_logs(branches=branches, degree=degree)
    q = grams(logs, degree)
    gain, offset = weights_for(logs)
    theta = theta_true(branches, degree) * 1.02
    gamma, delta = effects_at(logs, theta, gain, offset, degree)
    h, b, c, back, _ = partial.assemble(q, theta, gamma, delta, gain, offset, SCALE, degree, branches)
    v = np.concatenate([theta, np.zeros(branches)])
    value = partial.objective(q, theta, gamma, delta, gain, offset, SCALE, degree, branches)
    assert c - 2.0 * b @ v + v @ h @ v == pytest.approx(value, rel=1e-7)
    effects = back[:, :, :-1] @ v + back[:, :, -1]
    np.testing.assert_allclose(effects, np.column_stack([gamma, delta]), atol=1e-6)
    # the random effects are at their optimum, so that they do not add to the gradient
    gradient = 2.0 * (h @ v - b)
    for k in range(theta.size):
        step = 1e-4 * abs(theta[k])
        up, down = theta.copy(), theta.copy()
        up[k] += step
        down[k] -= step
        slope = (
            partial.objective(q, up, gamma, delta, gain, offset, SCALE, degree, branches)
            - partial.objective(q, down, gamma, delta, gain, offset, SCALE, degree, branches)
        ) / (2 * step)
        assert gradient[k] == pytest.approx(slope, rel=1e-5, abs=1e-5 * np.abs(gradient).max())


@pytest.mark.parametrize(("branches", "degree"), [(1, 1), (2, 0)])
def test_quadratic_form_has_the_gradient_by_log_tau(branches, degree):
    logs = make_logs(branches=branches, degree=degree)
    q = grams(logs, degree)
    gain, offset = weights_for(logs)
    theta = theta_true(branches, degree) * 0.97
    gamma, delta = effects_at(logs, theta, gain, offset, degree)
    h, b, _, _, _ = partial.assemble(q, theta, gamma, delta, gain, offset, SCALE, degree, branches)
    p = theta.size
    gradient = 2.0 * (h[p:, :p] @ theta - b[p:])
    time = np.arange(120) * 0.05
    for j in range(branches):
        values = []
        for sign in (1.0, -1.0):
            moved = []
            for depth, state, slope, force in logs:
                new = state.copy()
                new[j] = branch_sensitivity(time, depth, float(TAUS[j] * np.exp(sign * 1e-5)))[0]
                moved.append((depth, new, slope, force))
            values.append(direct(moved, theta, gamma, delta, degree, gain, offset))
        assert gradient[j] == pytest.approx((values[0] - values[1]) / 2e-5, rel=1e-4, abs=1e-3)


@pytest.mark.needs_jit
@pytest.mark.parametrize(("branches", "degree"), [(1, 0), (1, 1), (2, 0), (1, 2)])
def test_solve_reaches_a_stationary_point_that_no_other_search_betters(branches, degree):
    blocks = np.array([3] + [degree + 1] * branches, dtype=np.int64)
    for seed in range(6):
        logs = make_logs(seed=seed, branches=branches, degree=degree)
        q = grams(logs, degree)
        gain, offset = weights_for(logs)
        p = int(blocks.sum())
        value, theta, gamma, delta, generators, weights = partial.solve(
            q, np.zeros(p), np.zeros(3), np.zeros(3), gain, offset, SCALE, degree, branches, blocks,
            cone_start(blocks),
        )  # fmt: skip
        assert value == pytest.approx(direct(logs, theta, gamma, delta, degree, gain, offset), rel=1e-9)
        np.testing.assert_allclose(weights @ generators, theta, rtol=1e-6, atol=1e-8)
        unit = np.concatenate([np.abs(theta) + 1.0, np.ones(6)])

        def whole(z, *, q=q, gain=gain, offset=offset, unit=unit, p=p):
            v = z * unit
            return partial.objective(
                q, v[:p], v[p : p + 3], v[p + 3 :], gain, offset, SCALE, degree, branches
            )

        at = np.concatenate([theta, gamma, delta]) / unit
        free = (theta > 1.0).all() or degree == 0  # no bound near: then any descent is allowed
        better = minimize(whole, at, method="BFGS", options={"gtol": 1e-7}) if free else None
        if better is not None and (better.x[3:p] > 0).all():
            assert value <= better.fun * (1.0 + 1e-8)


def test_solve_never_ends_above_its_start():
    blocks = np.array([3, 2], dtype=np.int64)
    rng = np.random.default_rng(8)
    for seed in range(10):
        logs = make_logs(seed=seed)
        q = grams(logs, 1)
        gain, offset = weights_for(logs)
        theta = theta_true(1, 1) * rng.uniform(0.6, 1.5)
        gamma, delta = rng.normal(scale=0.3, size=3), rng.normal(scale=0.3, size=3)
        before = partial.objective(q, theta, gamma, delta, gain, offset, SCALE, 1, 1)
        after = partial.solve(q, theta, gamma, delta, gain, offset, SCALE, 1, 1, blocks, cone_start(blocks))
        assert after[0] <= before
        again = partial.solve(
            q, after[1], after[2], after[3], gain, offset, SCALE, 1, 1, blocks, cone_start(blocks)
        )
        assert again[0] <= after[0] * (1 + 1e-13)
        assert again[0] == pytest.approx(after[0], rel=1e-9)


def test_every_start_leads_to_the_same_optimum():
    blocks = np.array([3, 2], dtype=np.int64)
    logs = make_logs(seed=3)
    q = grams(logs, 1)
    gain, offset = weights_for(logs)
    cold = partial.solve(
        q, np.zeros(5), np.zeros(3), np.zeros(3), gain, offset, SCALE, 1, 1, blocks, cone_start(blocks)
    )
    warm = partial.solve(
        q, theta_true(1, 1), np.full(3, 0.2), np.full(3, -0.1), gain, offset, SCALE, 1, 1, blocks,
        cone_start(blocks),
    )  # fmt: skip
    assert warm[0] == pytest.approx(cold[0], rel=1e-9)
    np.testing.assert_allclose(warm[1], cold[1], rtol=1e-4)
    np.testing.assert_allclose(warm[2], cold[2], atol=1e-4)


def test_solution_is_passive_where_the_data_ask_for_negative_stiffness():
    blocks = np.array([3, 1], dtype=np.int64)
    logs = [
        (depth, state, slope, force - 60.0 * state[0])
        for depth, state, slope, force in make_logs(branches=1, degree=0)
    ]
    q = grams(logs, 0)
    gain, offset = weights_for(logs)
    found = partial.solve(
        q, np.zeros(4), np.zeros(3), np.zeros(3), gain, offset, SCALE, 0, 1, blocks, cone_start(blocks)
    )
    assert found[1][3] == 0.0
    zero = np.zeros(3)
    elastic = direct(logs, found[1], found[2], found[3], 0, gain, offset)
    assert found[0] == pytest.approx(elastic, rel=1e-9)
    assert found[0] <= direct(logs, found[1], zero, zero, 0, gain, offset)


def test_marginal_likelihood_equals_the_brute_force_gaussian():
    """Restricted likelihood with the full covariance matrix of all samples, for a series of spreads."""
    branches, degree = 1, 0
    logs = make_logs(logs=3, n=25, branches=branches, degree=degree)
    q = grams(logs, degree)
    theta = theta_true(branches, degree)
    gamma, delta = np.array([0.05, -0.03, 0.08]), np.array([0.02, -0.04, 0.01])
    offset_sd = np.array([0.05, 0.08, 0.1])
    spreads = np.array([0.02, 0.1, 0.4])
    found = partial.marginal_terms(
        q, theta, gamma, delta, SIGMA**2, spreads, offset_sd, SCALE, degree, branches
    )
    v_columns, n_columns, target = [], [], []
    h = 1e-6
    for i, (depth, state, slope, force) in enumerate(logs):

        def at(theta=theta, g=gamma[i], d=delta[i], s=state, depth=depth):
            return evaluate(depth, s, theta, g, d, degree)

        design = np.column_stack([at(theta=row) for row in np.eye(theta.size)])
        by_tau = np.exp(gamma[i]) * theta[3] * slope[0]
        by_gamma = at()
        by_delta = (at(d=delta[i] + h) - at(d=delta[i] - h)) / (2 * h)
        effects = np.zeros((depth.size, 6))
        effects[:, i], effects[:, 3 + i] = by_gamma, by_delta
        v_columns.append(np.column_stack([design, by_tau]))
        n_columns.append(effects)
        target.append(force + by_gamma * gamma[i] + by_delta * delta[i])
    x, z, y = np.vstack(v_columns), np.vstack(n_columns), np.concatenate(target)
    expected = []
    for spread in spreads:
        prior = np.concatenate([np.full(3, spread**2), offset_sd**2])
        covariance = SIGMA**2 * np.eye(y.size) + z @ np.diag(prior) @ z.T
        inverse = np.linalg.inv(covariance)
        information = x.T @ inverse @ x
        residual = y - x @ np.linalg.solve(information, x.T @ inverse @ y)
        expected.append(
            residual @ inverse @ residual
            + np.linalg.slogdet(covariance)[1]
            + np.linalg.slogdet(information)[1]
        )
    # constants that do not depend on the spread are left out of the fast form
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-5)
