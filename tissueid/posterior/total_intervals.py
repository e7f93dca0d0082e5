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

The ends of a quoted interval are moved out by their Monte-Carlo standard error, some 2 % of the width each
for a thousand draws: of ends that are wrong by chance it is better to be wrong outward.  Half an error left
some intervals behind an unknown frame that held the truth too rarely, and so did none (docs/uncertainty.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tissueid.priors import CalibrationPrior

__all__ = ["plausible_edges", "total_intervals"]

FloatArray = NDArray[np.float64]

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


def total_intervals(
    draws: Mapping[str, FloatArray],
    nuisances: Mapping[str, FloatArray],
    priors: Mapping[str, CalibrationPrior],
    *,
    level: float = 0.95,
    worth: float = math.inf,
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
    worth : float
        Independent draws that the draws stand for.
    """
    tail = 0.5 * (1.0 - level)
    tail = max(tail - math.sqrt(tail * (1.0 - tail) / worth), 0.0)
    ends = tail, 1.0 - tail
    absent = [nuisances[name] - priors[name].lower for name in plausible_edges(nuisances, priors)]
    out = {}
    for name, values in draws.items():
        found = [np.quantile(values, ends)]
        for excess in absent:
            away = excess - excess.mean()
            slope = float(away @ values) / float(away @ away)
            # a line may leave the passive set, which no draw does
            moved = np.clip(values - slope * excess, values.min(), values.max())
            found.append(np.quantile(moved, ends))
        low, high = np.array(found).T
        out[name] = (float(low.min()), float(high.max()))
    return out
