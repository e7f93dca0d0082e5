"""The force that is felt: a tool tip against identified tissue, or a guided axis in its place (compiled).

No friction; beyond the identified depth the law is continued and the tick is marked.  All parameters are one
flat, versioned block, exchanged while the loop runs, at zero penetration.
"""

from __future__ import annotations

import math

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel, tick_part
from tissueid.haptics.states import Lamp
from tissueid.model.kernels import tissue_step_in
from tissueid.model.rupture import static_force_in, stored_energy_in
from tissueid.rendering import guidance as gd
from tissueid.rendering.surface import touch

#: Kinds of environment the compiled loop knows.
FREE_AIR, TISSUE, GUIDANCE = range(3)

# -- the block ------------------------------------------------------------------------------------
BLOCK_VERSION = 3
ENVIRONMENT_SIZE = 204
#: Label: which of the things to be compared this is, 0 for the first; copied to the info.  Residual: share of
#: the force that is left after a rupture.
VERSION, KIND, LABEL, FORCE_SCALE, MOTION_SCALE, DEPTH_MM, FASTEST_MM_S = range(7)
RUPTURE_KIND, RUPTURE_VALUE, RUPTURE_RESIDUAL = range(7, 10)
#: :data:`~tissueid.rendering.surface.SURFACE_SIZE` and :data:`~tissueid.model.kernels.LAW_SIZE` numbers.
SURFACE, LAW = 10, 24
#: w of the weighted force F_s + w F_d; behind the law.
RUPTURE_WEIGHT = 200
#: :data:`~tissueid.rendering.guidance.GUIDANCE_SIZE` numbers, in the place of everything from the surface on.
GUIDED = 10

#: Criteria of rupture, which are readings: none; work done on the tissue [N mm]; weighted force on it [N];
#: energy stored in it [N mm]; depth [mm].
RUPTURE_NONE, RUPTURE_WORK, RUPTURE_FORCE, RUPTURE_STORED, RUPTURE_DEPTH = 0.0, 1.0, 2.0, 3.0, 4.0

# -- the memory, all zero for tissue at rest --------------------------------------------------------
MEMORY_SIZE = 66
#: :data:`~tissueid.model.kernels.STATE_SIZE` numbers, the surface [mm] first.
TISSUE_STATE = 0
LAST_DEPTH, LAST_FORCE, SPEED, WORK, BROKEN = range(50, 55)
#: :data:`~tissueid.rendering.surface.TOUCH_SIZE` numbers, the face first, then the normal.
TOUCH, NORMAL = 55, 56
#: What guidance says of a step; its own memory stands before it.
SAID = gd.GUIDANCE_MEMORY

# -- what a step says -----------------------------------------------------------------------------
INFO_SIZE = 8
INFO_PENETRATION_M, INFO_DEPTH_MM, INFO_SPEED_MM_S, INFO_TISSUE_FORCE_N, INFO_DEVICE_FORCE_N = range(5)
#: Bits of :class:`tissueid.haptics.states.Lamp`.
INFO_FLAGS = 5
INFO_SURFACE_MM, INFO_LABEL = 6, 7

OUTSIDE_DEPTH = int(Lamp.OUTSIDE_DEPTH)
OUTSIDE_SPEED = int(Lamp.OUTSIDE_SPEED)
RUPTURED = int(Lamp.RUPTURED)

#: Time constant of the speed behind the lamp [s]: one count of an encoder in one tick is 45 mm/s.
SPEED_FILTER_S = 0.05
#: Share over the identified depth, and over the fastest identified speed, that is rounding and ripple.
DEPTH_MARGIN = 0.01
SPEED_MARGIN = 0.05


@tick_kernel
def put_at_rest(memory: FloatArray) -> None:
    """Tissue whole and at rest, as before anything touched it."""
    for i in range(memory.size):
        memory[i] = 0.0


