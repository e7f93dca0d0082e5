"""Draws of a normal cut by half spaces, and a mixture that learns: against rejection and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from density_cases import COVARIANCE, MEAN, banana, correlated

from tissueid.inference.proposal import CHAINS, WIDER, _truncated, cut_normal, learn_mixture
from tissueid.inference.sampling import smoothed

CORNERS = {
    "a wedge": (np.array([1.0, -2.0]), np.array([[1.0, 0.0], [-0.8, 0.6]]), np.array([0.0, -0.5])),
    "a slab": (np.array([0.3, 0.2]), np.array([[1.0, 1.0], [-1.0, -1.0]]), np.array([-0.4, -0.9])),
    "a corner": (np.array([-0.5, -0.5, 0.7]), np.eye(3), np.array([-0.2, 0.0, -1.0])),
    "a skewed cone": (
        np.array([0.2, -0.4, 0.1]),
        np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.2], [-1.0, 0.3, 1.0], [0.0, -1.0, 2.0]]),
        np.zeros(4),
    ),
}


def rejected(centre, rows, least, count=6_000):
    rng = np.random.default_rng(99)
    kept = []
    while sum(map(len, kept)) < count:
        z = centre + WIDER * rng.standard_normal((200_000, centre.size))
        kept.append(z[(z @ rows.T >= least).all(axis=1)])
    return np.concatenate(kept)[: 4 * count]


@pytest.mark.parametrize("case", list(CORNERS))
@pytest.mark.parametrize("likely", [True, False])
def test_moments_are_those_of_plain_rejection(case, likely):
    centre, rows, least = CORNERS[case]
    chosen = np.arange(len(rows)) if likely else np.empty(0, dtype=np.int64)
    found = cut_normal(centre, rows, least, chosen, np.random.default_rng(5)).pool
    assert (found @ rows.T >= least - 1e-9).all()
    expected = rejected(centre, rows, least)
    sd = expected.std(axis=0)
    # a thousand independent chains: four standard errors of a mean, of an sd and of a correlation
    assert (np.abs(found.mean(axis=0) - expected.mean(axis=0)) <= 4.0 * sd / np.sqrt(CHAINS)).all()
    assert found.std(axis=0) == pytest.approx(sd, rel=4.0 * 0.75 / np.sqrt(CHAINS))
    np.testing.assert_allclose(np.corrcoef(found.T), np.corrcoef(expected.T), atol=4.0 / np.sqrt(CHAINS))


def test_a_wall_far_in_the_tail_leaves_an_exponential():
    rng = np.random.default_rng(6)
    ends = np.full(4_000, 40.0)
    z = _truncated(np.zeros(4_000), 1.0, ends, np.full(4_000, np.inf), rng.random(4_000))
    assert (z >= 40.0).all()
    # beyond 40 sd the normal falls with rate 40
    assert (z - 40.0).mean() == pytest.approx(1.0 / 40.0, rel=0.08)


def test_the_density_is_that_of_the_draws():
    cut = cut_normal(*CORNERS["a slab"], np.arange(2), np.random.default_rng(7))
    a, b = np.array([[0.3, 0.2], [0.8, -0.1]])
    ratio = cut.log_density(a[None]) - cut.log_density(b[None])
    assert ratio[0] == pytest.approx(0.5 * ((b - [0.3, 0.2]) ** 2).sum() / WIDER**2)


def weighed(target, seed=1, count=6_000):
    rng = np.random.default_rng(seed)
    cut = cut_normal(target.centre, target.rows, target.walls, target.likely, rng)
    mixture, efficiency = learn_mixture(target, cut, rng)
    z = mixture.draw(count, rng)
    found = smoothed(target.densities(z) - mixture.log_density(z))
    return z, found, efficiency


def test_a_mixture_learns_a_banana():
    z, found, efficiency = weighed(banana())
    # the normal at the top of it covers a fifth of its curvature
    assert efficiency > 0.4
    assert found.worth > 0.35 * len(z)
    assert found.pareto < 0.6
    # E y = 0, var y = 2 + 0.16; 2,000 effective draws, y^2 with a heavy tail
    assert float(found.weights @ z[:, 0]) == pytest.approx(0.0, abs=0.1)
    assert float(found.weights @ z[:, 0] ** 2) == pytest.approx(1.0, abs=0.12)
    assert float(found.weights @ z[:, 1]) == pytest.approx(0.0, abs=0.12)
    assert float(found.weights @ z[:, 1] ** 2) == pytest.approx(2.16, abs=0.6)


def test_a_mixture_of_a_normal_is_about_that_normal():
    z, found, efficiency = weighed(correlated())
    assert efficiency > 0.5
    mean = found.weights @ z
    covariance = (z - mean).T @ ((z - mean) * found.weights[:, None])
    np.testing.assert_allclose(mean, MEAN, atol=0.1)
    np.testing.assert_allclose(covariance, COVARIANCE, atol=0.15)


def test_the_density_of_a_mixture_is_normalised():
    target = banana()
    rng = np.random.default_rng(3)
    cut = cut_normal(target.centre, target.rows, target.walls, target.likely, rng)
    mixture, _ = learn_mixture(target, cut, rng)
    edge = np.linspace(-40.0, 40.0, 401)
    grid = np.stack(np.meshgrid(edge, edge), axis=-1).reshape(-1, 2)
    # six degrees of freedom leave 1e-5 beyond
    assert np.exp(mixture.log_density(grid)).sum() * 0.04 == pytest.approx(1.0, abs=2e-3)
