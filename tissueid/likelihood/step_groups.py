"""Distinct sampling steps of a log, few enough that each has sums of its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel

__all__ = ["MAX_LAG_GROUPS", "lag_groups"]

FloatArray = NDArray[np.float64]

#: Distinct steps that are kept apart; a recording has one to three.
MAX_LAG_GROUPS = 8
#: Steps are first counted in bins of this width in ln(step).
BIN = 0.01
#: Steps nearer than this in ln(step) are one rate printed with rounding, or a clock that trembles: taken for
#: their mean, they cost an estimate of phi a quarter of a percent of its information.
SAME_RATE = 0.05


def lag_groups(step_s: FloatArray, linked: NDArray[np.bool_]) -> tuple[NDArray[np.int64], FloatArray]:
    """Group of every link by the length of its step.

    Rates that differ by more than :data:`SAME_RATE` are kept exactly, up to :data:`MAX_LAG_GROUPS` of them.
    An irregular clock is reduced to that number of representatives, which merges the nearest steps first,
    weighted by their links (Ward's rule in ln step).  A step taken for one that differs by d in ln(step)
    counts with the correlation rho^(exp d) for rho: still a proper likelihood, of a clock that differs by d.
    For steps spread evenly over a factor of five d is below 0.1.

    Parameters
    ----------
    step_s : ndarray, shape (n,)
        Time since the sample before; positive where ``linked`` [s].
    linked : ndarray of bool, shape (n,)
        Samples that continue a chain of noise.

    Returns
    -------
    group : ndarray of int, shape (n,)
        -1 where there is no link.
    mean_s : ndarray, shape (groups,)
        Mean step of each group, ascending [s].
    """
    group = np.full(step_s.size, -1, dtype=np.int64)
    steps = step_s[linked]
    if steps.size == 0:
        return group, np.zeros(0)
    shortest = float(steps.min())
    if float(steps.max()) <= shortest * (1.0 + BIN):
        group[linked] = 0
        return group, np.array([steps.mean()])
    place = np.log(steps / shortest) / BIN
    bins = np.floor(place + 0.5).astype(np.int64)
    bin_of = (np.cumsum(np.bincount(bins) > 0) - 1)[bins]
    links = np.bincount(bin_of).astype(np.float64)
    mean = np.bincount(bin_of, weights=steps) / links
    member, mean = merged_bins(links, mean, SAME_RATE, MAX_LAG_GROUPS)
    group[linked] = member[bin_of]
    return group, mean


@kernel()
def merged_bins(
    links: FloatArray, mean: FloatArray, same: float, most: int
) -> tuple[NDArray[np.int64], FloatArray]:
    """Merge neighbouring bins until they are few and apart; the group of each bin, and the groups' means."""
    member = np.arange(links.size)
    while mean.size > 1:
        apart = np.diff(np.log(mean))
        if apart.min() < same:
            k = int(np.argmin(apart))
        elif mean.size > most:
            k = int(np.argmin(apart**2 * links[1:] * links[:-1] / (links[1:] + links[:-1])))
        else:
            break
        both = links[k] + links[k + 1]
        mean[k] = (links[k] * mean[k] + links[k + 1] * mean[k + 1]) / both
        links[k] = both
        links, mean = np.delete(links, k + 1), np.delete(mean, k + 1)
        member[member > k] -= 1
    return member, mean
