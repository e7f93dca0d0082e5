"""The total interval: what it says of a machine that has no filter, or a rigid frame, at all.

The prior of an unknown filter is half of a normal distribution: a machine that does not filter lies on its
very edge, where the prior has no mass, and a posterior over filters leans away from it.  Central intervals
then hold the truth behind such a machine less often than they say, shortest ones as rarely, since a
parameter that is moved by the filter need not be lopsided itself.  None at all is no far-fetched filter,
though, and is a hypothesis of its own.  The total interval is therefore the hull of the intervals under
each that the data leave standing: robust Bayes over two priors (Berger 1985, Statistical Decision Theory,
section 4.7).

Draws without a filter are the draws moved to its absence along their linear regression on it (Beaumont,
Zhang & Balding 2002, Genetics 162: 2025): a slope does not depend on where its regressor is cut.

The ends of a quoted interval are moved out by their Monte-Carlo standard error: of ends that are wrong by
chance it is better to be wrong outward.  Draws come in clusters, those of one evaluated point, which share
everything but their gains; the error is that of the share of whole clusters beyond the end.  An end that the
gains decide is known well from a thousand points, one that a relaxation time decides to some 2 % of the
width.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tissueid.priors import CalibrationPrior

__all__ = ["plausible_edges", "total_intervals"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Probability, at even odds before, from which the absence of a nuisance stands.
PLAUSIBLE = 0.05
#: Draws within this many of their standard deviations of the edge tell the density there.
NEAR = 0.5


def plausible_edges(
    nuisances: Mapping[str, FloatArray], priors: Mapping[str, CalibrationPrior]
) -> tuple[str, ...]:
    """Nuisances, cut at the centre of their prior, that may be absent as far as the data say.

    The odds of absence are the posterior density at the edge over the prior's (Dickey 1971, doi
    10.1214/aoms/1177693507).

    Parameters
    ----------
    nuisances : mapping
        Name -> draws of equal weight.
    priors : mapping
        Name -> prior.
    """
    out = []
    for name, draws in nuisances.items():
        prior = priors[name]
        if prior.sd <= 0.0 or prior.lower != prior.mean:
            continue
        near = NEAR * float(draws.std())
        before = math.erf(near / prior.sd / math.sqrt(2.0))
        odds = float((draws < prior.lower + near).mean()) / max(before, 1e-300)
        if odds / (1.0 + odds) >= PLAUSIBLE:
            out.append(name)
    return tuple(out)


def _end(values: FloatArray, level: float, cluster: IntArray | None) -> float:
    """A quantile, moved outward by the standard error that clustered draws know it to."""
    found = float(np.quantile(values, level))
    if cluster is None:
        return found
    beyond = values < found if level < 0.5 else values > found
    tail = min(level, 1.0 - level)
    away = np.bincount(cluster, weights=beyond - tail)
    moved = max(tail - math.sqrt(float(away @ away)) / values.size, 0.0)
    return float(np.quantile(values, moved if level < 0.5 else 1.0 - moved))


def total_intervals(
    draws: Mapping[str, FloatArray],
    nuisances: Mapping[str, FloatArray],
    priors: Mapping[str, CalibrationPrior],
    *,
    level: float = 0.95,
    cluster: IntArray | None = None,
) -> dict[str, tuple[float, float]]:
    """The total interval of every parameter.

    Parameters
    ----------
    draws : mapping
        Name of a parameter -> its total draws, shape (n,), of equal weight.
    nuisances : mapping
        Calibration nuisance -> the same draws of it, shape (n,).
    priors : mapping
        Calibration nuisance -> its prior.
    level : float
        Of the central interval under each hypothesis.
    cluster : ndarray of int, optional
        What each draw was made from, shape (n,), not negative; draws of one number are not independent.
        Without it the draws are taken as if there were no end of them.
    """
    ends = 0.5 * (1.0 - level), 0.5 * (1.0 + level)
    absent = [nuisances[name] - priors[name].lower for name in plausible_edges(nuisances, priors)]
    out = {}
    for name, values in draws.items():
        found = [[_end(values, end, cluster) for end in ends]]
        for excess in absent:
            away = excess - excess.mean()
            slope = float(away @ values) / float(away @ away)
            # a line may leave the passive set, which no draw does
            moved = np.clip(values - slope * excess, values.min(), values.max())
            found.append([_end(moved, end, cluster) for end in ends])
        low, high = np.array(found).T
        out[name] = (float(low.min()), float(high.max()))
    return out
