"""The loop as its proof has it: nothing is sampled, held or late (compiled).

The hand's force holds its own acceleration, which the control force changes: an algebraic loop, linear in the
acceleration ``a`` of the device, solved in every step::

    Fh = f0 - Mh a,   ar = ar0 - Mh a / Mt,   u = u0 - (M^ Mh / Mt) a   [+ Mh a in variant B]
    (M + M^ Mh / Mt [- Mh]) a = F* - d + u0 - c

M^ is the inertia of the estimates.  Steps of Heun, second order where the contact is smooth; the tissue steps
exactly along each.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel
from tissueid.model.kernels import STATE_SIZE
from tissueid.rendering.control.block import (
    PERIOD,
    TOOL_MASS,
    TOUCHED_BY_DEVICE,
    VARIANT,
    VARIANT_B,
    record_row,
)
from tissueid.rendering.control.drive import disturbance, environment_force, hand_push, tool_acceleration
from tissueid.rendering.control.law import (
    adapt,
    control_force,
    lyapunov,
    not_covered,
    reference,
    robust_term,
    sigma_at,
)
from tissueid.rendering.control.plant import generalised_force, inertia, regress, solve
from tissueid.rendering.control.sampled import LARGEST_M

Five = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
#: Rows of the state of motion: position and velocity of the device, of the tool.
MOTION_ROWS = 4
#: Rows of forces, see :func:`_forces`; one for what the estimates don't cover, two to work in.
FORCE_ROWS = 13


@tick_kernel
def _forces(
    block: FloatArray,
    parameters: tuple[FloatArray, FloatArray, FloatArray],
    moment: tuple[FloatArray, float],
    motion: FloatArray,
    estimates: FloatArray,
    touched: float,
    forces: FloatArray,
    room: Five,
) -> None:
    """Solve the algebraic loop at one moment, of the drive and the time.

    Rows of ``forces``, all written: push, disturbance, force of the hand, control force, rho, robust term,
    acceleration of device and tool, vr, ar.
    """
    drive, time = moment
    total, operator = parameters[0], parameters[1]
    spare, Y, M, Mh, Mc = room
    x, v, ve = motion[0], motion[1], motion[3]
    push, disturbed, hand, u, rho, robust = forces[0], forces[1], forces[2], forces[3], forces[4], forces[5]
    a, ae, vr, ar = forces[6], forces[7], forces[8], forces[9]
    n = x.size
    hand_push(block, drive, time, push)
    disturbance(drive, time, disturbed)
    inertia(block, operator, x, spare, Y, Mh)
    inertia(block, estimates, x, spare, Y, Mc)
    inertia(block, total, x, spare, Y, M)
    for i in range(n):
        a[i] = 0.0
    generalised_force(block, operator, x, v, v, a, Y, hand)
    for i in range(n):
        hand[i] = push[i] - hand[i]
    tool_acceleration(block, ve, hand, touched, ae)
    reference(block, (x, v), (motion[2], ve, ae), (vr, ar, rho))
    robust_term(block, rho, sigma_at(block, time), robust)
    regress(block, x, v, vr, ar, Y)
    control_force(block, Y, estimates, rho, robust, hand, u)
    # the plant's own forces take the room of vr, which is not needed any more
    generalised_force(block, total, x, v, v, a, Y, vr)
    for i in range(n):
        ar[i] = push[i] - disturbed[i] + u[i] - vr[i]
        for j in range(n):
            for k in range(n):
                M[i, j] += Mc[i, k] * Mh[k, j] / block[TOOL_MASS]
            if block[VARIANT] == VARIANT_B:
                M[i, j] -= Mh[i, j]
    solve(M, ar)
    for i in range(n):
        a[i] = ar[i]
    for i in range(n):
        for j in range(n):
            hand[i] -= Mh[i, j] * a[j]
    tool_acceleration(block, ve, hand, touched, ae)
    reference(block, (x, v), (motion[2], ve, ae), (vr, ar, rho))
    regress(block, x, v, vr, ar, Y)
    control_force(block, Y, estimates, rho, robust, hand, u)


@tick_kernel
def _tissue(block: FloatArray, law: FloatArray, state: FloatArray, motion: FloatArray, h: float) -> float:
    """Force of the environment [N] on whatever touches it."""
    return environment_force(block, law, state, motion[0 if block[TOUCHED_BY_DEVICE] > 0.0 else 2], h)


@tick_kernel
def _slopes(motion: FloatArray, forces: FloatArray, out: FloatArray) -> None:
    """Time derivative of the motion."""
    for i in range(motion.shape[1]):
        out[0, i] = motion[1, i]
        out[1, i] = forces[6, i]
        out[2, i] = motion[3, i]
        out[3, i] = forces[7, i]


@tick_kernel
def _copy(source: FloatArray, target: FloatArray) -> None:
    for k in range(source.size):
        target[k] = source[k]


def continuous_room(
    axes: int, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, Five]:
    """Room of a run: motions, forces, inertias, regressor; estimates and tissue, each with its trials."""
    return (
        np.zeros((4, MOTION_ROWS, axes)),
        np.zeros((FORCE_ROWS, axes)),
        np.zeros((3, axes, axes)),
        np.zeros((axes, start.size)),
        (start.copy(), start.copy(), start.copy(), np.zeros(STATE_SIZE), np.zeros(STATE_SIZE)),
    )


@tick_kernel
def _step(
    block: FloatArray,
    law: FloatArray,
    parameters: tuple[FloatArray, FloatArray, FloatArray],
    adaptation: tuple[FloatArray, FloatArray],
    moment: tuple[FloatArray, float],
    motions: FloatArray,
    forces: FloatArray,
    rooms: tuple[Five, Five],
) -> float:
    """One step of Heun from a moment whose forces are known; the force of the environment at its end."""
    gains, bounds = adaptation
    solving, lists = rooms
    h = block[PERIOD]
    motion, ahead, slope, slope_ahead = motions[0], motions[1], motions[2], motions[3]
    estimates, guess, moved, state, trial = lists
    Y = solving[1]
    regress(block, motion[0], motion[1], forces[8], forces[9], Y)
    _slopes(motion, forces, slope)
    _copy(estimates, guess)
    adapt(block, Y, forces[4], gains, bounds, h, guess)
    for k in range(MOTION_ROWS):
        for i in range(motion.shape[1]):
            ahead[k, i] = motion[k, i] + h * slope[k, i]
    _copy(state, trial)
    pressed = _tissue(block, law, trial, ahead, h)
    _forces(block, parameters, (moment[0], moment[1] + h), ahead, guess, pressed, forces, solving)
    _slopes(ahead, forces, slope_ahead)
    _copy(guess, moved)
    adapt(block, Y, forces[4], gains, bounds, h, moved)
    for k in range(estimates.size):
        estimates[k] = 0.5 * (estimates[k] + moved[k])
    for k in range(MOTION_ROWS):
        for i in range(motion.shape[1]):
            motion[k, i] += 0.5 * h * (slope[k, i] + slope_ahead[k, i])
    return float(_tissue(block, law, state, motion, h))


@tick_kernel
def run_continuous(
    block: FloatArray,
    law: FloatArray,
    parameters: tuple[FloatArray, FloatArray, FloatArray],
    adaptation: tuple[FloatArray, FloatArray],
    drive: FloatArray,
    every: int,
    room: tuple[FloatArray, FloatArray, FloatArray, FloatArray, Five],
    out: FloatArray,
) -> int:
    """Run a loop from rest at the surface of the tissue; a row every ``every`` steps of the period.

    Parameters, ``out`` and what is returned as in
    :func:`tissueid.rendering.control.sampled.run_sampled`; ``room`` is of :func:`continuous_room`.
    """
    motions, forces, squares, Y, lists = room
    motion, unknown, spare = motions[0], forces[10], forces[11:13]
    solving = (spare, Y, squares[0], squares[1], squares[2])
    estimates, gains, truth = lists[0], adaptation[0], parameters[2]
    touched = 0.0
    for row in range(out.shape[0]):
        for step in range(every):
            time = (row * every + step) * block[PERIOD]
            _forces(block, parameters, (drive, time), motion, estimates, touched, forces, solving)
            if step == 0:
                rho, robust = forces[4], forces[5]
                not_covered(block, forces[0], forces[1], unknown)
                V, rate = lyapunov(
                    block, motion[0], (rho, robust, unknown), truth, estimates, gains, (spare, Y, squares[0])
                )
                led = (motion[0], motion[1], motion[2], motion[3])
                vectors = (*led, forces[2], forces[3], rho, forces[0], forces[1])
                record_row(out[row], time, vectors, (touched, sigma_at(block, time), V, rate), estimates)
            touched = _step(
                block, law, parameters, adaptation, (drive, time), motions, forces, (solving, lists)
            )
        for i in range(motion.shape[1]):
            if not abs(motion[0, i]) < LARGEST_M:
                return row + 1
    return int(out.shape[0])
