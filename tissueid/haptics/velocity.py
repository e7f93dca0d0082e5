"""Velocity of the grip from positions that encoders rounded."""

from __future__ import annotations

import math

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_part

#: Time constant [s]: one 45 um count in a 1 ms tick, 45 mm/s unfiltered, is then 8 mm/s.
VELOCITY_FILTER_S = 0.005
#: Slower is rest [m/s]: a velocity that only fades would reach denormal numbers, which slow a tick.
REST_M_PER_S = 1e-12


@tick_part
def velocity_step(velocity: FloatArray, position: FloatArray, last: FloatArray, dt: float) -> None:
    """Low-passed difference quotient, exact for any step.

    ``velocity`` (3,): [m/s], updated in place; ``position``, ``last`` (3,): position now and at the last tick
    [m]; ``last`` is set to ``position``; ``dt``: measured step [s]; without a positive one nothing changes
    but ``last``.
    """
    share = -math.expm1(-dt / VELOCITY_FILTER_S) if dt > 0.0 else 0.0
    for i in range(3):
        if share > 0.0:
            velocity[i] += share * ((position[i] - last[i]) / dt - velocity[i])
            if abs(velocity[i]) < REST_M_PER_S:
                velocity[i] = 0.0
        last[i] = position[i]
