"""Passive least squares against its optimality conditions and an independent solver."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from tissueid.likelihood.cone import cone_least_squares, support_directions
from tissueid.likelihood.objective import cone_start
from tissueid.model.polynomial import minimum_on_unit

BLOCKS = [(3, 1), (3, 2), (3, 3), (1,), (2,), (3,), (2, 2), (3, 1, 1), (3, 3, 3), (3, 3, 3, 3)]


def split(theta, blocks):
    return np.split(theta, np.cumsum(blocks)[:-1])


def solve(h, b, blocks):
    sizes = np.array(blocks, dtype=np.int64)
    return cone_least_squares(np.ascontiguousarray(h), np.ascontiguousarray(b), sizes, cone_start(sizes))


def random_problem(seed, blocks):
    """Design and target; the weights asked for are passive for some blocks and not for others."""
    rng = np.random.default_rng(seed)
    p = sum(blocks)
    a = rng.normal(size=(p + 15, p)) * np.exp(rng.normal(scale=1.0, size=p))
    y = a @ (rng.normal(size=p) * 2.0) + rng.normal(size=p + 15)
    return a, y


def certificate(h, b, theta, blocks):
    """Worst violation of feasibility, of the dual cone and of complementarity, each made relative.

    The problem is convex, so that these three being zero proves the optimum, whatever found it.
    """
    gradient = h @ theta - b
    feasible = min(minimum_on_unit(q) / max(np.abs(q).max(), 1e-300) for q in split(theta, blocks))
    r = np.linspace(0.0, 1.0, 4001)
    dual = np.inf
    for g in split(gradient, blocks):
        if g.size == 1:
            values = g
        elif g.size == 2:
            values = np.array([g[0] - g[1], g[1]])
        else:
            values = np.append(g[2] - 2.0 * r * g[1] + r**2 * g[0], g[1] - g[2])
        dual = min(dual, values.min())
    scale = np.abs(b).max()
    return feasible, dual / scale, abs(gradient @ theta) / max(abs(b @ theta), scale * 1e-3)


@pytest.mark.needs_jit
@pytest.mark.parametrize("blocks", BLOCKS)
def test_optimality_conditions_hold_on_random_problems(blocks):
    for seed in range(40):
        a, y = random_problem(seed, blocks)
        h, b = a.T @ a, a.T @ y
        theta, generators, weights = solve(h, b, blocks)
        np.testing.assert_allclose(weights @ generators, theta, atol=1e-12 * np.abs(theta).max(initial=1.0))
        assert (weights >= 0.0).all()
        feasible, dual, slack = certificate(h, b, theta, blocks)
        assert feasible >= -1e-9, seed
        assert dual >= -1e-8, seed
        assert slack <= 1e-8, seed


@pytest.mark.parametrize("blocks", [(3,), (3, 1), (3, 2), (3, 3)])
def test_solution_matches_an_independent_solver(blocks):
    """scipy's NNLS over a thousand members of the cone: its optimum is a little above, never below."""
    r = np.linspace(0.0, 1.0, 501)
    members = {
        1: np.array([[1.0]]),
        2: np.array([[1.0, -1.0], [0.0, 1.0]]),
        3: np.vstack([np.column_stack([r**2, -2.0 * r, np.ones_like(r)]), [[0.0, 1.0, -1.0]]]),
    }
    for seed in range(12):
        a, y = random_problem(1000 + seed, blocks)
        theta = solve(a.T @ a, a.T @ y, blocks)[0]
        columns, first = [], 0
        for size in blocks:
            columns.append(a[:, first : first + size] @ members[size].T)
            first += size
        dense = nnls(np.hstack(columns), y, maxiter=20000)[1] ** 2
        ours = float(((y - a @ theta) ** 2).sum())
        assert ours <= dense * (1 + 1e-9)
        assert ours >= dense * (1 - 1e-4)  # the grid of r is 0.002 wide


def test_optimum_outside_the_nonnegative_bernstein_set_is_reached():
    """(u - 0.4)^2 + 0.01 is positive with a negative middle Bernstein coefficient."""
    u = np.linspace(0.0, 1.0, 60)
    design = u[:, None] ** np.arange(3)
    wanted = np.array([0.17, -0.8, 1.0])
    assert wanted[0] + wanted[1] / 2.0 < 0.0
    theta = solve(design.T @ design, design.T @ (design @ wanted), (3,))[0]
    np.testing.assert_allclose(theta, wanted, atol=1e-7)


