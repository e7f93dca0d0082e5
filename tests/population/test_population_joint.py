"""The two stages against one sampler of everything at once, which knows of no stages."""

from __future__ import annotations

import math

import emcee
import numpy as np
import pytest
from cohort_factory import monte_carlo_errors, normal_stage
from scipy.special import gammaln

from tissueid.population.sampler import SamplerOptions, sample_population
from tissueid.population.stage_one import Design
from tissueid.priors import PopulationPriors

SPECIMENS, SIZE = 5, 2
NAMES = ("mean_0", "mean_1", "ln_sd_0", "ln_sd_1", "arctanh_r", "ln_nu")


def joint_density(points: np.ndarray, measured: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Ln density of mean, spread, correlation, tails and the places of all specimens; shape (n,)."""
    priors = PopulationPriors()
    mean, log_sd, z, log_nu = points[:, :2], points[:, 2:4], points[:, 4], points[:, 5]
    places = points[:, 6:].reshape(-1, SPECIMENS, SIZE)
    r, nu = np.tanh(z), np.exp(log_nu)
    away = (places - mean[:, None, :]) * np.exp(-log_sd)[:, None, :]
    square = (away[..., 0] ** 2 - 2.0 * r[:, None] * away[..., 0] * away[..., 1] + away[..., 1] ** 2) / (
        1.0 - r**2
    )[:, None]
    t = (
        gammaln(0.5 * (nu + 2))
        - gammaln(0.5 * nu)
        - np.log(nu)
        - log_sd.sum(axis=1)
        - 0.5 * np.log1p(-(r**2))
    )
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
def test_two_stages_agree_with_joint_sampling(own: tuple[float, float], smooth: int) -> None:
    rng = np.random.default_rng(21)
    sd = np.array(own)
    measured = np.array([1.0, -2.0]) + np.array([0.15, 0.2]) * rng.standard_normal((SPECIMENS, SIZE))
    measured = measured + sd * rng.standard_normal(measured.shape)
    # the draws of stage 1 with exactly these means and spreads: its Monte-Carlo error is no part of this
    stage = normal_stage(measured, np.zeros(SIZE) + 1e-12, rng, draws=4)
    unit = rng.standard_normal((20_000, SIZE))
    unit = (unit - unit.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(unit.T))).T
    stage = type(stage)(
        tuple(one + sd * unit for one in measured),
        tuple(np.zeros(len(unit)) for _ in measured),
        stage.linear,
        stage.ascending,
    )

    two = sample_population(
        stage, Design.plain(SPECIMENS), None, SamplerOptions(sweeps=20_000, blocks=1, settle=2000)
    )
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
    staged = np.concatenate(
        [
            two.coefficient[:, :, 0],
            np.log(two.sd),
            np.arctanh(two.correlation[:, :, 1, :1]),
            np.log(two.nu)[..., None],
        ],
        axis=2,
    )
    for k in range(len(NAMES)):
        errors = [monte_carlo_errors(one[:, :, k]) for one in (joint, staged)]
        mean, spread_of = errors[0].mean ** 2 + errors[1].mean ** 2, errors[0].sd ** 2 + errors[1].sd ** 2
        # four Monte-Carlo errors of the difference
        assert joint[:, :, k].mean() == pytest.approx(staged[:, :, k].mean(), abs=4.0 * math.sqrt(mean))
        assert joint[:, :, k].std() == pytest.approx(staged[:, :, k].std(), abs=4.0 * math.sqrt(spread_of))
