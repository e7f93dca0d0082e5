"""The loop as a computer runs it: sampled, held, with a force sensor that is one sample old (compiled).

At each tick the controller reads position and velocity, and the force that the hand had under the *last*
command; the virtual tool lives in the computer and is stepped finer; the control force is held until the
next tick, while device and hand move on, finer as well.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel
from tissueid.model.kernels import STATE_SIZE
from tissueid.rendering.control.block import PERIOD, SUBSTEPS, record_row
from tissueid.rendering.control.drive import disturbance, hand_push
from tissueid.rendering.control.law import adapt, command, lyapunov, not_covered, sigma_at
from tissueid.rendering.control.plant import generalised_force, inertia, solve

#: A device that is farther away than this has diverged [m].
LARGEST_M = 10.0
VECTOR_ROWS = 22


@tick_kernel
def _advance_plant(
    block: FloatArray,
    parameters: tuple[FloatArray, FloatArray],
    drive: FloatArray,
    time: float,
    u: FloatArray,
    plant: tuple[FloatArray, FloatArray, FloatArray],
    room: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """Move device and hand over one period under a held control force; leave the sensor's reading.

    ``parameters`` are those of device and hand together, and of the hand; ``plant`` is position, velocity and
    the force of the hand on the device, all updated.
    """
    total, operator = parameters
    x, v, hand = plant
    a, push, disturbed, spare, Y, M = room
    steps = int(block[SUBSTEPS])
    h = block[PERIOD] / steps
    for step in range(steps):
        hand_push(block, drive, time + step * h, push)
        disturbance(drive, time + step * h, disturbed)
        for i in range(x.size):
            a[i] = 0.0
        generalised_force(block, total, x, v, v, a, Y, hand)
        for i in range(x.size):
            a[i] = push[i] + u[i] - disturbed[i] - hand[i]
        inertia(block, total, x, spare, Y, M)
        solve(M, a)
        if step == steps - 1:
            # what the sensor feels: the push, less what moves and holds the hand itself
            generalised_force(block, operator, x, v, v, a, Y, hand)
            for i in range(x.size):
                hand[i] = push[i] - hand[i]
        for i in range(x.size):
            v[i] += h * a[i]
            x[i] += h * v[i]


def sampled_room(
    axes: int, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """Room of a run: vectors, regressor twice, inertia; the estimates and the tissue at rest."""
    return (
        np.zeros((VECTOR_ROWS, axes)),
        np.zeros((axes, start.size)),
        np.zeros((axes, start.size)),
        np.zeros((axes, axes)),
        (start.copy(), np.zeros(STATE_SIZE)),
    )


@tick_kernel
def run_sampled(
    block: FloatArray,
    law: FloatArray,
    parameters: tuple[FloatArray, FloatArray, FloatArray],
    adaptation: tuple[FloatArray, FloatArray],
    drive: FloatArray,
    noise: FloatArray,
    room: tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[FloatArray, FloatArray]],
    out: FloatArray,
) -> int:
    """Run a loop from rest at the surface of the tissue.

    ``block`` (BLOCK_SIZE,); ``law`` (LAW_SIZE,): of the tissue, :func:`tissueid.model.kernels.pack_law`;
    ``parameters`` (p,): of device and hand together, of the hand, and what the estimates should be;
    ``adaptation``: gains, shape (p,), and bounds, shape (2, p); ``drive`` (DRIVE_ROWS, n); ``noise`` (ticks,
    n): added to the force sensor [N]; ``room``: of :func:`sampled_room`: zeros to work in, and the first
    estimates; ``out`` (ticks, row_size(n, p)): **Written**, see :mod:`tissueid.rendering.control.block`: each
    row at its tick, before anything moves.  Returns rows written; fewer than ticks where the loop diverged.
    """
    n = drive.shape[1]
    rows, Y, Z, M, lists = room
    gains, bounds = adaptation
    truth = parameters[2]
    x, v, hand, sensed = rows[0], rows[1], rows[2], rows[3]
    tool = (rows[4], rows[5], rows[6])
    wanted = (rows[7], rows[8], rows[9])
    u, robust, push, disturbed, unknown = rows[10], rows[11], rows[12], rows[13], rows[14]
    was = (rows[15], rows[16])
    spare = rows[17:19]
    plant_room = (rows[19], rows[20], rows[21], spare, Z, M)
    estimates, state = lists
    touched = 0.0
    for tick in range(out.shape[0]):
        time = tick * block[PERIOD]
        hand_push(block, drive, time, push)
        disturbance(drive, time, disturbed)
        for i in range(n):
            sensed[i] = hand[i] + noise[tick, i]
            was[0][i], was[1][i] = tool[0][i], tool[1][i]
        before = touched
        touched = command(
            block, law, state, time, (x, v), sensed, touched, tool, wanted, robust, estimates, Y, u
        )
        not_covered(block, push, disturbed, unknown)
        V, rate = lyapunov(block, x, (wanted[2], robust, unknown), truth, estimates, gains, (spare, Z, M))
        record_row(
            out[tick],
            time,
            (x, v, was[0], was[1], sensed, u, wanted[2], push, disturbed),
            (before, sigma_at(block, time), V, rate),
            estimates,
        )
        adapt(block, Y, wanted[2], gains, bounds, block[PERIOD], estimates)
        _advance_plant(block, (parameters[0], parameters[1]), drive, time, u, (x, v, hand), plant_room)
        for i in range(n):
            if not abs(x[i]) < LARGEST_M:
                return tick + 1
    return int(out.shape[0])
