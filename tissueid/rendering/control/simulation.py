"""A controlled loop, run: settings in, arrays out; sampled as a computer does it, or continuous."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel
from tissueid.model.kernels import STATE_SIZE
from tissueid.model.servo_law import servo_law
from tissueid.rendering.control import law
from tissueid.rendering.control.law import Controller, LoopBlock
from tissueid.rendering.control.settings import TASKS, ControlSettings, Signal, check_virtual_mass

#: A device that is farther away than this has diverged [m].
LARGEST_M = 10.0


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


#: Room of a sampled run: vectors, regressor, inertia.
SampledRoom = tuple[FloatArray, FloatArray, FloatArray]
VECTOR_ROWS = 12


def sampled_room(axes: int, parameters: int) -> SampledRoom:
    """Room of a run."""
    return np.zeros((VECTOR_ROWS, axes)), np.zeros((axes, parameters)), np.zeros((axes, axes))


@tick_kernel
def _advance_plant(
    loop: Loop,
    time: float,
    u: FloatArray,
    plant: tuple[FloatArray, FloatArray, FloatArray],
    vectors: tuple[FloatArray, FloatArray, FloatArray],
    room: SampledRoom,
) -> None:
    """Move device and hand over one period under a held control force; leave the sensor's reading."""
    block = loop.block
    x, v, hand = plant
    a, push, disturbed = vectors
    _rows, Y, M = room
    steps = block.substeps
    h = block.period_s / steps
    for step in range(steps):
        law.hand_push(block, loop.drive, time + step * h, push)
        law.disturbance(loop.drive, time + step * h, disturbed)
        for i in range(x.size):
            a[i] = 0.0
        law.generalised_force(loop.total, x, v, a, Y, hand)
        for i in range(x.size):
            a[i] = push[i] + u[i] - disturbed[i] - hand[i]
        law.inertia(loop.total, M)
        law.solve(M, a)
        if step == steps - 1:
            # what the sensor feels: the push, less what moves and holds the hand itself
            law.generalised_force(loop.operator, x, v, a, Y, hand)
            for i in range(x.size):
                hand[i] = push[i] - hand[i]
        for i in range(x.size):
            v[i] += h * a[i]
            x[i] += h * v[i]


@tick_kernel
def run_sampled(loop: Loop, c: Controller, noise: FloatArray, room: SampledRoom, out: FloatArray) -> int:
    """Run a sampled loop from rest at the tissue's surface; rows written, fewer than ticks where it diverged.

    The loop reads the force that the hand had under the last command; ``noise``: of the sensor [N].
    """
    block = loop.block
    rows, _Y, M = room
    x, v, hand, sensed, push, disturbed = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    unknown, was = rows[6], (rows[7], rows[8])
    touched = 0.0
    for tick in range(out.shape[0]):
        time = tick * block.period_s
        law.hand_push(block, loop.drive, time, push)
        law.disturbance(loop.drive, time, disturbed)
        for i in range(x.size):
            sensed[i] = hand[i] + noise[tick, i]
            was[0][i], was[1][i] = c.xe[i], c.ve[i]
        before = touched
        touched = law.command(block, loop.law, c, time, (x, v), sensed, touched)
        law.not_covered(block, push, disturbed, unknown)
        terms = (c.rho, c.robust, unknown)
        V, rate = law.lyapunov(block, terms, loop.truth, c.estimates, loop.gains, M)
        vectors = (x, v, was[0], was[1], sensed, c.u, c.rho, push, disturbed)
        law.record_row(out[tick], time, vectors, (before, law.sigma_at(block, time), V, rate), c.estimates)
        law.adapt(block, c.Y, c.rho, loop.gains, loop.bounds, block.period_s, c.estimates)
        _advance_plant(loop, time, c.u, (x, v, hand), (rows[9], rows[10], rows[11]), room)
        for i in range(x.size):
            if not abs(x[i]) < LARGEST_M:
                return tick + 1
    return int(out.shape[0])


