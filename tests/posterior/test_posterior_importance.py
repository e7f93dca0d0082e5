"""Adaptive importance sampling against densities whose moments are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import genpareto, norm

from tissueid.posterior.importance import importance_sample, smoothed, tail_shape

CORRELATION = np.array([[1.0, 0.8, -0.5], [0.8, 1.0, 0.0], [-0.5, 0.0, 1.0]])
LOWER = np.array([-np.inf, 0.0, -np.inf])
UPPER = np.full(3, np.inf)


def correlated(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A normal around (0, 0.5, 0) whose second coordinate is cut at 0; beside each point its square."""
    away = points - [0.0, 0.5, 0.0]
    density = -0.5 * np.einsum("ni,ij,nj->n", away, np.linalg.inv(CORRELATION), away)
    return np.where(points[:, 1] >= 0.0, density, -np.inf), points**2


def sampled(seed: int, size: float = 1_500.0):
    start = np.array([0.5, 1.5, -0.5])
    return importance_sample(
        correlated, start, np.eye(3) * 0.3, LOWER, UPPER, np.random.default_rng(seed), size=size
    )


def test_moments_and_quantiles_of_a_cut_normal_are_found() -> None:
    found = sampled(1)
    # closed form: a normal cut from below at -0.5 sd, and what is regressed on it
    hazard = norm.pdf(-0.5) / norm.sf(-0.5)
    cut_mean, cut_variance = 0.5 + hazard, 1.0 - hazard * (hazard + 0.5)
    mean = found.weights @ found.points
    error = 4.0 / np.sqrt(found.size)
    assert mean == pytest.approx([0.8 * hazard, cut_mean, 0.0], abs=error)
    assert found.weights @ (found.points[:, 1] - cut_mean) ** 2 == pytest.approx(cut_variance, abs=error)
    order = np.argsort(found.points[:, 1])
    below = np.cumsum(found.weights[order])
    low = found.points[order][np.searchsorted(below, 0.025), 1]
    exact = 0.5 + norm.isf(norm.sf(-0.5) * 0.975)
    assert low == pytest.approx(exact, abs=0.03)
    assert found.converged
    assert found.size >= 1_000.0
    assert found.extra == pytest.approx(found.points**2)


def test_no_point_is_below_its_cut() -> None:
    assert (sampled(2).points[:, 1] >= 0.0).all()


def test_an_upper_cut_is_folded_like_a_lower_one() -> None:
    def mirrored(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        return correlated(-points, rng)

    found = importance_sample(
        mirrored, np.array([-0.5, -1.5, 0.5]), np.eye(3) * 0.3, -UPPER, -LOWER, np.random.default_rng(1),
        size=1_500.0,
    )  # fmt: skip
    assert (found.points[:, 1] <= 0.0).all()
    one = sampled(1)
    error = 4.0 * (found.size**-0.5 + one.size**-0.5)
    assert found.weights @ found.points == pytest.approx(-(one.weights @ one.points), abs=error)


def test_a_seed_gives_the_same_draws() -> None:
    one, two = sampled(3), sampled(3)
    assert np.array_equal(one.points, two.points)
    assert np.array_equal(one.weights, two.weights)


def test_a_tail_that_no_proposal_reaches_is_told() -> None:
    def heavy(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        return -0.55 * np.log1p(points[:, 0] ** 2 * 1e4), points

    found = importance_sample(
        heavy,
        np.zeros(1),
        np.eye(1) * 1e-4,
        np.array([-np.inf]),
        np.array([np.inf]),
        np.random.default_rng(4),
        size=1e9,
    )
    assert not found.converged


@pytest.mark.parametrize("shape", [-0.2, 0.3, 0.8])
def test_shape_of_a_pareto_tail_is_found(shape: float) -> None:
    excess = np.sort(genpareto.rvs(shape, scale=2.0, size=4_000, random_state=5))
    found, scale = tail_shape(excess)
    # four standard errors: (1 + shape) / sqrt(n)
    assert found == pytest.approx(shape, abs=4.0 * (1.0 + shape) / np.sqrt(4_000))
    assert scale == pytest.approx(2.0, rel=0.15)


def test_smoothing_is_that_of_arviz() -> None:
    from arviz_stats.base import array_stats

    logs = np.log(np.abs(np.random.default_rng(6).standard_t(3.0, 3_000)))
    weights = np.exp(logs - logs.max())
    ours, shape = smoothed(weights / weights.sum())
    theirs, theirs_shape = array_stats.psislw(-logs)
    theirs = np.exp(theirs - theirs.max())
    assert shape == pytest.approx(float(theirs_shape), abs=1e-9)
    assert ours == pytest.approx(theirs / theirs.sum(), abs=1e-12)


def test_equal_weights_have_no_tail() -> None:
    weights, shape = smoothed(np.full(100, 0.01))
    assert weights == pytest.approx(0.01)
    assert shape == np.inf


def test_a_weight_that_stands_for_all_is_told() -> None:
    raw = np.exp(-600.0 * np.random.default_rng(7).random(1_000))
    raw[0] = 1e9
    weights, shape = smoothed(raw / raw.sum())
    assert np.isfinite(weights).all()
    assert weights.sum() == pytest.approx(1.0)
    assert not shape < 0.7
