"""Closed forms and bases of exponentials outside the convolution, for comparison."""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel, branch_states


def ramp_hold_state(time_s: FloatArray, *, speed_mm_s: float, depth_mm: float, tau_s: float) -> FloatArray:
    """State of a branch in a ramp to ``depth_mm`` followed by a hold [mm]."""
    corner = depth_mm / speed_mm_s
    time = np.asarray(time_s)
    rising = -speed_mm_s * tau_s * np.expm1(-np.minimum(time, corner) / tau_s)
    return rising * np.exp(-np.maximum(time - corner, 0.0) / tau_s)


def linear_basis(model: ChannelModel, log_times: FloatArray, path: ContactPath) -> FloatArray:
    """Columns of a viscous model's linear parameters for given log relaxation times, (n, p)."""
    x = path.depth_mm
    columns = list(model.static.basis(x))
    for state in branch_states(path.time_s, x, np.exp(log_times)):
        columns += [state * x**k for k in range(model.stiffness_law.powers)]
    return np.column_stack(columns)
