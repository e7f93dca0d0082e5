"""Whether intervals of a population hold what they claim; minutes."""

from __future__ import annotations

import numpy as np
import pytest
from cohort_factory import lkj_factor, normal_stage, plain_design

from tissueid.population.sampler import SamplerOptions, sample_population
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
    found = sample_population(stage, plain_design(SPECIMENS), STATED, SamplerOptions(seed=seed))
    draws = np.concatenate([found.mean, found.sd.reshape(-1, SIZE)], axis=1)
    first, last = np.quantile(draws, [0.025, 0.975], axis=0)
    truth = np.concatenate([mean, sd])
    return (first <= truth) & (truth <= last)


@pytest.mark.slow
def test_intervals_of_means_and_spreads_cover_in_200_cohorts():
    held = np.array([holds_the_truth(seed) for seed in range(COHORTS)]).sum(axis=0)
    # 99 % for fourteen numbers together
    low, high = binomial_interval(COHORTS, 0.95, 0.01 / (2 * SIZE))
    assert ((low <= held) & (held <= high)).all(), held
