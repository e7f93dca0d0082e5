"""Mass and draws of a normal cut to the passive set, against closed forms and brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import special, stats

from tissueid.likelihood.normal_tail import excess, hazard, log_tail, tail_quantile
from tissueid.likelihood.passive_normal import draw_passive, log_passive_mass, passive
from tissueid.model.polynomial import minimum_on_unit

#: Seeds are fixed; a family of KS tests fails below this.
KS_LEVEL = 1e-4


def sizes(*blocks):
    return np.array(blocks, dtype=np.int64)


def normal_near_its_bounds(seed, blocks, away=1.0):
    """Mean and covariance of very different scales, with a correlation of some 0.9."""
    rng = np.random.default_rng(seed)
    p = sum(blocks)
    a = rng.normal(size=(p, p + 2))
    together = 3.0 * rng.normal(size=p)
    scale = np.exp(rng.normal(size=p))
    cov = (a @ a.T / (p + 2) + np.outer(together, together)) * np.outer(scale, scale)
    return rng.normal(size=p) * np.sqrt(np.diag(cov)) * away, cov


def plain_draws(mean, cov, n, seed):
    return np.random.default_rng(seed).multivariate_normal(mean, cov, size=n, method="cholesky")


def smallest(theta, blocks):
    """Smallest value of any block on [0, 1], by the model's own function."""
    return min(minimum_on_unit(q) for q in np.split(theta, np.cumsum(blocks)[:-1]))


def test_tail_and_quantile_agree_with_scipy_and_each_other():
    x = np.concatenate([np.linspace(-8.0, 37.0, 400), np.geomspace(40.0, 1e6, 60)])
    tail = np.array([log_tail(v) for v in x])
    # scipy's log_ndtr is good to some 1e-11 near zero crossings of its branches
    np.testing.assert_allclose(tail, special.log_ndtr(-x), rtol=1e-10)
    inner = x > -7.0  # below, one minus the tail has too few digits to come back
    back = np.array([tail_quantile(v) for v in tail[inner]])
    np.testing.assert_allclose(back, x[inner], rtol=1e-12, atol=1e-4 * 1e-9)
    assert tail_quantile(-0.0) < -38.0


def test_hazard_and_excess_agree_with_quadrature_and_their_limits():
    for x in (-5.0, 0.0, 3.0, 24.9, 25.1, 1e4):
        tail = log_tail(x)
        t = np.linspace(0.0, 60.0 / max(x, 1.0), 200_001)
        weight = np.exp(-x * t - 0.5 * t * t) if x > 0.0 else np.exp(-0.5 * (x + t) ** 2)
        # trapezoid of 200,000 steps: 1e-9
        assert excess(x, tail) == pytest.approx(float((t * weight).sum() / weight[1:].sum()), rel=2e-3)
        assert hazard(x, tail) == pytest.approx(x + excess(x, tail), rel=1e-9)


@pytest.mark.parametrize("away", [-30.0, -3.0, 0.0, 2.0, 7.5])
def test_mass_of_one_coefficient_is_the_normal_tail(away):
    mass = log_passive_mass(np.array([away * 0.7]), np.array([[0.49]]), sizes(1))
    assert mass == pytest.approx(float(special.log_ndtr(away)), rel=1e-10)


@pytest.mark.parametrize("rho", [-0.9, -0.3, 0.0, 0.6, 0.99])
def test_mass_of_a_line_around_zero_is_the_orthant_probability(rho):
    """Bernstein coefficients with correlation rho: 1/4 + asin(rho) / (2 pi)."""
    to_powers = np.array([[1.0, 0.0], [-1.0, 1.0]])
    cov = to_powers @ np.array([[4.0, 2.0 * rho], [2.0 * rho, 1.0]]) @ to_powers.T
    wanted = math.log(0.25 + math.asin(rho) / (2.0 * math.pi))
    # the stated error for two coordinates
    assert log_passive_mass(np.zeros(2), cov, sizes(2)) == pytest.approx(wanted, abs=5e-4)


def test_mass_of_independent_coefficients_far_outside_is_a_product_of_tails():
    """Down to 1e-300, and with one bound that is far only before the others cut."""
    for away in ((-20.0, -30.0, 1.0), (-36.0, 2.0, -3.0), (-10.0, 3.0, 9.0)):
        mean = np.array(away)
        wanted = float(special.log_ndtr(mean).sum())
        assert log_passive_mass(mean, np.eye(3), sizes(1, 1, 1)) == pytest.approx(wanted, abs=1e-6)


