"""Control law, adaptation, plant and virtual tool of a controlled loop (compiled), in SI units.

Of the equations (14) to (22) of Sadeghnejad et al. the text kept the numbers alone: what stands here
satisfies each of their sentences (docs/control.md).  The tissue's law stays in mm and N, a block of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import kernel
from tissueid.model.kernels import STATE_SIZE, tissue_step_in

#: Axes that a loop may have.
MOST_AXES = 3


class LoopBlock(NamedTuple):
    """Numbers of a controlled loop, for compiled code."""

    tool_mass_kg: float
    tool_damping_N_s_per_m: float
    reference_rate_per_s: float
    damping_N_s_per_m: float
    disturbance_bound_N: float  # of what the estimates don't cover
    sigma_start: float
    sigma_rate_per_s: float
    sigma_floor: float
    adaptation_sign: float  # 1 adapts, 0 is frozen, -1 is wrong on purpose
    projection: bool
    saturation_N: float  # largest control force; infinite without one
    variant_B: bool
    touched_by_device: bool  # the environment is touched by the device itself and not by the virtual tool
    force_scale: float
    motion_scale: float
    period_s: float
    substeps: int
    rise_s: float


class Controller(NamedTuple):
    """Arrays that a controller remembers; shape (n,) where nothing else is said."""

    #: Position and velocity of the virtual tool.
    xe: FloatArray
    ve: FloatArray
    estimates: FloatArray  # (p,)
    state: FloatArray  # of the tissue, (STATE_SIZE,)


class Command(NamedTuple):
    """Command of the controller, and what it follows from; shape (n,) where nothing else is said."""

    u: FloatArray  # control force
    rho: FloatArray
    robust: FloatArray
    Y: FloatArray  # (n, p), regressor
    touched: float  # force of the tissue at the end of the period [N]


def new_controller(axes: int, estimates: FloatArray) -> Controller:
    """A controller at rest at the surface of a tissue at rest, with its first estimates."""
    return Controller(np.zeros(axes), np.zeros(axes), estimates, np.zeros(STATE_SIZE))


#: A number each, in this order, after the vectors.
SCALARS = ("environment_force_N", "sigma", "lyapunov", "lyapunov_rate")
#: n numbers each, in this order, after the time.
VECTORS = (
    "position_m",
    "velocity_m_s",
    "tool_position_m",
    "tool_velocity_m_s",
    "hand_force_N",
    "control_force_N",
    "rho_m_s",
    "push_N",
    "disturbance_N",
)


@kernel()
def regressor(x: FloatArray, vr: FloatArray, ar: FloatArray) -> FloatArray:
    """Regressor of ``x``, ``vr`` and ``ar``, shape (n, 3 n (n + 1) / 2)."""
    n = x.size
    entries = n * (n + 1) // 2
    Y = np.zeros((n, 3 * entries))
    column = 0
    for i in range(n):
        for j in range(i, n):
            Y[i, column], Y[j, column] = ar[j], ar[i]
            Y[i, column + entries], Y[j, column + entries] = vr[j], vr[i]
            Y[i, column + 2 * entries], Y[j, column + 2 * entries] = x[j], x[i]
            column += 1
    return Y


@kernel()
def _times(Y: FloatArray, theta: FloatArray) -> FloatArray:
    """Product Y theta, summed in the order of the parameters."""
    out = np.zeros(len(Y))
    for k in range(theta.size):
        out += Y[:, k] * theta[k]
    return out


@kernel()
def generalised_force(theta: FloatArray, x: FloatArray, vr: FloatArray, ar: FloatArray) -> FloatArray:
    """Force Y(x, vr, ar) theta [N], shape (n,)."""
    return _times(regressor(x, vr, ar), theta)


@kernel()
def inertia(theta: FloatArray, axes: int) -> FloatArray:
    """Inertia M among the parameters [kg], shape (n, n)."""
    M = np.zeros((axes, axes))
    column = 0
    for i in range(axes):
        for j in range(i, axes):
            M[i, j] = M[j, i] = theta[column]
            column += 1
    return M


@kernel()
def damping_form(theta: FloatArray, r: FloatArray) -> float:
    """Power [W] that the damping B among the parameters takes at a velocity r: r' B r."""
    n = r.size
    column = n * (n + 1) // 2
    total = 0.0
    for i in range(n):
        for j in range(i, n):
            total += theta[column] * r[i] * r[j] * (1.0 if i == j else 2.0)
            column += 1
    return float(total)


