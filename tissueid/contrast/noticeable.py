"""Could a hand tell two tissues apart?  Published just-noticeable differences, and the scale of a device.

The conditions of those experiments are not those of a hand on a stylus: limbs, amplitudes and devices differ,
and the numbers vary between studies.  They say an order of magnitude.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray

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