#: Regressor and three inertias to solve in; estimates and tissue, each with its trials.
Solving = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
Lists = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
#: Room of a continuous run: motions, forces, and both of these.
ContinuousRoom = tuple[FloatArray, FloatArray, Solving, Lists]
#: Rows of the state of motion: position and velocity of the device, of the tool.
MOTION_ROWS = 4
#: Rows of forces, see :func:`_forces`; one for what the estimates don't cover.
FORCE_ROWS = 11


def continuous_room(axes: int, start: FloatArray) -> ContinuousRoom:
    """Room of a run."""
    squares = np.zeros((3, axes, axes))
    return (
        np.zeros((4, MOTION_ROWS, axes)),
        np.zeros((FORCE_ROWS, axes)),
        (np.zeros((axes, start.size)), squares[0], squares[1], squares[2]),
        (start.copy(), start.copy(), start.copy(), np.zeros(STATE_SIZE), np.zeros(STATE_SIZE)),
    )


@tick_kernel
def _forces(
    loop: Loop,
    time: float,
    motion: FloatArray,
    estimates: FloatArray,
    touched: float,
    forces: FloatArray,
    room: Solving,
) -> None:
    """Solve the algebraic loop at one moment; ``forces`` is written.

    The hand's force holds its own acceleration: Fh = f0 - Mh a, ar = ar0 - Mh a / Mt, u = u0 - (M^ Mh / Mt) a
    [+ Mh a in variant B], with M^ of the estimates, so that (M + M^ Mh / Mt [- Mh]) a = F* - d + u0 - c.
    """
    block = loop.block
    Y, M, Mh, Mc = room
    x, v, ve = motion[0], motion[1], motion[3]
    push, disturbed, hand, u, rho, robust = forces[0], forces[1], forces[2], forces[3], forces[4], forces[5]
    a, ae, vr, ar = forces[6], forces[7], forces[8], forces[9]
    n = x.size
    law.hand_push(block, loop.drive, time, push)
    law.disturbance(loop.drive, time, disturbed)
    law.inertia(loop.operator, Mh)
    law.inertia(estimates, Mc)
    law.inertia(loop.total, M)
    for i in range(n):
        a[i] = 0.0
    law.generalised_force(loop.operator, x, v, a, Y, hand)
    for i in range(n):
        hand[i] = push[i] - hand[i]
    law.tool_acceleration(block, ve, hand, touched, ae)
    law.reference(block, (x, v), (motion[2], ve, ae), (vr, ar, rho))
    law.robust_term(block, rho, law.sigma_at(block, time), robust)
    law.regress(x, vr, ar, Y)
    law.control_force(block, Y, estimates, rho, robust, hand, u)
    # the plant's own forces take the room of vr, which is not needed any more
    law.generalised_force(loop.total, x, v, a, Y, vr)
    for i in range(n):
        ar[i] = push[i] - disturbed[i] + u[i] - vr[i]
        for j in range(n):
            for k in range(n):
                M[i, j] += Mc[i, k] * Mh[k, j] / block.tool_mass_kg
            if block.variant_B:
                M[i, j] -= Mh[i, j]
    law.solve(M, ar)
    for i in range(n):
        a[i] = ar[i]
    for i in range(n):
        for j in range(n):
            hand[i] -= Mh[i, j] * a[j]
    law.tool_acceleration(block, ve, hand, touched, ae)
    law.reference(block, (x, v), (motion[2], ve, ae), (vr, ar, rho))
    law.regress(x, vr, ar, Y)
    law.control_force(block, Y, estimates, rho, robust, hand, u)


@tick_kernel
def _tissue(loop: Loop, state: FloatArray, motion: FloatArray) -> float:
    """Force of the environment [N] on whatever touches it, a step later."""
    block = loop.block
    return law.environment_force(
        block, loop.law, state, motion[0 if block.touched_by_device else 2], block.period_s
    )


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


