"""Bands of the ECDF against simulated uniform ranks, ranks against their definition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from tissueid.selfcheck.records import DRAWS, rank_of
from tissueid.selfcheck.verdicts import POINTS, binomial_interval, ecdf_band, ecdf_counts


@pytest.mark.parametrize(("simulations", "level"), [(60, 0.95), (200, 0.95), (200, 0.99)])
def test_band_keeps_uniform_ranks_with_its_level(simulations, level):
    band = ecdf_band(simulations, level)
    rng = np.random.default_rng(71)
    repeats = 8000
    kept = np.mean([band.holds(ecdf_counts(rng.integers(0, DRAWS + 1, simulations))) for _ in range(repeats)])
    error = np.sqrt(level * (1.0 - level) / repeats)
    # counts are whole: the band holds its level and at most a little more
    assert level - 4.0 * error < kept < level + 0.003 + 4.0 * error


def test_counts_are_ranks_below_each_share():
    ranks = np.array([0, 3, 4, 199, 200, DRAWS])
    counts = ecdf_counts(ranks)
    assert counts.size == POINTS - 1
    # 1 % of 400 ranks are 0 to 3; one half are 0 to 199
    assert (counts[0], counts[1], counts[49], counts[-1]) == (2, 3, 4, 5)


def test_rank_counts_draws_below_and_breaks_ties_evenly():
    rng = np.random.default_rng(3)
    draws = np.array([1.0, 2.0, 2.0, 3.0])
    assert rank_of(2.5, draws, rng) == 3
    assert rank_of(0.0, draws, rng) == 0
    tied = [rank_of(2.0, draws, rng) for _ in range(3000)]
    # uniform on 1, 2, 3: four standard errors of a third
    assert {*tied} == {1, 2, 3}
    assert np.bincount(tied)[1:] / 3000 == pytest.approx(1 / 3, abs=4 * np.sqrt(2 / 9 / 3000))


def test_binomial_interval_leaves_no_more_than_its_error():
    low, high = binomial_interval(1000, 0.95, 0.001)
    assert binom.cdf(low - 1, 1000, 0.95) + binom.sf(high, 1000, 0.95) <= 0.001
    assert binom.cdf(low, 1000, 0.95) > 0.0005
