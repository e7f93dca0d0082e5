"""Closed forms and bases of exponentials outside the convolution, for comparison."""

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.model.states import branch_states


def ramp_hold_state(time_s: FloatArray, *, speed_mm_s: float, depth_mm: float, tau_s: float) -> FloatArray:
    """State of a branch in a ramp to ``depth_mm`` followed by a hold [mm]."""
    corner = depth_mm / speed_mm_s
    time = np.asarray(time_s)
    rising = -speed_mm_s * tau_s * np.expm1(-np.minimum(time, corner) / tau_s)
    return rising * np.exp(-np.maximum(time - corner, 0.0) / tau_s)


def branch_state(time_s: FloatArray, driven: FloatArray, tau_s: float) -> FloatArray:
    """The rest of a driven state that decays with ``tau_s``, exact where it is driven evenly."""
    state, kept = np.zeros(time_s.size), np.exp(-np.diff(time_s) / tau_s)
    for i, (share, rate) in enumerate(zip(kept, np.diff(driven) / np.diff(time_s), strict=True)):
        state[i + 1] = share * state[i] + tau_s * (1.0 - share) * rate
    return state


def linear_basis(model: ChannelModel, log_times: FloatArray, path: ContactPath) -> FloatArray:
    """Columns of a viscous model's linear parameters for given log relaxation times, (n, p)."""
    x = path.depth_mm
    columns = list(model.static.basis(x))
    for state in branch_states(path.time_s, x, np.exp(log_times)):
        columns += [state * x**k for k in range(model.stiffness_law.powers)]
    return np.column_stack(columns)


def from_coordinates(p: FloatArray) -> FloatArray:
    """A polynomial of degree <= 2 that is non-negative on [0, 1]: (p0 (1-u) - p2 u)^2 + 2 p1 u (1-u)."""
    if p.size == 1:
        return np.array([p[0] ** 2])
    if p.size == 2:
        return np.array([p[0] ** 2, p[1] ** 2 - p[0] ** 2])
    c0, c1, c2 = p[0] ** 2, p[1] - p[0] * p[2], p[2] ** 2
    return np.array([c0, 2.0 * (c1 - c0), c0 - 2.0 * c1 + c2])
