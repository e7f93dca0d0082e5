"""Forces on a controlled loop from outside, and the tissue at its other end (compiled)."""

from __future__ import annotations

import math

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel
from tissueid.model.kernels import tissue_step_in
from tissueid.rendering.control.block import (
    FORCE_SCALE,
    INWARD,
    MOTION_SCALE,
    PERIOD,
    RISE,
    SUBSTEPS,
    TOOL_DAMPING,
    TOOL_MASS,
    TOUCHED_BY_DEVICE,
)

#: Rows of a drive, a column an axis: offset, amplitude, frequency of the hand's push; then of what disturbs.
DRIVE_ROWS = 6
M_TO_MM = 1000.0


@tick_kernel
def hand_push(block: FloatArray, drive: FloatArray, time: float, out: FloatArray) -> None:
    """Write F*(t) [N]: an offset and a sine an axis, risen linearly from 0."""
    share = min(1.0, time / block[RISE]) if block[RISE] > 0.0 else 1.0
    for i in range(out.size):
        out[i] = share * (drive[0, i] + drive[1, i] * math.sin(2.0 * math.pi * drive[2, i] * time))


@tick_kernel
def disturbance(drive: FloatArray, time: float, out: FloatArray) -> None:
    """Write d(t) [N]."""
    for i in range(out.size):
        out[i] = drive[3, i] + drive[4, i] * math.sin(2.0 * math.pi * drive[5, i] * time)


@tick_kernel
def environment_force(
    block: FloatArray, law: FloatArray, state: FloatArray, place: FloatArray, h: float
) -> float:
    """Step the tissue with a tool at ``place`` [m] and give its force along the outward normal [N]."""
    depth = 0.0
    for i in range(place.size):
        depth += block[INWARD + i] * place[i]
    force = tissue_step_in(law, 0, state, 0, depth / block[MOTION_SCALE] * M_TO_MM, h)
    return float(force * block[FORCE_SCALE])


@tick_kernel
def tool_acceleration(
    block: FloatArray, v: FloatArray, hand: FloatArray, touched: float, out: FloatArray
) -> None:
    """Write the acceleration of the virtual tool: Mt ae = Fh - F_env - Bt ve.

    ``block`` (BLOCK_SIZE,); ``v`` (n,): velocity of the tool [m/s]; ``hand`` (n,): measured force of the hand
    on the device [N]; ``touched``: force of the environment [N], along its outward normal; ``out`` (n,):
    [m/s^2].
    """
    for i in range(v.size):
        out[i] = (hand[i] - block[INWARD + i] * touched - block[TOOL_DAMPING] * v[i]) / block[TOOL_MASS]


@tick_kernel
def advance_tool(
    block: FloatArray,
    law: FloatArray,
    state: FloatArray,
    tool: tuple[FloatArray, FloatArray, FloatArray],
    hand: FloatArray,
    touched: float,
) -> float:
    """Move the virtual tool over one period under a force of the hand that is held.

    Symplectic sub-steps: stable while a sub-step times the tool's frequency on the tissue stays below 2.
    The tissue is stepped along, unless the device itself touches it: then its force is held as well.

    ``block``, ``law``, ``state``: of the loop, of the tissue, and what it remembers (**updated**); ``tool``
    (n,): position, velocity, acceleration; **updated**; ``hand``, ``touched``: as in
    :func:`tool_acceleration`.  Returns force of the environment at the end [N].
    """
    x, v, a = tool
    steps = int(block[SUBSTEPS])
    h = block[PERIOD] / steps
    for _ in range(steps):
        tool_acceleration(block, v, hand, touched, a)
        for i in range(x.size):
            v[i] += h * a[i]
            x[i] += h * v[i]
        if block[TOUCHED_BY_DEVICE] == 0.0:
            touched = environment_force(block, law, state, x, h)
    return touched