def test_mass_counts_a_bound_that_only_the_cut_normal_meets():
    """The second coefficient is 9 sd from zero, but not given the first one's tail."""
    rho = -0.95
    cov = np.array([[1.0, rho], [rho, 1.0]])
    mean = np.array([-9.0, 9.0])
    draws = np.random.default_rng(5)
    first = stats.truncnorm(9.0, np.inf, loc=-9.0).rvs(size=300_000, random_state=draws)
    second = 9.0 + rho * (first + 9.0)
    inside = special.ndtr(second / math.sqrt(1.0 - rho**2))
    wanted = float(special.log_ndtr(-9.0)) + math.log(inside.mean())
    error = inside.std() / inside.mean() / math.sqrt(inside.size)
    assert log_passive_mass(mean, cov, sizes(1, 1)) == pytest.approx(wanted, abs=5e-4 + 4.0 * error)


@pytest.mark.needs_jit
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("blocks", [(2,), (3,), (3, 2), (3, 3), (3, 2, 2)])
def test_mass_agrees_with_brute_force(blocks, seed):
    mean, cov = normal_near_its_bounds(seed, blocks)
    n = 200_000
    share = passive(plain_draws(mean, cov, n, seed), sizes(*blocks)).mean()
    mass = log_passive_mass(mean, cov, sizes(*blocks))
    if share * n < 100:  # too rare to be counted, and said to be
        assert mass <= math.log(200.0 / n)
        return
    error = math.sqrt((1.0 - share) / share / n)
    # 64 points: 5e-4 for a line, 2e-2 for one parabola, 0.15 for several at correlations of 0.9
    stated = {1: 2e-2, 2: 0.15, 3: 0.15}[len(blocks)] if max(blocks) > 2 else 5e-4
    assert mass == pytest.approx(math.log(share), abs=4.0 * error + stated)


@pytest.mark.needs_jit
def test_error_of_the_mass_is_small_on_average():
    """Median over problems of the difference to brute force: not above its own noise plus 5e-3."""
    gaps, noise = [], []
    n = 200_000
    for seed in range(20):
        mean, cov = normal_near_its_bounds(seed, (3, 2), away=0.5)
        share = passive(plain_draws(mean, cov, n, 77 + seed), sizes(3, 2)).mean()
        if share * n > 2000:
            gaps.append(abs(log_passive_mass(mean, cov, sizes(3, 2)) - math.log(share)))
            noise.append(math.sqrt((1.0 - share) / share / n))
    assert len(gaps) >= 8
    assert np.median(gaps) <= np.median(noise) + 5e-3


@pytest.mark.needs_jit
def test_mass_far_inside_is_one_exactly_and_smooth_on_the_way():
    cov = np.diag([1.0, 2.0, 0.5, 1.0, 0.2])
    mean = np.array([100.0, 3.0, -2.0, 40.0, 1.0])
    assert log_passive_mass(mean, cov, sizes(3, 2)) == 0.0
    line = np.linspace(-5.0, 12.0, 1701)
    values = np.array([log_passive_mass(np.array([1.0, 0.5, 0.0, v, 0.1]), cov, sizes(3, 2)) for v in line])
    steps = np.diff(values)
    # more mass further in, and no jump: second differences stay at those of a smooth curve
    assert (steps >= -1e-6).all()
    assert np.abs(np.diff(steps)).max() <= 3e-4


def test_mass_keeps_its_accuracy_under_a_change_of_scale():
    mean, cov = normal_near_its_bounds(4, (3, 2))
    here = log_passive_mass(mean, cov, sizes(3, 2))
    assert log_passive_mass(1e-6 * mean, 1e-12 * cov, sizes(3, 2)) == pytest.approx(here, abs=1e-9)


@pytest.mark.needs_jit
@pytest.mark.parametrize("blocks", [(1,), (2,), (3,), (3, 2), (3, 1, 1), (3, 3)])
def test_draws_have_the_distribution_of_plain_rejection(blocks):
    n, lowest = 4000, 1.0
    for seed in range(4):
        mean, cov = normal_near_its_bounds(10 + seed, blocks)
        plain = plain_draws(mean, cov, 200_000, seed)
        kept = plain[passive(plain, sizes(*blocks))][: 4 * n]
        if kept.shape[0] < 500:
            continue
        tiled = np.broadcast_to(cov, (n, *cov.shape))
        theta, acceptance = draw_passive(
            np.tile(mean, (n, 1)), tiled, sizes(*blocks), np.random.default_rng(seed)
        )
        assert 0.0 < acceptance <= 1.0
        assert all(smallest(row, blocks) >= 0.0 for row in theta[:500])
        mixture = np.random.default_rng(seed).normal(size=(2, sum(blocks))) / np.sqrt(np.diag(cov))
        for direction in np.vstack([np.eye(sum(blocks)), mixture]):
            lowest = min(lowest, float(stats.ks_2samp(theta @ direction, kept @ direction).pvalue))
    assert lowest < 1.0
    assert lowest >= KS_LEVEL


