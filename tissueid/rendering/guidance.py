"""Guidance along a planned axis: a funnel, a pull to the axis, a bone that is drilled (compiled).

The environment of Pires et al., Haptic Positioning Environment for the Hip Resurfacing Surgery;
docs/guidance.md says which parts are readings.  Forces add up; r is the distance from the axis, z the height
out of the bone.
"""

from __future__ import annotations

import math

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel, tick_part
from tissueid.model.impact import IMPACT_SIZE, IMPACT_STATE, impact_step

#: Readings of the printed ``z = c sqrt((x/a)^2 + (y/a)^2) - 1 - b``: with the 1 below the root, a sheet whose
#: throat of radius a at z = -b goes on as a cylinder; as it is printed, with its apex at z = -(1 mm + b).
HYPERBOLOID, CONE = 0, 1
#: Numbers that describe a funnel.
FUNNEL_SIZE = 4
KIND, A, B, C = range(4)
#: The length behind the printed "1" [m] (assumed).
PRINTED_ONE_M = 1e-3
#: Newton steps for the foot of the normal: from the height's own point it converges in 3 to 5.
MOST_STEPS = 12
#: Step of u below which the foot stands: times a few millimetres, far below a nanometre.
SMALL_STEP = 1e-12


def hyperboloid_constants(radius_m: float, offset_m: float, slope: float) -> tuple[float, float, float]:
    """The constants a, b, c [m] of a hyperboloid: a = sqrt(radius^2 - (slope offset)^2), b, c = a / slope.

    ``radius_m``: at the entry point; ``offset_m``: depth of the throat below it. Raises ValueError: no
    hyperboloid has these numbers.
    """
    if not (radius_m > 0.0 and offset_m >= 0.0 and slope > 0.0):
        raise ValueError(
            "a funnel needs a radius and a slope above 0 and an offset of 0 or more, "
            f"got {radius_m}, {slope} and {offset_m}"
        )
    square = radius_m**2 - (slope * offset_m) ** 2
    if not square > 0.0:
        closed = radius_m / slope
        raise ValueError(
            f"a slope of {slope} closes a funnel of {radius_m} m at {closed:.4g} m, above offset {offset_m} m"
        )
    throat = math.sqrt(square)
    return throat, offset_m, throat / slope


@tick_part
def funnel_touch(funnel: FloatArray, at: int, r: float, z: float, normal: FloatArray, first: int) -> float:
    """Penetration [m] into the wall, to first order inside; the unit normal (r, z) out of it is written."""
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


def funnel_radius(funnel: FloatArray, z: FloatArray) -> FloatArray:
    """Radius of the surface at heights above the entry point [m], by its closed form."""
    kind, a, b, c = funnel
    if int(kind) == CONE:
        return np.asarray(a * (z + PRINTED_ONE_M + b) / c)
    return np.asarray(a * np.sqrt(1.0 + ((z + b) / c) ** 2))


# -- the block, from an index on ------------------------------------------------------------------
#: Entry point [m], and unit vector of the axis out of the bone.
ORIGIN, AXIS, FUNNEL = 0, 3, 6
CONTACT = FUNNEL + FUNNEL_SIZE
PULL = CONTACT + IMPACT_SIZE
#: K far above and at the entry point [N/m], L [m], tau [s], filter [s], 1 for the axial force.
K_FAR, K_NEAR, REACH, TAU, FILTER_S, AXIAL = range(PULL, PULL + 6)
#: Force at the entry point [N], then its change along x, y, z [N/m], rows by component of the force.
WEIGHT = PULL + 6
WEIGHT_SLOPE = WEIGHT + 3
BONE = WEIGHT_SLOPE + 9
#: Radius of the ball [m] (0: no bone), stiffness [N/m], radius of the guide hole [m], resistance R of the
#: drilling [N s/m], depth at which it ends [m].
RADIUS, STIFFNESS, HOLE, RESISTANCE, DRILL_END = range(BONE, BONE + 5)
GUIDANCE_SIZE = BONE + 5

# -- the memory -----------------------------------------------------------------------------------
STARTED, RHO, RATE, IMPACT = 0, 1, 4, 7
#: How far the drill front stands below the entry point [m]; how the tip came into the bone: not at all, by
#: the guide hole, beside it.
DRILLED, LAST_DEPTH, WAY_IN = range(IMPACT + IMPACT_STATE, IMPACT + IMPACT_STATE + 3)
OUTSIDE, BY_THE_HOLE, BESIDE_IT = 0.0, 1.0, 2.0
#: Components along the radius and the axis: of the wall's normal, of the bone's force [N].
WALL = DRILLED + 3
FROM_BONE = DRILLED + 5
GUIDANCE_MEMORY = DRILLED + 7

M_TO_MM = 1000.0
#: Distance from the axis below which it has no direction [m].
ON_AXIS_M = 1e-9

# -- what a step says, from an index on: penetration is into wall or bone [m], negative in neither
SAID_HEIGHT_M, SAID_OFF_AXIS_M, SAID_WALL_N, SAID_PULL_N, SAID_BONE_N, SAID_PENETRATION_M = range(6)
SAID_SIZE = 6