@kernel()
def solved(A: FloatArray, b: FloatArray) -> FloatArray:
    """Solution y of A y = b, by elimination with pivots; A is destroyed."""
    y, n = b.copy(), b.size
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(k, n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            y[k], y[pivot] = y[pivot], y[k]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            for j in range(k, n):
                A[i, j] -= factor * A[k, j]
            y[i] -= factor * y[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            y[k] -= A[k, j] * y[j]
        y[k] /= A[k, k]
    return y


#: Rows of a drive, a column an axis: offset, amplitude, frequency of the hand's push; then of what disturbs.
DRIVE_ROWS = 6
M_TO_MM = 1000.0


@kernel()
def hand_push(block: LoopBlock, drive: FloatArray, time: float) -> FloatArray:
    """Push F*(t) [N]: an offset and a sine an axis, risen linearly from 0."""
    share = min(1.0, time / block.rise_s) if block.rise_s > 0.0 else 1.0
    push: FloatArray = share * (drive[0] + drive[1] * np.sin(2.0 * math.pi * drive[2] * time))
    return push


@kernel()
def disturbance(drive: FloatArray, time: float) -> FloatArray:
    """Disturbance d(t) [N]."""
    disturbed: FloatArray = drive[3] + drive[4] * np.sin(2.0 * math.pi * drive[5] * time)
    return disturbed


@kernel()
def environment_force(
    block: LoopBlock, law: FloatArray, state: FloatArray, place: FloatArray, h: float
) -> float:
    """Step the tissue with a tool at ``place`` [m] and give its force against the first axis [N]."""
    force = tissue_step_in(law, 0, state, 0, place[0] / block.motion_scale * M_TO_MM, h)
    return float(force * block.force_scale)


@kernel()
def tool_acceleration(block: LoopBlock, v: FloatArray, hand: FloatArray, touched: float) -> FloatArray:
    """Acceleration [m/s^2] of the virtual tool: Mt ae = Fh - F_env - Bt ve."""
    force = hand.copy()
    force[0] -= touched
    return (force - block.tool_damping_N_s_per_m * v) / block.tool_mass_kg


@kernel()
def advance_tool(block: LoopBlock, law: FloatArray, c: Controller, hand: FloatArray, touched: float) -> float:
    """Move the virtual tool over one period under a held force of the hand; tissue's force at its end [N].

    Symplectic sub-steps: stable while a sub-step times the tool's frequency on the tissue stays below 2.
    The tissue is stepped along, unless the device itself touches it: then its force is held as well.
    """
    xe, ve, h = c.xe, c.ve, block.period_s / block.substeps
    for _ in range(block.substeps):
        ve += h * tool_acceleration(block, ve, hand, touched)
        xe += h * ve
        if not block.touched_by_device:
            touched = environment_force(block, law, c.state, xe, h)
    return touched


@kernel()
def sigma_at(block: LoopBlock, time: float) -> float:
    """Smoothing sigma(t) of equation (22) [N m/s]."""
    return float(max(block.sigma_start * math.exp(-block.sigma_rate_per_s * time), block.sigma_floor))


@kernel()
def length_of(vector: FloatArray) -> float:
    """Length of a vector."""
    square = 0.0
    for one in vector:
        square += one * one
    return math.sqrt(square)


@kernel()
def saturated(block: LoopBlock, u: FloatArray) -> FloatArray:
    """Force, shortened in its direction to what the device can give."""
    length = length_of(u)
    if length > block.saturation_N:
        return u * (block.saturation_N / length)
    return u


@kernel()
def adapt(
    block: LoopBlock,
    Y: FloatArray,
    rho: FloatArray,
    gains: FloatArray,
    bounds: FloatArray,
    h: float,
    estimates: FloatArray,
) -> None:
    """Move the estimates on by ``h`` seconds; ``gains`` is the diagonal of Gamma, ``bounds`` (2, p)."""
    estimates += h * block.adaptation_sign * gains * _times(Y.T, rho)
    if block.projection:
        for k in range(estimates.size):
            estimates[k] = min(max(estimates[k], bounds[0, k]), bounds[1, k])


@kernel()
def lyapunov(
    block: LoopBlock,
    terms: tuple[FloatArray, FloatArray, FloatArray],
    truth: FloatArray,
    estimates: FloatArray,
    gains: FloatArray,
) -> tuple[float, float]:
    """V of (I-1) and the right side of (I-4), which V' equals where nothing is sampled, late or saturated.

    ``terms``: rho, robust term, and the forces that the estimates don't cover [N].
    """
    rho, robust, unknown = terms
    M = inertia(truth, rho.size)
    V = 0.0
    rate = -damping_form(truth, rho)
    for i in range(rho.size):
        for j in range(rho.size):
            V += 0.5 * rho[i] * M[i, j] * rho[j]
        rate -= rho[i] * (block.damping_N_s_per_m * rho[i] + unknown[i] + robust[i])
    for k in range(truth.size):
        if gains[k] > 0.0:
            V += 0.5 * (truth[k] - estimates[k]) ** 2 / gains[k]
    return V, rate


@kernel()
def command(
    block: LoopBlock,
    law: FloatArray,
    c: Controller,
    time: float,
    device: tuple[FloatArray, FloatArray],
    hand: FloatArray,
    touched: float,
) -> Command:
    """Step the virtual tool through the coming period; the force [N] that is held through it.

    Held until the next tick, the command aims at where the tool will be then.
    """
    x, v = device
    if block.touched_by_device:
        touched = environment_force(block, law, c.state, x, block.period_s)
    touched = advance_tool(block, law, c, hand, touched)
    # the references of equations (16) and (17)
    xe, ve, rate = c.xe, c.ve, block.reference_rate_per_s
    vr = ve + rate * (xe - x)
    ar = tool_acceleration(block, ve, hand, touched) + rate * (ve - v)
    rho = vr - v
    # the robust term of (21): smooth, along rho, of length delta at most
    delta = block.disturbance_bound_N
    below = delta * length_of(rho) + sigma_at(block, time)
    robust = delta * delta * rho / below if below > 0.0 else np.zeros(rho.size)
    # the command of (20), with the measured force of the hand in variant B
    Y = regressor(x, vr, ar)
    total = block.damping_N_s_per_m * rho + robust
    for k in range(c.estimates.size):
        total += Y[:, k] * c.estimates[k]
    if block.variant_B:
        total -= hand
    return Command(saturated(block, total), rho, robust, Y, touched)
