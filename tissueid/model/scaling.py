"""Scaling of a tissue's forces into the reach of a hand-held device (model.md 6.5, derived).

``F_device = s_F F(x_device / s_x)``; time is not scaled.  One linear factor for force keeps every
ratio of stiffness; a factor that depends on force would not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.channels import TissueModel, loading_force

#: Share of the clamp that the deepest static force may use.
CLAMP_SHARE = 0.9
DEFAULT_MOTION_SCALE = 5.0
#: Depths at which a curve is examined.
GRID = 257
N_PER_MM_TO_N_PER_M = 1000.0


@dataclass(frozen=True, slots=True)
class Scaling:
    """Force and motion scale of a rendering."""

    force: float  # s_F, device force over tissue force
    motion: float  # s_x, device travel over tissue depth
    device_stiffness_N_per_m: float  # largest tangent stiffness felt at the device
    peak_force_N: float  # force at the device at full depth, at the fastest identified speed


def largest_tangent(model: TissueModel, theta: FloatArray) -> float:
    """Largest instantaneous stiffness F_s' + sum K_j on [0, depth] [N/mm]."""
    x = np.linspace(0.0, model.depth_mm, GRID)
    return float((model.static_slope(theta, x) + model.stiffness(theta, x).sum(axis=0)).max())


def scaling_for(
    model: TissueModel,
    theta: FloatArray,
    *,
    clamp_N: float,
    fastest_mm_s: float,
    motion: float = DEFAULT_MOTION_SCALE,
) -> Scaling:
    """The default scale: the force at full depth takes nine tenths of the device's clamp.

    ``model``, ``theta``: the tissue; ``clamp_N``: the guard's force clamp in force at that moment [N];
    ``fastest_mm_s``: fastest identified speed [mm/s of tissue depth]; ``motion``: motion scale s_x.  Raises
    ValueError: the tissue gives no force at full depth, so that no scale can be computed.
    """
    peak = float(loading_force(model, theta, np.array([model.depth_mm]), speed_mm_s=fastest_mm_s)[0])
    if not peak > 0.0:
        msg = f"the tissue's force at {model.depth_mm:g} mm is {peak:g} N: no force scale can be computed"
        raise ValueError(msg)
    force = CLAMP_SHARE * clamp_N / peak
    tangent = largest_tangent(model, theta) * N_PER_MM_TO_N_PER_M
    return Scaling(
        force=force,
        motion=motion,
        device_stiffness_N_per_m=tangent * force / motion,
        peak_force_N=force * peak,
    )