@tick_part
def axial_stiffness(block: FloatArray, at: int, z: float, derivative: bool) -> float:
    """K at a height [N/m], or its derivative by the height [N/m^2]."""
    rise = block[at + K_NEAR] - block[at + K_FAR]
    if z <= 0.0:
        return 0.0 if derivative else float(block[at + K_NEAR])
    reach = block[at + REACH]
    share = math.exp(-0.5 * (z / reach) ** 2)
    return (
        float(-rise * share * z / (reach * reach)) if derivative else float(block[at + K_FAR] + rise * share)
    )


@tick_kernel
def guidance_step(
    block: FloatArray,
    at: int,
    memory: FloatArray,
    position: FloatArray,
    dt: float,
    force: FloatArray,
    said: FloatArray,
    first: int,
) -> None:
    """Write the force [N] on a tip at ``position`` [m] after a step, and ``said``; memory begins at zero."""
    z = 0.0
    for i in range(3):
        z += (position[i] - block[at + ORIGIN + i]) * block[at + AXIS + i]
    share = 0.0
    if memory[STARTED] > 0.0 and dt > 0.0:
        filter_s = block[at + FILTER_S]
        share = 1.0 - math.exp(-dt / filter_s) if filter_s > 0.0 else 1.0
    stiffness = axial_stiffness(block, at, z, False)
    square, pull = 0.0, 0.0
    for i in range(3):
        rho = position[i] - block[at + ORIGIN + i] - z * block[at + AXIS + i]
        if share > 0.0:
            memory[RATE + i] += share * ((rho - memory[RHO + i]) / dt - memory[RATE + i])
        memory[RHO + i] = rho
        square += rho * rho
        force[i] = -stiffness * (rho + block[at + TAU] * memory[RATE + i])
        pull += force[i] * force[i]
    memory[STARTED] = 1.0
    r = math.sqrt(square)

    depth = funnel_touch(block, at + FUNNEL, r, z, memory, WALL)
    wall = impact_step(block, at + CONTACT, memory, IMPACT, depth * M_TO_MM, dt)
    _bone(block, at, memory, r, z, dt)
    along = wall * memory[WALL + 1] + memory[FROM_BONE + 1]
    if block[at + AXIAL] > 0.0:
        along -= 0.5 * axial_stiffness(block, at, z, True) * square
    sideways = (wall * memory[WALL] + memory[FROM_BONE]) / r if r > ON_AXIS_M else 0.0
    for i in range(3):
        force[i] += sideways * memory[RHO + i] + along * block[at + AXIS + i] + block[at + WEIGHT + i]
        for j in range(3):
            force[i] += block[at + WEIGHT_SLOPE + 3 * i + j] * (position[j] - block[at + ORIGIN + j])
    said[first + SAID_PENETRATION_M] = depth if memory[WAY_IN] == OUTSIDE else max(depth, -z)
    said[first + SAID_HEIGHT_M] = z
    said[first + SAID_OFF_AXIS_M] = r
    said[first + SAID_WALL_N] = wall
    said[first + SAID_PULL_N] = math.sqrt(pull)
    said[first + SAID_BONE_N] = math.sqrt(memory[FROM_BONE] ** 2 + memory[FROM_BONE + 1] ** 2)


@tick_part
def _bone(block: FloatArray, at: int, memory: FloatArray, r: float, z: float, dt: float) -> None:
    """Force of the bone along the radius and the axis, written to the memory."""
    memory[FROM_BONE] = 0.0
    memory[FROM_BONE + 1] = 0.0
    radius, depth = block[at + RADIUS], -z
    before, memory[LAST_DEPTH] = memory[LAST_DEPTH], depth
    out = radius + z
    length = math.sqrt(r * r + out * out)
    inside = radius - length
    if radius <= 0.0 or (depth <= 0.0 and memory[WAY_IN] == BY_THE_HOLE):
        memory[WAY_IN] = OUTSIDE
        return
    if memory[WAY_IN] != BY_THE_HOLE:
        if inside <= 0.0:
            memory[WAY_IN] = OUTSIDE
            return
        if memory[WAY_IN] == OUTSIDE:
            memory[WAY_IN] = BY_THE_HOLE if r <= block[at + HOLE] else BESIDE_IT
    stiffness = block[at + STIFFNESS]
    if memory[WAY_IN] == BY_THE_HOLE:
        memory[FROM_BONE] = -stiffness * max(r - block[at + HOLE], 0.0)
        memory[FROM_BONE + 1] = _drill(block, at, memory, before, depth, dt)
    elif length > ON_AXIS_M:
        memory[FROM_BONE] = stiffness * inside * r / length
        memory[FROM_BONE + 1] = stiffness * inside * out / length


@tick_part
def _drill(block: FloatArray, at: int, memory: FloatArray, before: float, depth: float, dt: float) -> float:
    """Force of the drill front after a step of linear motion [N]; the front recedes."""
    front = memory[DRILLED]
    if front >= block[at + DRILL_END] or depth <= front:
        return 0.0
    stiffness = block[at + STIFFNESS]
    if dt > 0.0:
        # exact for a linear motion; within the step it begins where the tip meets the front
        start = max(before, front)
        part = dt if before >= front else dt * (depth - front) / (depth - before)
        lag = block[at + RESISTANCE] / stiffness
        decay = math.exp(-part / lag)
        gap = (start - front) * decay + (depth - start) / part * lag * (1.0 - decay)
        memory[DRILLED] = depth - gap
    if memory[DRILLED] >= block[at + DRILL_END]:
        return 0.0
    return float(stiffness * (depth - memory[DRILLED]))