@tick_kernel
def _step(loop: Loop, time: float, room: ContinuousRoom) -> float:
    """One step of Heun from a moment whose forces are known; the force of the environment at its end."""
    block = loop.block
    motions, forces, solving, lists = room
    h = block.period_s
    motion, ahead, slope, slope_ahead = motions[0], motions[1], motions[2], motions[3]
    estimates, guess, moved, state, trial = lists
    Y = solving[0]
    law.regress(motion[0], forces[8], forces[9], Y)
    _slopes(motion, forces, slope)
    _copy(estimates, guess)
    law.adapt(block, Y, forces[4], loop.gains, loop.bounds, h, guess)
    for k in range(MOTION_ROWS):
        for i in range(motion.shape[1]):
            ahead[k, i] = motion[k, i] + h * slope[k, i]
    _copy(state, trial)
    pressed = _tissue(loop, trial, ahead)
    _forces(loop, time + h, ahead, guess, pressed, forces, solving)
    _slopes(ahead, forces, slope_ahead)
    _copy(guess, moved)
    law.adapt(block, Y, forces[4], loop.gains, loop.bounds, h, moved)
    for k in range(estimates.size):
        estimates[k] = 0.5 * (estimates[k] + moved[k])
    for k in range(MOTION_ROWS):
        for i in range(motion.shape[1]):
            motion[k, i] += 0.5 * h * (slope[k, i] + slope_ahead[k, i])
    return float(_tissue(loop, state, motion))


@tick_kernel
def run_continuous(loop: Loop, every: int, room: ContinuousRoom, out: FloatArray) -> int:
    """Run a loop without sampling from rest at the surface; a row every ``every`` steps of the period."""
    block = loop.block
    motions, forces, solving, lists = room
    motion, unknown, estimates = motions[0], forces[10], lists[0]
    touched = 0.0
    for row in range(out.shape[0]):
        for step in range(every):
            time = (row * every + step) * block.period_s
            _forces(loop, time, motion, estimates, touched, forces, solving)
            if step == 0:
                law.not_covered(block, forces[0], forces[1], unknown)
                terms = (forces[4], forces[5], unknown)
                V, rate = law.lyapunov(block, terms, loop.truth, estimates, loop.gains, solving[1])
                led = (motion[0], motion[1], motion[2], motion[3])
                vectors = (*led, forces[2], forces[3], forces[4], forces[0], forces[1])
                law.record_row(
                    out[row], time, vectors, (touched, law.sigma_at(block, time), V, rate), estimates
                )
            touched = _step(loop, time, room)
        for i in range(motion.shape[1]):
            if not abs(motion[0, i]) < LARGEST_M:
                return row + 1
    return int(out.shape[0])


@dataclass(frozen=True, slots=True, eq=False)
class ControlRun:
    """Record of a loop, a row a tick; a continuous loop keeps rows at the controller's rate as well."""

    settings: ControlSettings
    time_s: FloatArray  # (rows,)
    #: (rows, n): of the device; 0 is the surface of the tissue, the first axis into it is positive.
    position_m: FloatArray
    velocity_m_s: FloatArray  # (rows, n)
    #: (rows, n): of the virtual tool.
    tool_position_m: FloatArray
    tool_velocity_m_s: FloatArray  # (rows, n)
    hand_force_N: FloatArray  # (rows, n), as the controller reads it
    #: (rows, n): u, rho, F* and d; in a sampled loop rho is of where the tool will be at the end of the
    #: period.
    control_force_N: FloatArray
    rho_m_s: FloatArray  # (rows, n)
    push_N: FloatArray  # (rows, n)
    disturbance_N: FloatArray  # (rows, n)
    #: (rows,): force of the tissue, sigma(t), V of (I-1) and the right side of (I-4).
    environment_force_N: FloatArray
    sigma: FloatArray  # (rows,)
    lyapunov: FloatArray  # (rows,)
    lyapunov_rate: FloatArray  # (rows,)
    estimates: FloatArray  # (rows, p), masses, dampings, stiffnesses
    diverged_s: float | None  # when the device was 10 m away, or lost; None where the loop stayed bounded

    @property
    def error_mm(self) -> FloatArray:
        """Length of x_e - x [mm], shape (rows,)."""
        return np.asarray(1e3 * np.linalg.norm(self.tool_position_m - self.position_m, axis=1))

    @property
    def velocity_error_mm_s(self) -> FloatArray:
        """Length of the difference of the velocities [mm/s], shape (rows,)."""
        return np.asarray(1e3 * np.linalg.norm(self.tool_velocity_m_s - self.velocity_m_s, axis=1))


