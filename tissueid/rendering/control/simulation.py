"""Run a controlled loop: settings in, arrays out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.servo_law import servo_law
from tissueid.rendering.control import block as at
from tissueid.rendering.control.block import SCALARS, VECTORS, row_size
from tissueid.rendering.control.continuous import continuous_room, run_continuous
from tissueid.rendering.control.drive import DRIVE_ROWS
from tissueid.rendering.control.mechanics import TASKS, Signal
from tissueid.rendering.control.sampled import run_sampled, sampled_room
from tissueid.rendering.control.settings import ControlSettings
from tissueid.rendering.control.virtual_mass import check_virtual_mass


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
    estimates: FloatArray  # (rows, p), masses, dampings, stiffnesses; those of an arm in front
    diverged_s: float | None  # when the device was 10 m away, or lost; None where the loop stayed bounded

    @property
    def error_mm(self) -> FloatArray:
        """Length of x_e - x [mm], shape (rows,)."""
        return np.asarray(1e3 * np.linalg.norm(self.tool_position_m - self.position_m, axis=1))

    @property
    def velocity_error_mm_s(self) -> FloatArray:
        """Length of the difference of the velocities [mm/s], shape (rows,)."""
        return np.asarray(1e3 * np.linalg.norm(self.tool_velocity_m_s - self.velocity_m_s, axis=1))


def loop_block(settings: ControlSettings, *, period_s: float, substeps: int) -> FloatArray:
    """The flat block of :mod:`tissueid.rendering.control.block`.

    ``period_s``: of a tick, or the step of a continuous loop [s].  Returns (BLOCK_SIZE,).
    """
    gains = settings.gains
    touched_by_device = settings.environment == "impedance"
    block = np.zeros(at.BLOCK_SIZE)
    block[[at.TOOL_MASS, at.TOOL_DAMPING]] = settings.tool.mass_kg, settings.tool.damping_N_s_per_m
    # a tool that touches nothing leads nowhere: without a place of its own, only its velocity is followed
    block[at.REFERENCE_RATE] = 0.0 if touched_by_device else gains.reference_rate_per_s
    block[at.DAMPING] = gains.damping_N_s_per_m
    block[at.DISTURBANCE_BOUND] = settings.disturbance_bound_N()
    block[[at.SIGMA_START, at.SIGMA_RATE]] = gains.sigma_start, gains.sigma_rate_per_s
    block[at.SIGMA_FLOOR] = settings.sigma_floor()
    block[at.ADAPTATION_SIGN] = gains.adaptation_sign
    block[at.PROJECTION] = gains.projection
    block[at.SATURATION] = gains.saturation_N
    block[at.VARIANT] = at.VARIANT_B if settings.variant == "B" else 0.0
    block[at.TOUCHED_BY_DEVICE] = touched_by_device
    block[[at.FORCE_SCALE, at.MOTION_SCALE]] = settings.force_scale, settings.motion_scale
    block[at.INWARD] = 1.0
    block[[at.PERIOD, at.SUBSTEPS, at.RISE]] = period_s, substeps, settings.push_rise_s
    if settings.arm is not None:
        block[[at.LINK_1, at.LINK_2]] = settings.arm.links_m
        block[[at.BASE_X, at.BASE_Y]] = settings.arm.base_m
    return block


def tissue_law(settings: ControlSettings) -> FloatArray:
    """The tissue's law, made stiffer by the scale, shape (LAW_SIZE,)."""
    law = servo_law(settings.tissue.model, settings.tissue.theta)
    return law.stiffer(settings.stiffness_scale).packed()


def _drive(settings: ControlSettings) -> FloatArray:
    """Push and disturbance, shape (DRIVE_ROWS, n)."""
    push = settings.push or Signal.along(*TASKS["sustained"], axes=settings.axes)
    rows = [push.offset_N, push.amplitude_N, push.frequency_Hz]
    drive = np.zeros((DRIVE_ROWS, settings.axes))
    drive[:3] = rows
    if settings.disturbance is not None:
        other = settings.disturbance
        drive[3:] = other.offset_N, other.amplitude_N, other.frequency_Hz
    return drive


def simulate(settings: ControlSettings) -> ControlRun:
    """Run a loop from rest at the surface of the tissue.

    Raises UsageError: the virtual mass is below its bound, or the gains can't be sampled at this rate.
    """
    check_virtual_mass(settings)
    n = settings.axes
    device, operator = settings.true_parameters()
    truth = settings.estimated_truth()
    start = 0.5 * truth if settings.start_estimates is None else settings.start_estimates
    parameters = (device + operator, operator, truth)
    start = np.array(start, dtype=np.float64)
    adaptation = (settings.adaptation_gains(), settings.estimate_bounds())
    law, drive = tissue_law(settings), _drive(settings)
    rows = max(1, round(settings.seconds * settings.rate_Hz))
    out = np.zeros((rows, row_size(settings.axes, truth.size)))
    if settings.continuous_step_s is None:
        block = loop_block(settings, period_s=1.0 / settings.rate_Hz, substeps=settings.tool_substeps())
        noise = np.zeros((rows, settings.axes))
        if settings.sensor_noise_N > 0.0:
            noise = np.random.default_rng(settings.seed).normal(0.0, settings.sensor_noise_N, noise.shape)
        written = run_sampled(block, law, parameters, adaptation, drive, noise, sampled_room(n, start), out)
    else:
        every = max(1, math.ceil(1.0 / (settings.rate_Hz * settings.continuous_step_s) - 1e-9))
        block = loop_block(settings, period_s=1.0 / (settings.rate_Hz * every), substeps=1)
        written = run_continuous(
            block, law, parameters, adaptation, drive, every, continuous_room(n, start), out
        )
    return _as_run(settings, out[:written], complete=written == rows)


def _as_run(settings: ControlSettings, rows: FloatArray, *, complete: bool) -> ControlRun:
    """Name the columns; what a diverging loop wrote last may be no number."""
    rows = rows[np.isfinite(rows).all(axis=1)]
    n = settings.axes
    vectors = {name: rows[:, 1 + k * n : 1 + (k + 1) * n] for k, name in enumerate(VECTORS)}
    first = 1 + n * len(VECTORS)
    scalars = {name: rows[:, first + k] for k, name in enumerate(SCALARS)}
    return ControlRun(
        settings=settings,
        time_s=rows[:, 0],
        **vectors,
        **scalars,
        estimates=rows[:, first + len(SCALARS) :],
        diverged_s=None if complete else float(rows[-1, 0]),
    )
