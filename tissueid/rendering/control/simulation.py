"""A controlled loop: control law, adaptation, plant and virtual tool (compiled), and its run; SI units.

Of the equations (14) to (22) of Sadeghnejad et al. the text kept the numbers alone: what stands here
satisfies each of their sentences (docs/control.md).  The tissue's law stays in mm and N, a block of its own.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import kernel
from tissueid.model.kernels import STATE_SIZE, tissue_step_in
from tissueid.model.servo_law import servo_law
from tissueid.rendering.control.settings import TASKS, ControlSettings, Signal, check_virtual_mass


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
    return math.sqrt((vector * vector).sum())


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


#: A device that is farther away than this has diverged [m].
LARGEST_M = 10.0
#: Columns of a row, in the order of :class:`ControlRun`: after the time so many of n numbers, then of one.
VECTORS, SCALARS = 8, 4


class Loop(NamedTuple):
    """A loop that is run, for compiled code."""

    block: LoopBlock
    law: FloatArray  # of the tissue, (LAW_SIZE,)
    drive: FloatArray  # push and disturbance, (DRIVE_ROWS, n)
    total: FloatArray  # parameters of device and hand together
    operator: FloatArray  # parameters of the hand, in the same places
    truth: FloatArray  # of the estimates, (p,)
    gains: FloatArray  # of the adaptation, (p,)
    bounds: FloatArray  # of the estimates, (2, p)


@kernel()
def _advance_plant(loop: Loop, time: float, u: FloatArray, x: FloatArray, v: FloatArray) -> FloatArray:
    """Move device and hand over one period under a held control force; the sensor's reading at its end."""
    block = loop.block
    h = block.period_s / block.substeps
    at_rest = np.zeros(x.size)
    for step in range(block.substeps):
        push = hand_push(block, loop.drive, time + step * h)
        disturbed = disturbance(loop.drive, time + step * h)
        held = generalised_force(loop.total, x, v, at_rest)
        a = solved(inertia(loop.total, x.size), push + u - disturbed - held)
        if step == block.substeps - 1:
            # what the sensor feels: the push, less what moves and holds the hand itself
            hand = push - generalised_force(loop.operator, x, v, a)
        v += h * a
        x += h * v
    return hand


@kernel()
def run_loop(loop: Loop, c: Controller, noise: FloatArray, out: FloatArray) -> int:
    """Run a loop from rest at the tissue's surface; rows written, fewer than ticks where it diverged.

    The controller reads the force that the hand had under the last command; ``noise``: of the sensor [N].
    """
    block = loop.block
    x, v, hand = np.zeros_like(c.xe), np.zeros_like(c.xe), np.zeros_like(c.xe)
    touched = 0.0
    for tick in range(len(out)):
        time = tick * block.period_s
        push, disturbed = hand_push(block, loop.drive, time), disturbance(loop.drive, time)
        sensed = hand + noise[tick]
        xe, ve, before = c.xe.copy(), c.ve.copy(), touched
        sent = command(block, loop.law, c, time, (x, v), sensed, touched)
        touched = sent.touched
        # in variant B the push of the hand is measured, and fed back
        unknown = -disturbed if block.variant_B else push - disturbed
        terms = (sent.rho, sent.robust, unknown)
        V, rate = lyapunov(block, terms, loop.truth, c.estimates, loop.gains)
        scalars = np.array([before, sigma_at(block, time), V, rate])
        vectors = (x, v, xe, ve, sensed, sent.u, sent.rho, push)
        out[tick] = np.concatenate((np.array([time]), *vectors, scalars, c.estimates))
        adapt(block, sent.Y, sent.rho, loop.gains, loop.bounds, block.period_s, c.estimates)
        hand = _advance_plant(loop, time, sent.u, x, v)
        if not (np.abs(x) < LARGEST_M).all():
            return tick + 1
    return len(out)