def loop_block(settings: ControlSettings, *, period_s: float, substeps: int) -> LoopBlock:
    """Numbers of a loop whose tick, or step where it is continuous, takes ``period_s``."""
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
        inward=np.array([1.0, 0.0, 0.0]),
        period_s=period_s,
        substeps=substeps,
        rise_s=settings.push_rise_s,
    )


def tissue_law(settings: ControlSettings) -> FloatArray:
    """The tissue's law, made stiffer by the scale, shape (LAW_SIZE,)."""
    found = servo_law(settings.tissue.model, settings.tissue.theta)
    return found.stiffer(settings.stiffness_scale).packed()


def _drive(settings: ControlSettings) -> FloatArray:
    """Push and disturbance, shape (DRIVE_ROWS, n)."""
    drive = np.zeros((law.DRIVE_ROWS, settings.axes))
    drive[:3] = astuple(settings.push or Signal.along(*TASKS["sustained"], axes=settings.axes))
    if settings.disturbance is not None:
        drive[3:] = astuple(settings.disturbance)
    return drive


def simulate(settings: ControlSettings) -> ControlRun:
    """Run a loop from rest at the surface of the tissue; UsageError where its numbers can't be run."""
    check_virtual_mass(settings)
    device, operator = settings.device.parameters(), settings.operator.parameters()
    truth = settings.estimated_truth()
    start = 0.5 * truth if settings.start_estimates is None else settings.start_estimates
    start = np.array(start, dtype=np.float64)
    rows = max(1, round(settings.seconds * settings.rate_Hz))
    out = np.zeros((rows, law.row_size(settings.axes, truth.size)))

    def loop(block: LoopBlock) -> Loop:
        adaptation = settings.adaptation_gains(), settings.estimate_bounds()
        parameters = (device + operator, operator, truth)
        return Loop(block, tissue_law(settings), _drive(settings), *parameters, *adaptation)

    if settings.continuous_step_s is None:
        block = loop_block(settings, period_s=1.0 / settings.rate_Hz, substeps=settings.tool_substeps())
        noise = np.zeros((rows, settings.axes))
        if settings.sensor_noise_N > 0.0:
            noise = np.random.default_rng(settings.seed).normal(0.0, settings.sensor_noise_N, noise.shape)
        controller, room = law.new_controller(settings.axes, start), sampled_room(settings.axes, start.size)
        written = run_sampled(loop(block), controller, noise, room, out)
    else:
        every = max(1, math.ceil(1.0 / (settings.rate_Hz * settings.continuous_step_s) - 1e-9))
        block = loop_block(settings, period_s=1.0 / (settings.rate_Hz * every), substeps=1)
        written = run_continuous(loop(block), every, continuous_room(settings.axes, start), out)
    return _as_run(settings, out[:written], complete=written == rows)


def _as_run(settings: ControlSettings, rows: FloatArray, *, complete: bool) -> ControlRun:
    """Name the columns; what a diverging loop wrote last may be no number."""
    rows = rows[np.isfinite(rows).all(axis=1)]
    n = settings.axes
    vectors = {name: rows[:, 1 + k * n : 1 + (k + 1) * n] for k, name in enumerate(law.VECTORS)}
    first = 1 + n * len(law.VECTORS)
    scalars = {name: rows[:, first + k] for k, name in enumerate(law.SCALARS)}
    return ControlRun(
        settings=settings,
        time_s=rows[:, 0],
        **vectors,
        **scalars,
        estimates=rows[:, first + len(law.SCALARS) :],
        diverged_s=None if complete else float(rows[-1, 0]),
    )