@pytest.mark.needs_jit
def test_draws_where_plain_rejection_is_hopeless_are_the_cut_normal():
    """A line whose ends are 12 and 20 sd below zero, correlated: against quadrature on a grid."""
    bernstein_mean = np.array([-12.0, -10.0])
    bernstein_cov = np.array([[1.0, -0.4], [-0.4, 0.25]])
    to_powers = np.array([[1.0, 0.0], [-1.0, 1.0]])
    n = 4000
    mean = np.tile(to_powers @ bernstein_mean, (n, 1))
    cov = np.broadcast_to(to_powers @ bernstein_cov @ to_powers.T, (n, 2, 2))
    theta, _ = draw_passive(mean, cov, sizes(2), np.random.default_rng(8))
    c0, c1 = theta[:, 0], theta.sum(axis=1)
    grid = (np.arange(1600) + 0.5) * 6.25e-4
    a, b = np.meshgrid(grid - bernstein_mean[0], grid - bernstein_mean[1], indexing="ij")
    inverse = np.linalg.inv(bernstein_cov)
    density = -0.5 * (inverse[0, 0] * a * a + 2.0 * inverse[0, 1] * a * b + inverse[1, 1] * b * b)
    density = np.exp(density - density.max())
    for draws, marginal in ((c0, density.sum(axis=1)), (c1, density.sum(axis=0))):
        # cells of 6.25e-4: their right edges carry the cumulative sums
        cumulative = np.append(0.0, np.cumsum(marginal) / marginal.sum())
        edges = np.append(0.0, grid + 3.125e-4)
        assert stats.kstest(np.interp(draws, edges, cumulative), "uniform").pvalue >= KS_LEVEL


@pytest.mark.needs_jit
@pytest.mark.parametrize("away", [5.0, 15.0])
def test_every_draw_is_passive_however_far_outside_the_mean_is(away):
    for seed in range(25):
        blocks = ((3,), (3, 2), (3, 3), (3, 3, 3, 3))[seed % 4]
        mean, cov = normal_near_its_bounds(seed, blocks, away=away)
        theta, _ = draw_passive(
            np.tile(mean, (3, 1)),
            np.broadcast_to(cov, (3, *cov.shape)),
            sizes(*blocks),
            np.random.default_rng(1),
        )
        assert passive(theta, sizes(*blocks)).all(), (seed, blocks)


def test_a_chain_stands_in_where_no_saddle_point_is_found():
    """A correlation of 0.999999 and a mean far outside: Newton's method fails for some of these."""
    for seed in range(30):
        rng = np.random.default_rng(seed)
        together = 300.0 * rng.normal(size=6)
        a = rng.normal(size=(6, 8))
        cov = a @ a.T / 8.0 + np.outer(together, together)
        mean = 30.0 * rng.normal(size=6) * np.sqrt(np.diag(cov))
        theta, _ = draw_passive(mean[None, :], cov[None, :, :], sizes(3, 3), np.random.default_rng(1))
        assert passive(theta, sizes(3, 3)).all(), seed
        assert np.isfinite(theta).all()


def test_draws_follow_from_the_seed_alone():
    mean, cov = normal_near_its_bounds(3, (3, 2))
    means, covs = np.tile(mean, (50, 1)), np.broadcast_to(cov, (50, 5, 5))
    first, _ = draw_passive(means, covs, sizes(3, 2), np.random.default_rng(9))
    again, _ = draw_passive(means, covs, sizes(3, 2), np.random.default_rng(9))
    other, _ = draw_passive(means, covs, sizes(3, 2), np.random.default_rng(10))
    assert (first == again).all()
    assert (first != other).any()


def test_passive_is_the_models_own_test():
    rng = np.random.default_rng(2)
    for blocks in ((1,), (2,), (3,), (3, 2, 1)):
        theta = rng.normal(size=(3000, sum(blocks))) + 0.4
        wanted = np.array([smallest(row, blocks) >= 0.0 for row in theta])
        assert 50 < wanted.sum() < 2950
        assert (passive(theta, sizes(*blocks)) == wanted).all()