@pytest.mark.parametrize("root", [0.2, 0.5, 0.73])
def test_a_parabola_that_would_dip_below_zero_ends_touching_it(root):
    u = np.linspace(0.0, 1.0, 60)
    design = u[:, None] ** np.arange(3)
    y = (u - root) ** 2 - 0.02
    h, b = design.T @ design, design.T @ y
    theta, generators, weights = solve(h, b, (3,))
    assert abs(minimum_on_unit(theta)) <= 1e-9
    assert 0.1 < -theta[1] / (2.0 * theta[2]) < 0.9
    feasible, dual, slack = certificate(h, b, theta, (3,))
    assert feasible >= -1e-9
    assert dual >= -1e-8
    assert slack <= 1e-8
    directions, bounded = support_directions(generators, weights, np.array([3]))
    # it may move along the bound: two directions, both with no value at the touching point
    touch = -theta[1] / (2.0 * theta[2])
    assert bounded
    assert directions.shape == (3, 2)
    assert np.abs((touch ** np.arange(3)) @ directions).max() <= 1e-5


def test_support_of_an_interior_optimum_is_everything():
    for blocks in BLOCKS:
        sizes = np.array(blocks, dtype=np.int64)
        rng = np.random.default_rng(len(blocks))
        p = int(sizes.sum())
        inside = np.concatenate([[3.0, 0.3, 0.2][:size] for size in blocks])
        a = rng.normal(size=(p + 20, p))
        theta, generators, weights = solve(a.T @ a, a.T @ (a @ inside), blocks)
        directions, bounded = support_directions(generators, weights, sizes)
        np.testing.assert_allclose(theta, inside, rtol=1e-7)
        assert not bounded
        np.testing.assert_allclose(directions @ directions.T, np.eye(p), atol=1e-9)


def test_support_at_an_end_of_the_range_keeps_that_end_at_zero():
    u = np.linspace(0.0, 1.0, 50)
    for degree in (1, 2):
        design = u[:, None] ** np.arange(degree + 1)
        y = -0.3 + 2.0 * u  # negative at u = 0
        sizes = np.array([degree + 1], dtype=np.int64)
        theta, generators, weights = solve(design.T @ design, design.T @ y, tuple(sizes))
        directions, bounded = support_directions(generators, weights, sizes)
        assert minimum_on_unit(theta) == pytest.approx(0.0, abs=1e-10)
        assert bounded
        assert directions.shape[1] < degree + 1


def test_a_block_that_is_zero_has_no_free_direction():
    a = np.eye(4)
    y = np.array([1.0, 0.2, 0.1, -5.0])
    theta, generators, weights = solve(a, y, (3, 1))
    directions, bounded = support_directions(generators, weights, np.array([3, 1]))
    assert theta[3] == 0.0
    assert bounded
    assert directions.shape == (4, 3)
    assert np.abs(directions[3]).max() <= 1e-12


def test_nothing_to_explain_gives_zero():
    theta, generators, weights = solve(np.eye(4), -np.ones(4) * np.array([1.0, 0.0, 0.0, 1.0]), (3, 1))
    assert (theta == 0.0).all()
    directions, bounded = support_directions(generators, weights, np.array([3, 1]))
    assert directions.shape == (4, 0)
    assert bounded


def test_scale_of_a_column_does_not_change_the_solution():
    a, y = random_problem(5, (3, 2))
    first = solve(a.T @ a, a.T @ y, (3, 2))[0]
    scaled = solve(1e12 * a.T @ a, 1e12 * a.T @ y, (3, 2))[0]
    np.testing.assert_allclose(scaled, first, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("blocks", [(3,), (3, 1), (3, 2), (3, 3), (3, 3, 3)])
def test_bounded_is_said_exactly_where_a_polynomial_touches_zero(blocks):
    sizes = np.array(blocks, dtype=np.int64)
    touching = 0
    for seed in range(60):
        a, y = random_problem(seed, blocks)
        theta, generators, weights = solve(a.T @ a, a.T @ y, blocks)
        directions, bounded = support_directions(generators, weights, sizes)
        low = min(minimum_on_unit(q) / max(np.abs(q).max(), 1e-300) for q in split(theta, blocks))
        if 1e-9 < low < 1e-5:
            continue  # too near to call either way
        assert bounded == (low <= 1e-9), (seed, low)
        touching += bounded
        # a small move along a direction, either way, costs passivity by its square at most
        size = 1e-4 * max(np.abs(theta).max(), 1e-300)
        for direction in directions.T:
            for sign in (-size, size):
                moved = split(theta + sign * direction, blocks)
                worst = min(minimum_on_unit(q) for q in moved)
                assert worst >= -size * 1e-2, seed
    assert touching >= 5


def test_free_directions_and_curvature_predict_the_cost_of_a_move_along_the_bound():
    """A parabola that touches zero may slide: its reduced gradient is zero along those directions."""
    u = np.linspace(0.0, 1.0, 60)
    design = u[:, None] ** np.arange(3)
    for root in np.linspace(0.15, 0.85, 15):
        y = (u - root) ** 2 - 0.02
        h, b = design.T @ design, design.T @ y
        theta, generators, weights = solve(h, b, (3,))
        directions, bounded = support_directions(generators, weights, np.array([3]))
        assert bounded
        assert directions.shape[1] == 2
        assert np.abs(directions.T @ (h @ theta - b)).max() <= 1e-5 * np.abs(b).max()
