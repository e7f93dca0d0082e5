"""The guiding surface around a planned axis: how deep a point is in it, and which way is free (compiled).

Pires et al. print their surface as ``z = c sqrt((x/a)^2 + (y/a)^2) - 1 - b`` and name its constants minimum
radius at z = 0, offset and opening scale.  Two readings:

hyperboloid
    ``z = c sqrt((x/a)^2 + (y/a)^2 - 1) - b``, to which the names belong: one sheet with its throat of radius
    a at z = -b.  Below the throat it goes on as a cylinder.  The default.
cone
    As printed: the "1" is then a length without a unit, which is taken for one millimetre (assumed).  Its
    apex is at z = -(1 mm + b).

Coordinates are the distance r from the axis and the height z along it, out of the bone.  Inside, r is less
than the surface's radius and nothing is felt.  The distance to the hyperboloid is that of the foot of its
normal, found by Newton's method on ``r = a cosh u, z + b = c sinh u``; it is unique up to a penetration of
c^2 / a.
"""

from __future__ import annotations

import math

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_part

HYPERBOLOID = 0
CONE = 1

#: Numbers that describe a funnel.
FUNNEL_SIZE = 4
KIND = 0
A = 1
B = 2
C = 3

#: The length behind the printed "1" [m] (assumed).
PRINTED_ONE_M = 1e-3
#: Newton steps for the foot of the normal: from the height's own point it converges in 3 to 5.
MOST_STEPS = 12
#: Step of u below which the foot stands: times a few millimetres, far below a nanometre.
SMALL_STEP = 1e-12


def hyperboloid_constants(radius_m: float, offset_m: float, slope: float) -> tuple[float, float, float]:
    """The constants a, b, c of a hyperboloid by what can be measured on it.

    ``radius_m``: at the entry point, z = 0 [m]; ``offset_m``: depth of the throat below the entry point [m];
    ``slope``: growth of the radius with the height, far out.  Returns ``a = sqrt(radius^2 - (slope
    offset)^2)``, b and ``c = a / slope`` [m].  Raises ValueError: no hyperboloid has these numbers.
    """
    if not (radius_m > 0.0 and offset_m >= 0.0 and slope > 0.0):
        msg = (
            "a funnel needs a radius and a slope above 0 and an offset of 0 or more, "
            f"got {radius_m}, {slope} and {offset_m}"
        )
        raise ValueError(msg)
    square = radius_m**2 - (slope * offset_m) ** 2
    if not square > 0.0:
        closed = radius_m / slope
        msg = (
            f"a slope of {slope} closes a funnel of {radius_m} m at {closed:.4g} m, above offset {offset_m} m"
        )
        raise ValueError(msg)
    throat = math.sqrt(square)
    return throat, offset_m, throat / slope


@tick_part
def funnel_touch(funnel: FloatArray, at: int, r: float, z: float, normal: FloatArray, first: int) -> float:
    """Penetration of a point, and the direction back to the free side.

    ``funnel``: kind, a, b, c [m] from index ``at``; ``r``, ``z``: distance from the axis and height along it
    [m]; ``normal``: components along r and z of the unit normal toward the free side, written from index
    ``first``.  Returns [m]: positive in the wall.  Inside the funnel it is negative, there to first order in
    the gap.
    """
    if int(funnel[at + KIND]) == CONE:
        return _from_cone(funnel, at, r, z, normal, first)
    return _from_hyperboloid(funnel, at, r, z, normal, first)


@tick_part
def _from_cone(funnel: FloatArray, at: int, r: float, z: float, normal: FloatArray, first: int) -> float:
    slope = funnel[at + A] / funnel[at + C]
    height = z + PRINTED_ONE_M + funnel[at + B]
    if r * slope + height > 0.0:
        length = math.sqrt(1.0 + slope * slope)
        normal[first] = -1.0 / length
        normal[first + 1] = slope / length
        return float((r - slope * height) / length)
    # below the apex, which is the nearest point
    distance = math.sqrt(r * r + height * height)
    normal[first] = -r / distance if distance > 0.0 else 0.0
    normal[first + 1] = -height / distance if distance > 0.0 else 1.0
    return float(distance)


@tick_part
def _from_hyperboloid(
    funnel: FloatArray, at: int, r: float, z: float, normal: FloatArray, first: int
) -> float:
    a, c = funnel[at + A], funnel[at + C]
    height = z + funnel[at + B]
    if height <= 0.0:
        normal[first] = -1.0
        normal[first + 1] = 0.0
        return float(r - a)
    u = math.asinh(height / c)
    gap = r - a * math.cosh(u)
    if gap > 0.0:
        for _ in range(MOST_STEPS):
            ch, sh = math.cosh(u), math.sinh(u)
            along_r, along_z = r - a * ch, height - c * sh
            value = -along_r * a * sh - along_z * c * ch
            slope = a * a * sh * sh - along_r * a * ch + c * c * ch * ch - along_z * c * sh
            step = value / slope
            u -= step
            if abs(step) < SMALL_STEP:
                break
    ch, sh = math.cosh(u), math.sinh(u)
    length = math.sqrt(c * c * ch * ch + a * a * sh * sh)
    normal[first] = -c * ch / length
    normal[first + 1] = a * sh / length
    if gap > 0.0:
        return math.sqrt((r - a * ch) ** 2 + (height - c * sh) ** 2)
    return float(gap * c * ch / length)
