"""Kinematics of the emulated legs by search: where a thigh must stand so that its shin has the right length.

A leg's plane is turned by its azimuth about z.  The thigh (length a) turns in that plane about a pivot at
radius r; the shin is a parallelogram (length b) with pins d and e before and behind it, which leans out of
the plane by q.  A pose is possible where ``hypot(rho - d - e, q) = b``, with rho the distance in the plane
from knee to wrist; rho falls monotonically while the thigh turns toward the wrist, so that bisection finds
the one angle on the side of the knee that is built (geometry and lengths of R. E. Stamper, 1997).

Forces follow from differences: ``F = (d theta / d p)^T tau``.  SI units, radians.
"""

from __future__ import annotations

import math

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import kernel

#: Thigh, shin, the two pins together, wrist from the platform's centre along and across the leg, pivot along
#: and across the leg [m].
LENGTHS = np.array([0.060, 0.1025, 0.01125 + 0.01125, 0.01443, -0.025, 0.040, -0.02309])
AZIMUTHS = np.radians(np.array([105.0, -15.0, -135.0]))
ZERO_RAD = math.radians(35.0)
#: 320 lines, four edges each, behind a drum of 110 on a capstan of 14.25.
COUNTS_PER_RAD = 320.0 * 4.0 / (2.0 * math.pi) * 110.0 / 14.25
#: Halvings of a bracket of pi: to 2e-14 rad.
HALVINGS = 47
#: Step of the differences [m]: truncation and rounding are both below 1e-7 of the result.
DIFFERENCE_M = 1e-5


@kernel()
def _shin_excess(lengths: FloatArray, angle: float, along: float, out: float, lean: float) -> float:
    """Length the shin would need at a thigh angle, less the one it has."""
    knee_along = lengths[0] * math.cos(angle)
    knee_out = lengths[0] * math.sin(angle)
    rho = math.hypot(along - knee_along, out - knee_out)
    # nearer than the pins are long, the parallelogram would have to fold over itself
    return float(math.copysign(math.hypot(rho - lengths[2], lean), rho - lengths[2]) - lengths[1])


@kernel()
def leg_angles(position: FloatArray, lengths: FloatArray, azimuths: FloatArray, angles: FloatArray) -> bool:
    """Angles of the three thighs at a position of the grip.

    ``position`` (3,): [m]; ``lengths``, ``azimuths``: as :data:`LENGTHS`, and the legs' azimuths [rad];
    ``angles`` (3,): **Written** [rad].  Returns false where a leg does not reach; its angle is then left as
    it was.
    """
    reached = True
    for leg in range(3):
        c, s = math.cos(azimuths[leg]), math.sin(azimuths[leg])
        along = c * position[0] + s * position[1] - lengths[5] + lengths[3]
        lean = c * position[1] - s * position[0] - lengths[6] + lengths[4]
        high = math.atan2(position[2], along)
        low = high - math.pi
        far = _shin_excess(lengths, low, along, position[2], lean)
        near = _shin_excess(lengths, high, along, position[2], lean)
        if not (abs(lean) <= lengths[1] and far >= 0.0 >= near):
            reached = False
            continue
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if _shin_excess(lengths, middle, along, position[2], lean) > 0.0:
                low = middle
            else:
                high = middle
        angles[leg] = 0.5 * (low + high)
    return reached


@kernel()
def grip_force(
    position: FloatArray, torque: FloatArray, lengths: FloatArray, azimuths: FloatArray, force: FloatArray
) -> bool:
    """Force at the grip [N] of three arm torques [N m], by central differences of the angles.

    ``force`` is **written**; all zero, and False returned, where the pose is out of reach.
    """
    place = position.copy()
    ahead = np.zeros(3)
    behind = np.zeros(3)
    force[:] = 0.0
    for axis in range(3):
        place[axis] = position[axis] + DIFFERENCE_M
        reached = leg_angles(place, lengths, azimuths, ahead)
        place[axis] = position[axis] - DIFFERENCE_M
        reached = leg_angles(place, lengths, azimuths, behind) and reached
        place[axis] = position[axis]
        if not reached:
            force[:] = 0.0
            return False
        for leg in range(3):
            force[axis] += torque[leg] * (ahead[leg] - behind[leg]) / (2.0 * DIFFERENCE_M)
    return True
