"""Numbers that say how a loop did."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tissueid.rendering.control.simulation import ControlRun

#: Errors are taken over the last seconds of a run, when the push has risen.
LAST_S = 5.0


@dataclass(frozen=True, slots=True)
class Measures:
    """Measures of a run."""

    diverged_s: float | None  # when it diverged; everything else is then of the time before
    over_s: float  # length of the end of the run that the errors are taken over; half of a short run
    #: Of the device behind the virtual tool, there.  An impedance-type controller leads by velocity alone:
    #: its error of position means nothing.
    error_rms_mm: float
    error_max_mm: float
    velocity_error_rms_mm_s: float
    deepest_mm: float  # deepest place of what touches, in the tissue's own mm, over the whole run
    outside_share: float  # share of ticks deeper than was identified
    environment_force_max_N: float
    control_force_max_N: float
    saturated_share: float  # share of ticks at the largest control force
    lyapunov_start: float
    lyapunov_max: float
    lyapunov_end: float
    violated_share: float  # share of ticks after which V rose faster than (I-6) allows: -Kr rho^2 + sigma
    violation_max_W: float  # by how much at most; 0 where it never did


def measured(run: ControlRun) -> Measures:
    """Measure a run."""
    settings = run.settings
    over = min(LAST_S, 0.5 * settings.seconds)
    late = run.time_s >= run.time_s[-1] - over
    error, speed = run.error_mm[late], run.velocity_error_mm_s[late]
    touching = run.position_m if settings.environment == "impedance" else run.tool_position_m
    depth = 1e3 * touching[:, 0] / settings.motion_scale
    control = np.linalg.norm(run.control_force_N, axis=1)
    excess = _excess(run)
    return Measures(
        diverged_s=run.diverged_s,
        over_s=over,
        error_rms_mm=float(np.sqrt(np.mean(error**2))),
        error_max_mm=float(error.max()),
        velocity_error_rms_mm_s=float(np.sqrt(np.mean(speed**2))),
        deepest_mm=float(depth.max()),
        outside_share=float(np.mean(depth > settings.tissue.model.depth_mm)),
        environment_force_max_N=float(run.environment_force_N.max()),
        control_force_max_N=float(control.max()),
        saturated_share=_share_at(control, settings.gains.saturation_N),
        lyapunov_start=float(run.lyapunov[0]),
        lyapunov_max=float(run.lyapunov.max()),
        lyapunov_end=float(run.lyapunov[-1]),
        violated_share=float(np.mean(excess > 0.0)) if excess.size else 0.0,
        violation_max_W=max(0.0, float(excess.max())) if excess.size else 0.0,
    )


def _share_at(control: np.ndarray, limit: float) -> float:
    # a force that was shortened to the limit is that long but for rounding
    return float(np.mean(control >= limit * (1.0 - 1e-9))) if math.isfinite(limit) else 0.0


def _excess(run: ControlRun) -> np.ndarray:
    """Excess over (I-6) by which V rose after each row [W], shape (rows - 1,)."""
    slope = np.diff(run.lyapunov) / np.diff(run.time_s)
    rho = np.sum(run.rho_m_s**2, axis=1)[:-1]
    allowed = -run.settings.gains.damping_N_s_per_m * rho + run.sigma[:-1]
    return np.asarray(slope - allowed)
