"""Control law, adaptation, plant and virtual tool of a controlled loop (compiled), in SI units.

Of the equations (14) to (22) of Sadeghnejad et al. the text kept the numbers alone: what stands here
satisfies each of their sentences (docs/control.md).  The tissue's law stays in mm and N, a block of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel
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
    inward: FloatArray  # unit vector into the tissue, 3 numbers
    period_s: float
    substeps: int
    rise_s: float


class Controller(NamedTuple):
    """Arrays that a controller remembers and writes; shape (n,) where nothing else is said."""

    #: Position, velocity and acceleration of the virtual tool.
    xe: FloatArray
    ve: FloatArray
    ae: FloatArray
    #: Reference velocity and acceleration, and rho.
    vr: FloatArray
    ar: FloatArray
    rho: FloatArray
    robust: FloatArray
    u: FloatArray  # control force
    Y: FloatArray  # (n, p), regressor
    estimates: FloatArray  # (p,)
    state: FloatArray  # of the tissue, (STATE_SIZE,)


def new_controller(axes: int, estimates: FloatArray) -> Controller:
    """A controller at rest at the surface of a tissue at rest, with its first estimates."""
    vectors = [np.zeros(axes) for _ in range(8)]
    return Controller._make([*vectors, np.zeros((axes, estimates.size)), estimates, np.zeros(STATE_SIZE)])


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


def row_size(axes: int, parameters: int) -> int:
    """Numbers a row: time, vectors, scalars, estimates."""
    return 1 + axes * len(VECTORS) + len(SCALARS) + parameters


@tick_kernel
def record_row(
    row: FloatArray,
    time: float,
    vectors: tuple[FloatArray, ...],
    scalars: tuple[float, float, float, float],
    estimates: FloatArray,
) -> None:
    """Write a row: the time, :data:`VECTORS`, :data:`SCALARS`, the estimates."""
    row[0] = time
    at = 1
    for vector in vectors:
        for i in range(vector.size):
            row[at] = vector[i]
            at += 1
    for scalar in scalars:
        row[at] = scalar
        at += 1
    for k in range(estimates.size):
        row[at] = estimates[k]
        at += 1


@tick_kernel
def regress(x: FloatArray, vr: FloatArray, ar: FloatArray, Y: FloatArray) -> None:
    """Write the regressor of ``x``, ``vr`` and ``ar``, shape (n, 3 n (n + 1) / 2)."""
    n, size = Y.shape
    for i in range(n):
        for k in range(size):
            Y[i, k] = 0.0
    entries = n * (n + 1) // 2
    column = 0
    for i in range(n):
        for j in range(i, n):
            Y[i, column] += ar[j]
            Y[i, column + entries] += vr[j]
            Y[i, column + 2 * entries] += x[j]
            if i != j:
                Y[j, column] += ar[i]
                Y[j, column + entries] += vr[i]
                Y[j, column + 2 * entries] += x[i]
            column += 1


@tick_kernel
def generalised_force(
    theta: FloatArray, x: FloatArray, vr: FloatArray, ar: FloatArray, Y: FloatArray, out: FloatArray
) -> None:
    """Write Y(x, vr, ar) theta [N] into ``out``, shape (n,); ``Y`` is room to work in, and written."""
    regress(x, vr, ar, Y)
    for i in range(out.size):
        total = 0.0
        for k in range(theta.size):
            total += Y[i, k] * theta[k]
        out[i] = total


@tick_kernel
def inertia(theta: FloatArray, M: FloatArray) -> None:
    """Write the inertia M among the parameters [kg], shape (n, n), into ``M``."""
    column = 0
    for i in range(len(M)):
        for j in range(i, len(M)):
            M[i, j] = M[j, i] = theta[column]
            column += 1


@tick_kernel
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


@tick_kernel
def solve(A: FloatArray, b: FloatArray) -> None:
    """Solve A y = b by elimination with pivots; the answer takes the place of ``b``, A is destroyed."""
    n = b.size
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(k, n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            b[k], b[pivot] = b[pivot], b[k]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            for j in range(k, n):
                A[i, j] -= factor * A[k, j]
            b[i] -= factor * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= A[k, j] * b[j]
        b[k] /= A[k, k]


#: Rows of a drive, a column an axis: offset, amplitude, frequency of the hand's push; then of what disturbs.
DRIVE_ROWS = 6
M_TO_MM = 1000.0


@tick_kernel
def hand_push(block: LoopBlock, drive: FloatArray, time: float, out: FloatArray) -> None:
    """Write F*(t) [N]: an offset and a sine an axis, risen linearly from 0."""
    share = min(1.0, time / block.rise_s) if block.rise_s > 0.0 else 1.0
    for i in range(out.size):
        out[i] = share * (drive[0, i] + drive[1, i] * math.sin(2.0 * math.pi * drive[2, i] * time))


@tick_kernel
def disturbance(drive: FloatArray, time: float, out: FloatArray) -> None:
    """Write d(t) [N]."""
    for i in range(out.size):
        out[i] = drive[3, i] + drive[4, i] * math.sin(2.0 * math.pi * drive[5, i] * time)


@tick_kernel
def environment_force(
    block: LoopBlock, law: FloatArray, state: FloatArray, place: FloatArray, h: float
) -> float:
    """Step the tissue with a tool at ``place`` [m] and give its force along the outward normal [N]."""
    depth = 0.0
    for i in range(place.size):
        depth += block.inward[i] * place[i]
    force = tissue_step_in(law, 0, state, 0, depth / block.motion_scale * M_TO_MM, h)
    return float(force * block.force_scale)


@tick_kernel
def tool_acceleration(
    block: LoopBlock, v: FloatArray, hand: FloatArray, touched: float, out: FloatArray
) -> None:
    """Write the acceleration [m/s^2] of the virtual tool: Mt ae = Fh - F_env - Bt ve."""
    for i in range(v.size):
        out[i] = (
            hand[i] - block.inward[i] * touched - block.tool_damping_N_s_per_m * v[i]
        ) / block.tool_mass_kg


@tick_kernel
def advance_tool(block: LoopBlock, law: FloatArray, c: Controller, hand: FloatArray, touched: float) -> float:
    """Move the virtual tool over one period under a held force of the hand; tissue's force at its end [N].

    Symplectic sub-steps: stable while a sub-step times the tool's frequency on the tissue stays below 2.
    The tissue is stepped along, unless the device itself touches it: then its force is held as well.
    """
    steps = block.substeps
    h = block.period_s / steps
    for _ in range(steps):
        tool_acceleration(block, c.ve, hand, touched, c.ae)
        for i in range(c.xe.size):
            c.ve[i] += h * c.ae[i]
            c.xe[i] += h * c.ve[i]
        if not block.touched_by_device:
            touched = environment_force(block, law, c.state, c.xe, h)
    return touched


@tick_kernel
def reference(
    block: LoopBlock,
    device: tuple[FloatArray, FloatArray],
    tool: tuple[FloatArray, FloatArray, FloatArray],
    wanted: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Write vr, ar and rho of equations (16) and (17) by the tool's position, velocity, acceleration."""
    x, v = device
    xe, ve, ae = tool
    vr, ar, rho = wanted
    rate = block.reference_rate_per_s
    for i in range(x.size):
        vr[i] = ve[i] + rate * (xe[i] - x[i])
        ar[i] = ae[i] + rate * (ve[i] - v[i])
        rho[i] = vr[i] - v[i]


