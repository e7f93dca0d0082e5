"""Contact with a hard body: Hertz's law with the damping of :mod:`tissueid.model.restitution`, compiled.

Bounds: e at least 0.05, v0 at least a given slowest speed (a touch at 1 mm/s and a push at 0.1 m/s after it
would be felt 160-fold), d' / v0 within +-1, and F >= 0: nothing sticks.
"""

from __future__ import annotations

import math

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_part

# -- the law's numbers, and what it remembers -----------------------------------------------------
IMPACT_SIZE, IMPACT_STATE = 6, 4
STIFFNESS, EXPONENT, CHI, SLOWEST, FILTER_S, HYSTERESIS_MM = range(IMPACT_SIZE)
#: Latched is the speed at contact [mm/s]; 0 while no contact is on.
LAST_DEPTH, SPEED, LATCHED, STARTED = range(IMPACT_STATE)


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
