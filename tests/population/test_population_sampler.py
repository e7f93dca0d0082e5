"""The sampler against a grid, its own calibration, other samplers, and numbers that another one gave."""

import math
from dataclasses import replace

import emcee
import numpy as np
import pytest
from cohort_factory import lkj_factor, monte_carlo_errors, normal_stage, plain_design
from scipy.special import gammaln
from scipy.stats import norm

from tissueid.population.chains import Scales, ScalesDensity, ScalesMove
from tissueid.population.sampler import PopulationDraws, SamplerOptions, sample_population
from tissueid.population.stage_one import Design, StageOne
from tissueid.priors import PopulationPriors, SpreadPrior


def on_a_grid(y: np.ndarray, own: np.ndarray, priors: PopulationPriors) -> dict[str, float]:
    """Mean of mu and of ln D of a normal population in one dimension, by summation over a fine grid."""
    log_sd = np.linspace(np.log(0.005), np.log(3.0), 1200)
    mu = np.linspace(y.mean() - 2.0, y.mean() + 2.0, 2001)
    variance = np.exp(2.0 * log_sd)[:, None] + own**2
    square = ((y[None, None, :] - mu[None, :, None]) ** 2) / variance[:, None, :]
    level = -0.5 * (np.log(variance).sum(axis=1)[:, None] + square.sum(axis=2))
    between = priors.between
    level = level - 0.5 * (((log_sd - np.log(between.median)) / between.sd_ln) ** 2)[:, None]
    level = level - 0.5 * (mu / priors.mean_sd) ** 2
    weight = np.exp(level - level.max())
    weight /= weight.sum()
    return {
        "mean": float((weight.sum(axis=0) * mu).sum()),
        "ln_sd": float((weight.sum(axis=1) * log_sd).sum()),
    }


# Draws alone, and smooth likelihoods alone: the recordings tell less than the population, or more.
@pytest.mark.parametrize(("own", "smooth"), [(0.05, 0), (0.8, 12)])
def test_a_normal_population_of_one_number_is_that_of_a_grid(own, smooth):
    rng = np.random.default_rng(4)
    y = 1.0 + 0.2 * rng.standard_normal(12) + own * rng.standard_normal(12)
    # quantiles of each likelihood as its draws: no Monte-Carlo error of stage 1
    unit = norm.ppf((np.arange(4000) + 0.5) / 4000)
    phi, weights = tuple((one + own * unit)[:, None] for one in y), tuple(np.zeros(4000) for _ in y)
    stage, priors = StageOne(phi, weights, np.zeros(1, bool), np.zeros(0, np.int64)), PopulationPriors()
    options = SamplerOptions(tails="normal", draws=12_800, blocks=2)
    found = sample_population(stage, plain_design(12), priors, options)
    assert found.smoothed.size == smooth
    assert found.converged
    draws = {"mean": found.coefficient[:, :, 0, 0], "ln_sd": np.log(found.sd[:, :, 0])}
    expected = on_a_grid(y, np.full(12, own), priors)
    for name, values in draws.items():
        # four Monte-Carlo errors, and 0.5 % for 4000 quantiles that end at 3.7 sd
        error = 4.0 * monte_carlo_errors(values)[0] + 0.005
        assert values.mean() == pytest.approx(expected[name], abs=error)


