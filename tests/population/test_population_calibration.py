"""Whether intervals of a population hold what they claim, and whether pooling helps; minutes each."""

from __future__ import annotations

import numpy as np
import pytest
from cohort_factory import COORDINATES, TYPICAL, lkj_factor, normal_stage

from tissueid.population.coordinates import Coordinates
from tissueid.population.sampler import SamplerOptions, sample_population
from tissueid.population.stage_one import Design, StageOne
from tissueid.priors import PopulationPriors, SpreadPrior
from tissueid.selfcheck.verdicts import binomial_interval

COHORTS, SPECIMENS, SIZE = 200, 17, 7
#: Spread between specimens of some 15 %, as stated for these cohorts.
STATED = PopulationPriors(between=SpreadPrior(0.15, 0.3))
#: What the recordings leave open: forces to 2 %, viscosities to 10 %, a relaxation time to 50 %.
OWN = np.array([0.02, 0.02, 0.02, 0.1, 0.1, 0.1, 0.5])


def holds_the_truth(seed: int) -> np.ndarray:
    """Whether 95 % intervals of seven means and seven spreads hold a truth drawn from the priors."""
    rng = np.random.default_rng([77, seed])
    mean = rng.normal(0.0, STATED.mean_sd, SIZE)
    sd = np.exp(rng.normal(np.log(STATED.between.median), STATED.between.sd_ln, SIZE))
    low = lkj_factor(rng, SIZE, STATED.correlation_shape)
    nu = 0.0
    while nu < 1.0:
        nu = rng.gamma(STATED.tail_shape, 1.0 / STATED.tail_rate)
    weight = rng.gamma(0.5 * nu, 2.0 / nu, SPECIMENS)
    places = (
        mean + (rng.standard_normal((SPECIMENS, SIZE)) / np.sqrt(weight)[:, None]) @ (sd[:, None] * low).T
    )
    own = OWN * np.exp(rng.normal(0.0, 0.3, (SPECIMENS, SIZE)))
    stage = normal_stage(places, own, rng)
    found = sample_population(stage, Design.plain(SPECIMENS), STATED, SamplerOptions(seed=seed))
    draws = np.concatenate([found.mean, found.sd.reshape(-1, SIZE)], axis=1)
    first, last = np.quantile(draws, [0.025, 0.975], axis=0)
    truth = np.concatenate([mean, sd])
    return (first <= truth) & (truth <= last)


@pytest.mark.slow
def test_intervals_of_means_and_spreads_cover_in_200_cohorts() -> None:
    held = np.array([holds_the_truth(seed) for seed in range(COHORTS)]).sum(axis=0)

    # 99 % for fourteen numbers together
    low, high = binomial_interval(COHORTS, 0.95, 0.01 / (2 * SIZE))
    assert ((low <= held) & (held <= high)).all(), held


def poorly_timed(rng: np.random.Generator, count: int) -> tuple[np.ndarray, StageOne]:
    """Specimens of two logs at 10 Hz: force and viscosity are known, tau is open over a factor of eight."""
    centre = COORDINATES.to_phi(TYPICAL)[0][0]
    places = centre + 0.15 * rng.standard_normal((count, 5))
    return places, normal_stage(places, np.array([0.03, 0.03, 0.03, 0.06, 1.0]), rng)


def relaxation_error(coordinates: Coordinates, guess: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square of the branch's force just after ramps that end within a few tau, over its peak."""
    tau, true = np.exp(guess[4]), np.exp(truth[4])
    eta, true_eta = np.exp(guess[3]), np.exp(truth[3])
    time = np.linspace(0.0, 0.2, 100)
    return float(
        np.sqrt(np.mean((eta * np.exp(-time / tau) - true_eta * np.exp(-time / true)) ** 2)) / true_eta
    )


@pytest.mark.slow
def test_pooling_beats_separate_fits_where_a_specimen_says_little() -> None:
    better = 0
    cohorts = 30
    for seed in range(cohorts):
        rng = np.random.default_rng([91, seed])
        places, stage = poorly_timed(rng, 12)
        found = sample_population(stage, Design.plain(12), None, SamplerOptions(seed=seed, blocks=2))
        pooled = np.median(found.specimens, axis=0)
        separate = np.array([np.median(one, axis=0) for one in stage.phi])
        errors = [
            np.mean([relaxation_error(COORDINATES, g, t) for g, t in zip(guess, places, strict=True)])
            for guess in (pooled, separate)
        ]
        better += int(errors[0] < errors[1])

    # nine tenths of cohorts
    assert better >= 0.9 * cohorts
