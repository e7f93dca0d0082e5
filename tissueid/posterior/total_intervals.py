"""The total interval: what it says of a machine that has no filter, or a rigid frame, at all.

The prior of an unknown filter is half of a normal distribution: a machine that does not filter lies on its
very edge, where the prior has no mass, and a posterior over filters leans away from it.  Central intervals
then hold the truth behind such a machine less often than they say, shortest ones as rarely, since a
parameter that is moved by the filter need not be lopsided itself.  None at all is no far-fetched filter,
though, and is a hypothesis of its own.  The total interval holds what it says under each that the data leave
standing: robust Bayes over two priors (Berger 1985, Statistical Decision Theory, section 4.7).

Draws without a filter are the draws moved to its absence along their linear regression on it (Beaumont,
Zhang & Balding 2002, Genetics 162: 2025): a slope does not depend on where its regressor is cut.

An end without a filter is one of draws that were moved, by a slope that is known from them only, and is held
against single machines, not against an average over them.  It is therefore the end of a tolerance interval
(Wilks 1941, Ann. Math. Stat. 12: 91): it is moved out by :data:`SURE` standard errors, so that the chance of
the draws leaves it short in one case of forty.  Draws come in clusters, those of one evaluated point, which
share everything but their gains; the error is that of the share of whole clusters beyond the end, and that
of the slope.

Ends of the draws themselves are right on average over machines, and are not moved.  Where the interval
reaches beyond one of them because of an absence, the other is drawn in until the level is held in all, as
far as the absence lets it.
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

#: Probability, at even odds before, from which the absence of a nuisance stands: a Bayes factor of 3 against
#: it is positive evidence (Kass & Raftery 1995, doi 10.1080/01621459.1995.10476572).
PLAUSIBLE = 0.25
#: Draws within this many of their standard deviations of the edge tell the density there.
NEAR = 0.5
#: Standard errors that an end without the nuisance is moved out by.
SURE = 2.0


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


def _norm_over(cluster: IntArray, values: FloatArray) -> float:
    """Root of the sum of squares of the clusters' sums."""
    sums = np.bincount(cluster, weights=values)
    return math.sqrt(float(sums @ sums))


def _without(
    values: FloatArray, excess: FloatArray, tail: float, cluster: IntArray | None
) -> tuple[float, float]:
    """Ends of a parameter without a nuisance, moved out by what clustered draws leave open.

    Parameters
    ----------
    values, excess : ndarray, shape (n,)
        Draws of the parameter, and of the nuisance from its edge on.
    tail : float
        Probability beyond either end.
    cluster : ndarray of int, shape (n,), or None
    """
    low, high = float(values.min()), float(values.max())
    away = excess - excess.mean()
    slope = float(away @ values) / float(away @ away)

    def moved(by: float) -> FloatArray:
        # a line may leave the passive set, which no draw does
        return np.clip(values - by * excess, low, high)

    draws = moved(slope)
    ends = np.quantile(draws, [tail, 1.0 - tail])
    if cluster is None:
        return float(ends[0]), float(ends[1])
    error = _norm_over(cluster, away * (draws - draws.mean())) / float(away @ away)
    less, more = moved(slope - error), moved(slope + error)
    tails = []
    for sign, end in zip((1.0, -1.0), ends, strict=True):
        beyond = _norm_over(cluster, (sign * draws < sign * end) - tail) / values.size
        tilted = 0.5 * float((sign * less < sign * end).mean() - (sign * more < sign * end).mean())
        tails.append(max(tail - SURE * math.hypot(beyond, tilted), 0.0))
    return float(np.quantile(draws, tails[0])), float(np.quantile(draws, 1.0 - tails[1]))


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
        Probability of the interval under each hypothesis.
    cluster : ndarray of int, optional
        What each draw was made from, shape (n,), not negative; draws of one number are not independent.
        Without it the draws are taken as if there were no end of them.
    """
    tail = 0.5 * (1.0 - level)
    absent = [nuisances[name] - priors[name].lower for name in plausible_edges(nuisances, priors)]
    out = {}
    for name, values in draws.items():
        found = np.array([_without(values, excess, tail, cluster) for excess in absent]).reshape(-1, 2)
        low, high = found[:, 0].min(initial=math.inf), found[:, 1].max(initial=-math.inf)
        # what is saved beyond one end may lie beyond the other
        below, above = min(float((values < low).mean()), tail), min(float((values > high).mean()), tail)
        first, last = np.quantile(values, [2.0 * tail - above, 1.0 - 2.0 * tail + below])
        out[name] = (float(min(low, first)), float(max(high, last)))
    return out