@tick_kernel
def sigma_at(block: LoopBlock, time: float) -> float:
    """sigma(t) of equation (22) [N m/s]."""
    return float(max(block.sigma_start * math.exp(-block.sigma_rate_per_s * time), block.sigma_floor))


@tick_kernel
def robust_term(block: LoopBlock, rho: FloatArray, sigma: float, out: FloatArray) -> None:
    """Write u_r [N], equation (21): smooth, along rho, of length delta at most."""
    length = 0.0
    for i in range(rho.size):
        length += rho[i] * rho[i]
    delta = block.disturbance_bound_N
    below = delta * math.sqrt(length) + sigma
    for i in range(rho.size):
        out[i] = delta * delta * rho[i] / below if below > 0.0 else 0.0


@tick_kernel
def control_force(
    block: LoopBlock,
    Y: FloatArray,
    estimates: FloatArray,
    rho: FloatArray,
    robust: FloatArray,
    hand: FloatArray,
    out: FloatArray,
) -> None:
    """Write u [N], equation (20), before saturation; ``hand`` is the measured force of the hand."""
    for i in range(out.size):
        total = block.damping_N_s_per_m * rho[i] + robust[i]
        for k in range(estimates.size):
            total += Y[i, k] * estimates[k]
        if block.variant_B:
            total -= hand[i]
        out[i] = total


@tick_kernel
def saturate(block: LoopBlock, u: FloatArray) -> None:
    """Shorten a force to what the device can give, in its direction."""
    length = 0.0
    for i in range(u.size):
        length += u[i] * u[i]
    length = math.sqrt(length)
    if length > block.saturation_N:
        for i in range(u.size):
            u[i] *= block.saturation_N / length


@tick_kernel
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
    for k in range(estimates.size):
        slope = 0.0
        for i in range(rho.size):
            slope += Y[i, k] * rho[i]
        estimates[k] += h * block.adaptation_sign * gains[k] * slope
        if block.projection:
            estimates[k] = min(max(estimates[k], bounds[0, k]), bounds[1, k])


@tick_kernel
def not_covered(block: LoopBlock, push: FloatArray, disturbed: FloatArray, out: FloatArray) -> None:
    """Write what the estimates don't cover [N]: F* - d in variant A, -d in B."""
    for i in range(out.size):
        out[i] = -disturbed[i] if block.variant_B else push[i] - disturbed[i]


@tick_kernel
def lyapunov(
    block: LoopBlock,
    terms: tuple[FloatArray, FloatArray, FloatArray],
    truth: FloatArray,
    estimates: FloatArray,
    gains: FloatArray,
    M: FloatArray,
) -> tuple[float, float]:
    """V of (I-1) and the right side of (I-4), which V' equals where nothing is sampled, late or saturated.

    ``terms``: rho, robust term, and what is unknown of :func:`not_covered` [N]; ``M`` is room, (n, n).
    """
    rho, robust, unknown = terms
    inertia(truth, M)
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


@tick_kernel
def command(
    block: LoopBlock,
    law: FloatArray,
    c: Controller,
    time: float,
    device: tuple[FloatArray, FloatArray],
    hand: FloatArray,
    touched: float,
) -> float:
    """Step the virtual tool through the coming period; the force [N] held through it is written to ``c.u``.

    Held until the next tick, the command aims at where the tool will be then; returns the tissue's force at
    the end [N].
    """
    x, _v = device
    if block.touched_by_device:
        touched = environment_force(block, law, c.state, x, block.period_s)
    touched = advance_tool(block, law, c, hand, touched)
    tool_acceleration(block, c.ve, hand, touched, c.ae)
    reference(block, device, (c.xe, c.ve, c.ae), (c.vr, c.ar, c.rho))
    robust_term(block, c.rho, sigma_at(block, time), c.robust)
    regress(x, c.vr, c.ar, c.Y)
    control_force(block, c.Y, c.estimates, c.rho, c.robust, hand, c.u)
    saturate(block, c.u)
    return float(touched)