@tick_part
def environment_step(
    parameters: FloatArray,
    memory: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    dt: float,
    force: FloatArray,
    info: FloatArray,
) -> None:
    """Write force [N, at the device] on the tool and ``info`` at the end of a step of ``dt`` seconds.

    Any other kind than :data:`TISSUE` and :data:`GUIDANCE` is free air; ``position``, ``velocity`` [m],
    [m/s]: of the tip's centre; the velocity only judges whether the law was identified there.
    """
    kind = int(parameters[KIND])
    for i in range(3):
        force[i] = 0.0
    for i in range(INFO_SIZE):
        info[i] = 0.0
    info[INFO_LABEL] = parameters[LABEL]
    if kind == TISSUE:
        _tissue(parameters, memory, position, velocity, dt, force, info)
    elif kind == GUIDANCE:
        gd.guidance_step(parameters, GUIDED, memory, position, dt, force, memory, SAID)
        info[INFO_PENETRATION_M] = memory[SAID + gd.SAID_PENETRATION_M]
        info[INFO_DEPTH_MM] = -memory[SAID + gd.SAID_HEIGHT_M] * gd.M_TO_MM
        info[INFO_TISSUE_FORCE_N] = memory[SAID + gd.SAID_BONE_N]
        info[INFO_DEVICE_FORCE_N] = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)


@tick_part
def _tissue(
    parameters: FloatArray,
    memory: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    dt: float,
    force: FloatArray,
    info: FloatArray,
) -> None:
    """One step against a tissue surface."""
    penetration = touch(parameters, SURFACE, position, memory, TOUCH)
    depth = penetration / parameters[MOTION_SCALE] * gd.M_TO_MM
    tissue_force = tissue_step_in(parameters, LAW, memory, TISSUE_STATE, depth, dt)
    _rupture(parameters, memory, depth, tissue_force)
    if memory[BROKEN] > 0.0:
        tissue_force *= parameters[RUPTURE_RESIDUAL]
    inward = 0.0
    for i in range(3):
        inward -= velocity[i] * memory[NORMAL + i]
    share = dt / (dt + SPEED_FILTER_S)
    memory[SPEED] += share * (inward / parameters[MOTION_SCALE] * gd.M_TO_MM - memory[SPEED])
    speed = memory[SPEED]
    device_force = tissue_force * parameters[FORCE_SCALE]
    for i in range(3):
        force[i] = device_force * memory[NORMAL + i]
    info[INFO_PENETRATION_M] = penetration
    info[INFO_DEPTH_MM] = depth
    info[INFO_SPEED_MM_S] = speed
    info[INFO_TISSUE_FORCE_N] = tissue_force
    info[INFO_DEVICE_FORCE_N] = device_force
    info[INFO_SURFACE_MM] = memory[TISSUE_STATE]
    info[INFO_FLAGS] = _lamps(parameters, memory, depth, speed)
    memory[LAST_DEPTH] = depth
    memory[LAST_FORCE] = tissue_force


@tick_part
def _rupture(parameters: FloatArray, memory: FloatArray, depth: float, tissue_force: float) -> None:
    """Count the work done on the tissue and see whether it breaks."""
    kind = parameters[RUPTURE_KIND]
    if kind == RUPTURE_NONE or memory[BROKEN] > 0.0:
        return
    before = max(memory[LAST_DEPTH], 0.0)
    memory[WORK] += 0.5 * (memory[LAST_FORCE] + tissue_force) * (max(depth, 0.0) - before)
    if kind == RUPTURE_WORK:
        reached = memory[WORK]
    elif kind == RUPTURE_FORCE:
        static = static_force_in(parameters, LAW, memory, TISSUE_STATE)
        reached = static + parameters[RUPTURE_WEIGHT] * (tissue_force - static)
    elif kind == RUPTURE_STORED:
        reached = stored_energy_in(parameters, LAW, memory, TISSUE_STATE)
    else:
        reached = max(depth, 0.0)
    if depth > 0.0 and reached >= parameters[RUPTURE_VALUE]:
        memory[BROKEN] = 1.0


@tick_part
def _lamps(parameters: FloatArray, memory: FloatArray, depth: float, speed: float) -> float:
    """Lamps of this step: only tissue that is touched is outside what was identified."""
    flags = 0
    if depth > parameters[DEPTH_MM] * (1.0 + DEPTH_MARGIN):
        flags |= OUTSIDE_DEPTH
    if depth > 0.0 and abs(speed) > parameters[FASTEST_MM_S] * (1.0 + SPEED_MARGIN):
        flags |= OUTSIDE_SPEED
    if memory[BROKEN] > 0.0:
        flags |= RUPTURED
    return float(flags)
