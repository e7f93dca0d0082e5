"""Uniform ranks, or not: ECDFs with bands that hold at every point at once.

The rank of a truth among draws of its posterior is uniform where the posterior is right (simulation-based
calibration, Talts et al. 2018, arXiv 1804.06788).  With L draws a rank is one of L + 1 values, all equally
likely; N of them give an empirical distribution whose count below z_i = i / K is binomial, exactly, where
L + 1 is a multiple of K.  Counts at growing z are a Markov chain: of the N - k ranks not yet counted,
each falls into the next interval with probability (z' - z) / (1 - z).  So the probability that *all* counts
stay within their pointwise intervals is a product of small matrices, and the pointwise level that gives the
band its simultaneous coverage is found by bisection: no simulation, no chi-square, no bins (the idea of
Saeilynoja, Buerkner & Vehtari 2022, doi 10.1007/s11222-022-10090-6, sections 2 and 3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import gammaln
from scipy.stats import binom

from tissueid.arrays import FloatArray, IntArray

#: Draws a truth is ranked among: 400 equally likely ranks hold 80, 90 and 95 % without rounding.
DRAWS = 399
#: Points at which the distribution of ranks is looked at; DRAWS + 1 is a multiple.
POINTS = 100
_BISECTIONS = 40


@dataclass(frozen=True, slots=True, eq=False)
class EcdfBand:
    """Counts that an ECDF of uniform ranks keeps, at all points at once."""

    points: FloatArray  # (k,), z in (0, 1)
    #: (k,): fewest and most ranks below each z.
    low: IntArray
    high: IntArray  # (k,)
    level: float  # simultaneous probability that was asked for; the band's own is at least that

    def holds(self, counts: IntArray) -> bool:
        """True where all counts lie within."""
        return bool(((self.low <= counts) & (counts <= self.high)).all())


def rank_of(truth: float, draws: FloatArray, rng: np.random.Generator) -> int:
    """Rank of a truth among draws: how many lie below it, ties broken at random.

    ``draws`` (L,); ``rng``: only asked where draws equal the truth.  Returns 0 to L.
    """
    below = int((draws < truth).sum())
    equal = int((draws == truth).sum())
    return below + (int(rng.integers(equal + 1)) if equal else 0)


def ecdf_counts(ranks: IntArray, *, draws: int = DRAWS, points: int = POINTS) -> IntArray:
    """Count the ranks below each of ``points - 1`` equally spaced shares of their range.

    ``ranks`` (n,): 0 to ``draws``.  Returns (points - 1,).
    """
    edges = np.arange(1, points) * ((draws + 1) // points)
    return np.searchsorted(np.sort(ranks), edges, side="left").astype(np.int64)


def _stays(low: IntArray, high: IntArray, points: FloatArray, simulations: int) -> float:
    """Probability that all counts of uniform ranks stay within their intervals."""
    log_factorial = gammaln(np.arange(1.0, simulations + 2.0))
    at = np.array([0])
    mass = np.ones(1)
    before = 0.0
    for z, least, most in zip(points, low, high, strict=True):
        share = (z - before) / (1.0 - before)
        to = np.arange(least, most + 1)
        more = to[:, None] - at[None, :]
        left = simulations - at[None, :]
        possible = (more >= 0) & (more <= left)
        k = np.where(possible, more, 0)
        log_p = (
            log_factorial[left]
            - log_factorial[k]
            - log_factorial[left - k]
            + k * np.log(share)
            + (left - k) * np.log1p(-share)
        )
        mass = np.where(possible, np.exp(log_p), 0.0) @ mass
        at, before = to, float(z)
    return float(mass.sum())


@lru_cache(maxsize=64)
def ecdf_band(simulations: int, level: float, points: int = POINTS) -> EcdfBand:
    """The narrowest band of equal pointwise level that holds with at least ``level``.

    ``simulations``: ranks, >= 1; ``level``: simultaneous probability, in (0, 1); ``points``: z = 1/points ...
    (points - 1)/points.
    """
    z = np.arange(1, points) / points

    def interval(error: float) -> tuple[IntArray, IntArray]:
        low, high = (binom.ppf(level, simulations, z) for level in (error / 2.0, 1.0 - error / 2.0))
        return np.asarray(low, dtype=np.int64), np.asarray(high, dtype=np.int64)

    # by Boole a pointwise error of (1 - level) / points is enough, and one of 1 - level at least is needed
    narrow, wide = np.log(1.0 - level), np.log((1.0 - level) / points)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (narrow + wide)
        if _stays(*interval(float(np.exp(middle))), z, simulations) >= level:
            wide = middle
        else:
            narrow = middle
        if narrow - wide < 1e-3:
            break
    low, high = interval(float(np.exp(wide)))
    return EcdfBand(points=z, low=low, high=high, level=level)


def binomial_interval(trials: int, chance: float, error: float) -> tuple[int, int]:
    """Counts that a binomial variable leaves with a probability of at most ``error``, half on each side.

    ``error``: in (0, 1).
    """
    return int(binom.ppf(error / 2.0, trials, chance)), int(binom.ppf(1.0 - error / 2.0, trials, chance))
