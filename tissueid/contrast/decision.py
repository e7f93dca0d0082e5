"""Verdicts on two tissues: do they differ, what does it cost to be wrong, could a hand tell.

Differences of ln force have the covariance of both posteriors; Mahalanobis' distance of their mean is
chi-squared where the tissues are one.  Forces at neighbouring depths are nearly one number, so directions in
which the posteriors say next to nothing of their own are left out.

Could a hand tell two tissues apart?  Published just-noticeable differences, and the scale of a device.
The conditions of those experiments are not those of a hand on a stylus: limbs, amplitudes and devices differ,
and the numbers vary between studies.  They say an order of magnitude.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from tissueid.arrays import FloatArray

#: Tissues are called different below this probability.
LEVEL = 0.02
#: Directions whose variance is below this share of the largest one are rounding and not data.
NEGLIGIBLE = 1e-6
CENTRAL = (0.025, 0.5, 0.975)


@dataclass(frozen=True, slots=True)
class Difference:
    """Verdict over all forces."""

    distance: float  # squared Mahalanobis distance
    directions: int  # degrees of freedom
    probability: float  # of a distance as large where the tissues are one
    different: bool  # whether it is below :data:`LEVEL`


@dataclass(frozen=True, slots=True)
class Row:
    """One number of both."""

    name: str  # with unit
    #: 2.5, 50 and 97.5 % quantiles.
    one: tuple[float, float, float]
    other: tuple[float, float, float]
    #: The same of other over one; ``None`` where a draw is not positive.
    ratio: tuple[float, float, float] | None
    larger: float  # probability that the other one's is larger


def rows(one: Mapping[str, FloatArray], other: Mapping[str, FloatArray]) -> list[Row]:
    """Numbers that both have, beside each other.

    ``one``, ``other``: draws by name; the posteriors are independent, so draws are paired as they come.
    """
    found = []
    for name in one:
        if name not in other:
            continue
        count = min(one[name].size, other[name].size)
        a, b = one[name][:count], other[name][:count]
        # every pair of independent draws is as good as any other: a shift makes new ones
        shifts = [np.roll(b, count * k // 7) for k in range(7)]
        ratio = None
        if a.min() > 0.0 and b.min() > 0.0:
            ratio = _central(np.concatenate([shift / a for shift in shifts]))
        # a tie is half of either
        larger = float(np.mean([np.mean(shift > a) + 0.5 * np.mean(shift == a) for shift in shifts]))
        found.append(Row(name, _central(one[name]), _central(other[name]), ratio, larger))
    return found


def difference(one: Mapping[str, FloatArray], other: Mapping[str, FloatArray]) -> Difference:
    """Test all forces together.

    ``one``, ``other``: draws by name; names that begin with "force" are used.
    """
    names = [name for name in one if name.startswith("force") and name in other]
    a, b = (np.log(np.maximum([of[name] for name in names], 1e-12)) for of in (one, other))
    gap = b.mean(axis=1) - a.mean(axis=1)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(a) + np.cov(b)))
    used = values > NEGLIGIBLE * values.max()
    distance = float(np.sum((vectors.T @ gap)[used] ** 2 / values[used]))
    directions = int(used.sum())
    probability = float(chi2.sf(distance, directions))
    return Difference(distance, directions, probability, probability < LEVEL)


def _central(values: FloatArray) -> tuple[float, float, float]:
    low, middle, high = (float(q) for q in np.quantile(values, CENTRAL))
    return low, middle, high


#: Below this force at a device the difference that is noticed no longer shrinks [N].
LEAST_FORCE_N = 0.5


@dataclass(frozen=True, slots=True)
class Limit:
    """A just-noticeable difference."""

    of: str  # beginning of the numbers it belongs to
    share: float  # weber fraction
    source: str
    doi: str
    conditions: str


LIMITS = (
    Limit("force", 0.07, "Jones 1989, Perception 18:681", "10.1068/p180681", "elbow flexors, forces matched"),
    Limit(
        "static stiffness",
        0.23,
        "Jones & Hunter 1990, Exp Brain Res 79:150",
        "10.1007/BF00228884",
        "two arms, motors, stiffness matched",
    ),
    Limit(
        "viscosity",
        0.34,
        "Jones & Hunter 1993, Exp Brain Res 94:343",
        "10.1007/BF00230304",
        "two arms, motors, viscosity matched",
    ),
)


@dataclass(frozen=True, slots=True)
class Noticed:
    """Difference beside the least that could be felt."""

    name: str  # of the number
    limit: Limit
    times: float  # median difference over the just-noticeable one
    probability: float  # that it exceeds it


def noticed(
    one: Mapping[str, FloatArray], other: Mapping[str, FloatArray], *, force_scale: float
) -> list[Noticed]:
    """Compare differences with what is noticed, at the scale of a device.

    ``one``, ``other``: draws by name; ``force_scale``: force at the device over that of the tissue.  A common
    scale keeps ratios of stiffness and viscosity; forces that become faint are harder to tell apart.
    """
    found = []
    for name in one:
        limit = next((limit for limit in LIMITS if name.startswith(limit.of)), None)
        if limit is None or name not in other:
            continue
        count = min(one[name].size, other[name].size)
        a, b = one[name][:count], other[name][:count]
        middle = 0.5 * np.abs(a + b)
        if limit.of == "force":
            middle = np.maximum(middle, LEAST_FORCE_N / force_scale)
        times = np.abs(b - a) / (limit.share * middle)
        found.append(Noticed(name, limit, float(np.median(times)), float(np.mean(times > 1.0))))
    return found