@dataclass(frozen=True, slots=True, eq=False)
class ControlRun:
    """Record of a loop, a row a tick."""

    settings: ControlSettings
    diverged_s: float | None  # when the device was 10 m away, or lost; None where the loop stayed bounded
    time_s: FloatArray  # (rows,)
    #: (rows, n): of the device; 0 is the surface of the tissue, the first axis into it is positive.
    position_m: FloatArray
    velocity_m_s: FloatArray  # (rows, n)
    #: (rows, n): of the virtual tool.
    tool_position_m: FloatArray
    tool_velocity_m_s: FloatArray  # (rows, n)
    hand_force_N: FloatArray  # (rows, n), as the controller reads it
    #: (rows, n): u, rho (of where the tool will be at the end of the period) and F*.
    control_force_N: FloatArray
    rho_m_s: FloatArray  # (rows, n)
    push_N: FloatArray  # (rows, n)
    #: (rows,): force of the tissue, sigma(t), V of (I-1) and the right side of (I-4).
    environment_force_N: FloatArray
    sigma: FloatArray  # (rows,)
    lyapunov: FloatArray  # (rows,)
    lyapunov_rate: FloatArray  # (rows,)
    estimates: FloatArray  # (rows, p), masses, dampings, stiffnesses

    @property
    def error_mm(self) -> FloatArray:
        """Length of x_e - x [mm], shape (rows,)."""
        return np.asarray(1e3 * np.linalg.norm(self.tool_position_m - self.position_m, axis=1))


def loop_block(settings: ControlSettings) -> LoopBlock:
    """Numbers of a loop."""
    gains = settings.gains
    touched_by_device = settings.environment == "impedance"
    return LoopBlock(
        tool_mass_kg=settings.tool.mass_kg,
        tool_damping_N_s_per_m=settings.tool.damping_N_s_per_m,
        # a tool that touches nothing leads nowhere: without a place of its own, only its velocity is followed
        reference_rate_per_s=0.0 if touched_by_device else gains.reference_rate_per_s,
        damping_N_s_per_m=gains.damping_N_s_per_m,
        disturbance_bound_N=settings.disturbance_bound_N(),
        sigma_start=gains.sigma_start,
        sigma_rate_per_s=gains.sigma_rate_per_s,
        sigma_floor=settings.sigma_floor(),
        adaptation_sign=float(gains.adaptation_sign),
        projection=gains.projection,
        saturation_N=gains.saturation_N,
        variant_B=settings.variant == "B",
        touched_by_device=touched_by_device,
        force_scale=settings.force_scale,
        motion_scale=settings.motion_scale,
        period_s=1.0 / settings.rate_Hz,
        substeps=settings.tool_substeps(),
        rise_s=settings.push_rise_s,
    )


def tissue_law(settings: ControlSettings) -> FloatArray:
    """The tissue's law, made stiffer by the scale, shape (LAW_SIZE,)."""
    found = servo_law(settings.tissue.model, settings.tissue.theta)
    return found.stiffer(settings.stiffness_scale).packed()


def simulate(settings: ControlSettings) -> ControlRun:
    """Run a loop from rest at the surface of the tissue; UsageError where its numbers can't be run."""
    check_virtual_mass(settings)
    device, operator = settings.device.parameters(), settings.operator.parameters()
    truth = settings.estimated_truth()
    start = 0.5 * truth if settings.start_estimates is None else settings.start_estimates
    start = np.array(start, dtype=np.float64)
    ticks, axes = max(1, round(settings.seconds * settings.rate_Hz)), settings.axes
    first = 1 + VECTORS * axes
    out = np.zeros((ticks, first + SCALARS + truth.size))
    drive = np.zeros((DRIVE_ROWS, axes))
    drive[:3] = astuple(settings.push or Signal.along(*TASKS["sustained"], axes=axes))
    if settings.disturbance is not None:
        drive[3:] = astuple(settings.disturbance)
    block = loop_block(settings)
    adaptation = settings.adaptation_gains(), settings.estimate_bounds()
    loop = Loop(block, tissue_law(settings), drive, device + operator, operator, truth, *adaptation)
    noise = np.zeros((ticks, axes))
    if settings.sensor_noise_N > 0.0:
        noise = np.random.default_rng(settings.seed).normal(0.0, settings.sensor_noise_N, noise.shape)
    written = run_loop(loop, new_controller(axes, start), noise, out)
    # a diverging loop may have written no number last
    rows = out[:written][np.isfinite(out[:written]).all(axis=1)]
    vectors = np.split(rows[:, 1:first], VECTORS, axis=1)
    scalars, estimates = rows[:, first : first + SCALARS].T, rows[:, first + SCALARS :]
    columns = (rows[:, 0], *vectors, *scalars, estimates)
    return ControlRun(settings, None if written == ticks else float(rows[-1, 0]), *columns)
