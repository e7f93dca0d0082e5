"""A controlled loop, run: settings in, arrays out."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import kernel
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


@kernel()
def _advance_plant(loop: Loop, time: float, u: FloatArray, x: FloatArray, v: FloatArray) -> FloatArray:
    """Move device and hand over one period under a held control force; the sensor's reading at its end."""
    block = loop.block
    h = block.period_s / block.substeps
    at_rest = np.zeros(x.size)
    for step in range(block.substeps):
        push = law.hand_push(block, loop.drive, time + step * h)
        disturbed = law.disturbance(loop.drive, time + step * h)
        held = law.generalised_force(loop.total, x, v, at_rest)
        a = law.solved(law.inertia(loop.total, x.size), push + u - disturbed - held)
        if step == block.substeps - 1:
            # what the sensor feels: the push, less what moves and holds the hand itself
            hand = push - law.generalised_force(loop.operator, x, v, a)
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
        push, disturbed = law.hand_push(block, loop.drive, time), law.disturbance(loop.drive, time)
        sensed = hand + noise[tick]
        xe, ve, before = c.xe.copy(), c.ve.copy(), touched
        sent = law.command(block, loop.law, c, time, (x, v), sensed, touched)
        touched = sent.touched
        # in variant B the push of the hand is measured, and fed back
        unknown = -disturbed if block.variant_B else push - disturbed
        terms = (sent.rho, sent.robust, unknown)
        V, rate = law.lyapunov(block, terms, loop.truth, c.estimates, loop.gains)
        scalars = np.array([before, law.sigma_at(block, time), V, rate])
        vectors = (x, v, xe, ve, sensed, sent.u, sent.rho, push, disturbed)
        out[tick] = np.concatenate((np.array([time]), *vectors, scalars, c.estimates))
        law.adapt(block, sent.Y, sent.rho, loop.gains, loop.bounds, block.period_s, c.estimates)
        hand = _advance_plant(loop, time, sent.u, x, v)
        if not (np.abs(x) < LARGEST_M).all():
            return tick + 1
    return len(out)


@dataclass(frozen=True, slots=True, eq=False)
class ControlRun:
    """Record of a loop, a row a tick."""

    settings: ControlSettings
    time_s: FloatArray  # (rows,)
    #: (rows, n): of the device; 0 is the surface of the tissue, the first axis into it is positive.
    position_m: FloatArray
    velocity_m_s: FloatArray  # (rows, n)
    #: (rows, n): of the virtual tool.
    tool_position_m: FloatArray
    tool_velocity_m_s: FloatArray  # (rows, n)
    hand_force_N: FloatArray  # (rows, n), as the controller reads it
    #: (rows, n): u, rho (of where the tool will be at the end of the period), F* and d.
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
    """Numbers of a loop whose tick takes ``period_s``."""
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
    out = np.zeros((rows, 1 + settings.axes * len(law.VECTORS) + len(law.SCALARS) + truth.size))

    block = loop_block(settings, period_s=1.0 / settings.rate_Hz, substeps=settings.tool_substeps())
    adaptation = settings.adaptation_gains(), settings.estimate_bounds()
    loop = Loop(
        block, tissue_law(settings), _drive(settings), device + operator, operator, truth, *adaptation
    )
    noise = np.zeros((rows, settings.axes))
    if settings.sensor_noise_N > 0.0:
        noise = np.random.default_rng(settings.seed).normal(0.0, settings.sensor_noise_N, noise.shape)
    written = run_loop(loop, law.new_controller(settings.axes, start), noise, out)
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
