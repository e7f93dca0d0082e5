"""Contact with a hard body: Hertz's law with the damping of Flores, compiled.

Pires et al., equation (1): ``F = k d^n (1 + chi d' / v0)``, ``chi = 8 (1 - e) / (5 e)`` (``flores``; Flores
et al. 2011, doi 10.1007/s11044-010-9237-4, equation (27)).  Multiplying the motion of a free mass by d' and
integrating over its contact gives, whatever k, n and the mass are, the e' that is reached (derived)::

    ln(1 - e' chi) + e' chi = ln(1 + chi) - chi                                     (``exact``: e' = e)

Bounds: e at least 0.05, v0 at least a given slowest speed (a touch at 1 mm/s and a push at 0.1 m/s after it
would be felt 160-fold), d' / v0 within +-1, and F >= 0: nothing sticks.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_part

Variant = Literal["flores", "exact"]

LEAST_RESTITUTION = 0.05
#: Restitution from which the exact factor is its tangent, and the largest share of 1/e that has a logarithm.
NEAR_1, SHORT_OF_1 = 0.9999, 1.0 - 1e-16
#: Halvings of a bracket: as many as a double has binary digits.
HALVINGS = 60

# -- the law's numbers, and what it remembers -----------------------------------------------------
IMPACT_SIZE = 6
STIFFNESS = 0
EXPONENT = 1
CHI = 2
SLOWEST = 3
FILTER_S = 4
HYSTERESIS_MM = 5

IMPACT_STATE = 4
LAST_DEPTH = 0
SPEED = 1
#: Speed at contact [mm/s]; 0 while no contact is on.
LATCHED = 2
STARTED = 3


def damping_factor(restitution: float, law: Variant = "flores") -> float:
    """The damping factor chi for a coefficient of restitution; ValueError where that is out of range."""
    if not LEAST_RESTITUTION <= restitution <= 1.0:
        msg = f"a coefficient of restitution lies within {LEAST_RESTITUTION} and 1, got {restitution}"
        raise ValueError(msg)
    return float(damping_factors(restitution, law))


def damping_factors(restitution: Any, law: Variant) -> FloatArray:
    """:func:`damping_factor` at any number of restitutions, continued beyond 1, (...) -> (...)."""
    e = np.asarray(restitution, dtype=np.float64)
    if law == "flores":
        return np.asarray(8.0 * (1.0 - e) / (5.0 * e))
    low, high = np.zeros(e.shape), 1.0 / e
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        more = np.log1p(-np.minimum(e * middle, SHORT_OF_1)) + e * middle > np.log1p(middle) - middle
        low, high = np.where(more, middle, low), np.where(more, high, middle)
    # both sides vanish at e = 1, where chi begins as 1.5 (1 - e)
    return np.where(e > NEAR_1, 1.5 * (1.0 - e * e) / (1.0 + e**3), low)


def pack_impact(
    stiffness: float,
    exponent: float,
    chi: float,
    block: FloatArray,
    at: int,
    *,
    slowest_mm_s: float,
    filter_s: float = 0.0,
    hysteresis_mm: float = 0.0,
) -> None:
    """Write the law's numbers from index ``at``: k [N/mm^n], n, chi, floor of v0, filter, hysteresis."""
    block[at : at + IMPACT_SIZE] = stiffness, exponent, chi, slowest_mm_s, filter_s, hysteresis_mm


@tick_part
def speed_ratio(
    parameters: FloatArray, at: int, memory: FloatArray, first: int, depth: float, dt: float
) -> float:
    """Speed over that at which this contact began, within +-1, after a step of linear motion; 0 outside.

    ``parameters``: from index ``at``: floor of v0 [mm/s], filter [s] and hysteresis [mm]; ``memory``:
    :data:`IMPACT_STATE` numbers from index ``first``, zero at first; updated in place.
    """
    if memory[first + STARTED] > 0.0 and dt > 0.0:
        rate = (depth - memory[first + LAST_DEPTH]) / dt
        filter_s = parameters[at + 1]
        share = 1.0 - math.exp(-dt / filter_s) if filter_s > 0.0 else 1.0
        memory[first + SPEED] += share * (rate - memory[first + SPEED])
    memory[first + STARTED] = 1.0
    memory[first + LAST_DEPTH] = depth
    if depth <= 0.0:
        if depth < -parameters[at + 2] or parameters[at + 2] == 0.0:
            memory[first + LATCHED] = 0.0
        return 0.0
    speed = memory[first + SPEED]
    if memory[first + LATCHED] == 0.0:
        memory[first + LATCHED] = max(speed, parameters[at])
    return float(min(max(speed / memory[first + LATCHED], -1.0), 1.0))


@tick_part
def impact_step(
    parameters: FloatArray, at: int, memory: FloatArray, first: int, depth: float, dt: float
) -> float:
    """Force [N], never negative, after ``dt`` seconds of linear motion to a penetration [mm]."""
    ratio = speed_ratio(parameters, at + SLOWEST, memory, first, depth, dt)
    if depth <= 0.0:
        return 0.0
    elastic = parameters[at + STIFFNESS] * depth ** parameters[at + EXPONENT]
    return float(max(elastic * (1.0 + parameters[at + CHI] * ratio), 0.0))