def test_the_slope_of_the_density_of_scales_is_its_change():
    rng = np.random.default_rng(6)
    p, count = 4, 3
    deviations = rng.standard_normal((count, 9, p))
    sums = deviations.swapaxes(1, 2) @ deviations
    density = ScalesDensity(sums, np.full(count, 9.0), np.array([-1.0, 0.4, 2.0]))
    log_sd, z = 0.4 * rng.standard_normal((count, p)), np.tril(rng.standard_normal((count, p, p)), -1)
    slope = density(Scales(log_sd, z))[1]
    for k in range(p):
        for j in range(k + 1):
            # the diagonal stands for ln D
            step = 1e-5 * ((np.arange(p)[:, None] == k) & (np.arange(p) == j))
            steps = [Scales(log_sd + s * np.diag(step), z + s * np.tril(step, -1)) for s in (1, -1)]
            ends = [density(one)[0] for one in steps]
            expected = slope.log_sd[:, k] if j == k else slope.z[:, k, j]
            # a second-order difference of a density of some tens
            assert (ends[0] - ends[1]) / 2e-5 == pytest.approx(expected, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize(("p", "n"), [(1, 5), (3, 12), (5, 3)])
def test_scales_follow_prior_and_data_together(p, n):
    # simulation-based calibration of the part for spreads and correlations alone: ranks are uniform
    rng = np.random.default_rng(5)
    count, prior = 400, np.array([np.log(0.15), 0.3, 2.0])
    log_sd = rng.normal(prior[0], prior[1], (count, p))
    low = np.array([lkj_factor(rng, p, prior[2]) for _ in range(count)])
    deviations = (rng.standard_normal((count, n, p)) @ low.swapaxes(1, 2)) * np.exp(log_sd)[:, None]
    density = ScalesDensity(deviations.swapaxes(1, 2) @ deviations, np.full(count, float(n)), prior)
    move = ScalesMove(p, n, prior)
    now = Scales(np.full((count, p), prior[0]), np.zeros((count, p, p)))
    above = np.zeros((count, p + 1))
    for sweep in range(240):
        now = move(rng, now, density, adapt=sweep < 40)
        if sweep >= 40:
            above[:, :p] += now.log_sd < log_sd
            above[:, p] += (now.low @ now.low.swapaxes(1, 2))[:, -1, 0] < (low @ low.swapaxes(1, 2))[:, -1, 0]
    ranks = above[:, : p + (p > 1)] / 200.0
    inside = ((ranks >= 0.05) & (ranks <= 0.95)).mean(axis=0)
    # 90 % of 400: a standard deviation of 1.5 %, six numbers, 3.5 of them
    assert inside == pytest.approx(0.9, abs=0.053)
    # means of uniform ranks: 0.5 with 0.29 / sqrt(400) = 0.0145
    assert ranks.mean(axis=0) == pytest.approx(0.5, abs=0.051)


def test_chains_that_were_thrown_into_a_corner_come_back():
    # correlations of 0.995, where the data have none: steps that suit the other chains are all refused there
    rng = np.random.default_rng(8)
    p, n, count, prior = 5, 17, 64, np.array([np.log(0.15), 0.3, 2.0])
    deviations = 0.15 * rng.standard_normal((n, p))
    sums = np.tile(deviations.T @ deviations, (count, 1, 1))
    density, move = ScalesDensity(sums, np.full(count, float(n)), prior), ScalesMove(p, n, prior)
    now = Scales(np.full((count, p), prior[0]), np.zeros((count, p, p)))
    for sweep in range(240):
        if sweep == 40:
            now.z[:8, 1, 0] = now.z[:8, 3, 2] = 3.0
        now = move(rng, now, density, adapt=sweep < 40)
    assert np.abs(now.z[:8]).max() < 2.0


def test_heavy_tails_are_found_and_the_outlier_is_named():
    rng = np.random.default_rng(8)
    places = 0.1 * rng.standard_normal((30, 2))
    places[13] = (1.2, -0.9)
    stage = normal_stage(places, np.full(2, 0.02), rng, draws=600)
    found = sample_population(stage, plain_design(30), None, SamplerOptions(blocks=2))
    assert int(found.far.argmax()) == 13
    assert found.far[13] > 0.99
    # the others make the mean: nine standard deviations off would move it by 0.04
    assert np.abs(np.median(found.mean, axis=0)).max() < 0.06
    assert np.median(found.nu) < 10.0


def test_the_same_seed_gives_the_same_draws():
    rng = np.random.default_rng(10)
    stage = normal_stage(0.2 * rng.standard_normal((6, 2)), np.array([0.02, 3.0]), rng, draws=600)
    short = SamplerOptions(settle=10, draws=640, blocks=1, seed=3)
    one, two = (sample_population(stage, plain_design(6), None, short) for _ in range(2))
    assert one.smoothed.size > 0
    assert np.array_equal(one.coefficient, two.coefficient)
    assert np.array_equal(one.nu, two.nu)


def test_stated_priors_are_used():
    rng = np.random.default_rng(13)
    stage = normal_stage(0.4 * rng.standard_normal((4, 2)), np.full(2, 0.02), rng, draws=500)
    tight = PopulationPriors(between=SpreadPrior(0.05, 0.05))
    found = sample_population(stage, plain_design(4), tight, SamplerOptions(tails="normal", blocks=1))
    # a prior of 5 % on the spread outweighs four specimens that spread eight times as far
    assert np.median(found.sd) < 0.075


SPECIMENS, SIZE = 5, 2


def joint_density(points: np.ndarray, measured: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Ln density of mean, spread, correlation, tails and the places of all specimens; shape (n,)."""
    priors = PopulationPriors()
    mean, log_sd, z, log_nu = points[:, :2], points[:, 2:4], points[:, 4], points[:, 5]
    places = points[:, 6:].reshape(-1, SPECIMENS, SIZE)
    r, nu = np.tanh(z), np.exp(log_nu)
    away = (places - mean[:, None, :]) * np.exp(-log_sd)[:, None, :]
    square = away[..., 0] ** 2 - 2.0 * r[:, None] * away[..., 0] * away[..., 1] + away[..., 1] ** 2
    square /= (1.0 - r**2)[:, None]
    t = gammaln(0.5 * (nu + 2)) - gammaln(0.5 * nu) - np.log(nu)
    t -= log_sd.sum(axis=1) + 0.5 * np.log1p(-(r**2))
    value = SPECIMENS * t - 0.5 * (nu + 2) * np.log1p(square / nu[:, None]).sum(axis=1)
    value += -0.5 * (((measured - places) / own) ** 2).sum(axis=(1, 2))
    value += -0.5 * ((mean / priors.mean_sd) ** 2).sum(axis=1)
    value += -0.5 * (((log_sd - math.log(priors.between.median)) / priors.between.sd_ln) ** 2).sum(axis=1)
    # LKJ of a 2 x 2 matrix: (1 - r^2)^(shape - 1), times dr/dz
    value += priors.correlation_shape * np.log1p(-(r**2))
    value += priors.tail_shape * log_nu - priors.tail_rate * nu
    return np.where((nu >= 1.0) & (nu <= 1e4) & np.isfinite(value), value, -np.inf)


# Recordings that tell more than the population (draws alone), and less (smooth likelihoods).
@pytest.mark.slow
@pytest.mark.parametrize(("own", "smooth"), [((0.03, 0.05), 0), ((0.03, 0.6), SPECIMENS)])
def test_two_stages_agree_with_joint_sampling(own, smooth):
    rng = np.random.default_rng(21)
    sd = np.array(own)
    measured = np.array([1.0, -2.0]) + np.array([0.15, 0.2]) * rng.standard_normal((SPECIMENS, SIZE))
    measured = measured + sd * rng.standard_normal(measured.shape)
    # the draws of stage 1 with exactly these means and spreads: its Monte-Carlo error is no part of this
    stage = normal_stage(measured, np.zeros(SIZE) + 1e-12, rng, draws=4)
    unit = rng.standard_normal((20_000, SIZE))
    unit = (unit - unit.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(unit.T))).T
    phi, weights = tuple(one + sd * unit for one in measured), tuple(np.zeros(len(unit)) for _ in measured)
    stage = replace(stage, phi=phi, log_reference=weights)
    options = SamplerOptions(draws=64_000, blocks=1, settle=200)
    two = sample_population(stage, plain_design(SPECIMENS), None, options)
    walkers = 64
    start = np.concatenate([measured.mean(axis=0), np.log([0.2, 0.2]), [0.0, 2.0], measured.ravel()])
    spread = np.concatenate([[0.1, 0.1, 0.2, 0.2, 0.2, 0.3], np.tile(0.3 * sd, SPECIMENS)])
    sampler = emcee.EnsembleSampler(
        walkers,
        start.size,
        joint_density,
        args=(measured, sd),
        vectorize=True,
        # not the snooker of emcee 3.1.6, which does not leave the density as it is
        moves=[(emcee.moves.DEMove(), 0.8), (emcee.moves.StretchMove(), 0.2)],
    )
    sampler.random_state = np.random.RandomState(5).get_state()
    sampler.run_mcmc(start + spread * rng.standard_normal((walkers, start.size)), 16_000)
    assert two.smoothed.size == smooth
    assert two.converged
    joint = sampler.get_chain(discard=3000, thin=20).swapaxes(0, 1)[:, :, :6]
    parts = [two.coefficient[:, :, 0], np.log(two.sd), np.arctanh(two.correlation[:, :, 1, :1])]
    staged = np.concatenate([*parts, np.log(two.nu)[..., None]], axis=2)
    for k in range(joint.shape[2]):
        # four Monte-Carlo errors of the difference
        mean, spread_of = 4.0 * np.hypot(*(monte_carlo_errors(one[:, :, k]) for one in (joint, staged)))
        assert joint[:, :, k].mean() == pytest.approx(staged[:, :, k].mean(), abs=mean)
        assert joint[:, :, k].std() == pytest.approx(staged[:, :, k].std(), abs=spread_of)


MANY, NUMBERS, OUTLIER = 24, 3, 13


def stage_and_design(own: np.ndarray) -> tuple[StageOne, Design]:
    """Specimens of eight donors along a covariate, one of them far off, known to ``own``."""
    rng = np.random.default_rng(61)
    x = np.linspace(-1.5, 1.5, MANY)
    donor = np.arange(MANY) // 3
    places = np.array([1.0, -2.0, 0.5]) + np.outer(x, [0.2, 0.0, -0.1])
    places = places + 0.15 * rng.standard_normal((8, NUMBERS))[donor]
    common = rng.standard_normal((MANY, 1))
    places = places + 0.1 * (0.8 * common + 0.6 * rng.standard_normal((MANY, NUMBERS)))
    places[OUTLIER] += [0.9, -0.9, 0.9]
    design = Design(np.column_stack([np.ones(MANY), x]), ("mean", "x"), donor[None, :], ("donor",))
    return normal_stage(places, own, rng, draws=1500), design


#: Means, then standard deviations, of what :func:`numbers` gives; errors are 3 % of the latter.
EXPECTED = {
    "held": """
1.024 -2.045 0.546 0.195 0.117 -0.097 -1.569 -2.656 -2.032 -2.340 -2.037 -2.439 0.194 0.633 0.380 1.209
0.084 0.046 0.058 0.082 0.050 0.062 0.275 0.521 0.360 0.242 0.226 0.249 0.251 0.186 0.237 0.431
""",
    "mixed": """
1.017 -2.059 0.533 0.194 0.145 -0.088 -1.691 -2.636 -1.881 -2.178 -1.958 -2.327 -0.085 0.630 0.162 1.394
0.078 0.051 0.067 0.080 0.054 0.072 0.341 0.534 0.372 0.281 0.250 0.280 0.280 0.234 0.297 0.500
""",
    "smooth": """
1.027 -2.056 0.493 0.208 0.109 -0.141 -1.564 -2.669 -2.424 -2.159 -1.901 -2.260 -0.016 0.142 -0.117 1.478
0.089 0.049 0.098 0.093 0.054 0.107 0.308 0.536 0.624 0.284 0.240 0.504 0.270 0.364 0.373 0.579
""",
}
#: Probability that the outlier, and that another specimen, is far from the others.
FAR = {"held": (1.0, 0.579), "mixed": (1.0, 0.535), "smooth": (0.999, 0.579)}
OTHER = 3
#: Recordings that place all specimens well, five of them badly, and all badly in one number.
OWN = {
    "held": np.tile([0.02, 0.02, 0.03], (MANY, 1)),
    "mixed": np.where(np.arange(MANY)[:, None] % 5 == 1, [0.3, 0.3, 0.6], [0.02, 0.02, 0.03]),
    "smooth": np.tile([0.03, 0.05, 0.4], (MANY, 1)),
}


def numbers(found: PopulationDraws) -> np.ndarray:
    """Draws of mean, effects, ln spreads, correlations and ln tails; shape (chains, sweeps, 16)."""
    shape = found.nu.shape
    below = np.tril_indices(NUMBERS, -1)
    parts = [found.coefficient, np.log(found.level_sd), np.log(found.sd), found.correlation[:, :, *below]]
    return np.concatenate([*(one.reshape(*shape, -1) for one in parts), np.log(found.nu)[..., None]], axis=2)


@pytest.mark.parametrize(("name", "smooth"), [("held", 0), ("mixed", 5), ("smooth", MANY)])
def test_numbers_are_those_of_long_chains_of_another_sampler(name, smooth):
    stage, design = stage_and_design(OWN[name])
    found = sample_population(stage, design, None, SamplerOptions(draws=9600, blocks=1))
    assert found.smoothed.size == smooth
    draws = numbers(found)
    mean, sd = np.loadtxt(EXPECTED[name].split("\n")[1:-1])
    # four errors of each of 96 differences
    for k in range(draws.shape[2]):
        of_mean, of_sd = 4.0 * np.hypot(monte_carlo_errors(draws[:, :, k]), 0.03 * sd[k])
        assert draws[:, :, k].mean() == pytest.approx(mean[k], abs=of_mean), k
        assert draws[:, :, k].std() == pytest.approx(sd[k], abs=of_sd), k
    # some 150 effective draws of a share of a half: an error of 0.04
    assert found.far[[OUTLIER, OTHER]] == pytest.approx(FAR[name], abs=0.12)
