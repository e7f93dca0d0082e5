"""Scaling of forces into the reach of a device, and the damping it needs to render them.

``F_device = s_F F(x_device / s_x)`` (derived).  Sampled-data passivity after Colgate & Schenkel (doi
10.1002/rob.4620140110), force m whole ticks late:

    b > sup_w B(w),   B = (T / 2) Re{ (1 - exp(-i w T)) exp(-i w m T) H } / (1 - cos w T)
    H(z) = k0 + sum_j K_j phi_j (z - 1) / (z - a_j),  z = exp(i w T)

With a fraction f of a tick on top the delay is the mean ``(1 - f) z^-m + f z^-(m+1)``, and the worst motion,
uneven inside a period, needs ``b = (B + sqrt(B^2 + f (1 - f) T^2 |H|^2)) / 2`` (derived).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.channels import ChannelModel, loading_force
from tissueid.model.servo_law import servo_law

#: Share of the clamp that the deepest static force may use.
CLAMP_SHARE = 0.9
DEFAULT_MOTION_SCALE = 5.0
#: Depths at which a curve is examined.
GRID = 257


@dataclass(frozen=True, slots=True)
class Scaling:
    """Force and motion scale of a rendering."""

    force: float  # s_F, device force over tissue force
    motion: float  # s_x, device travel over tissue depth
    device_stiffness_N_per_m: float  # largest tangent stiffness felt at the device
    peak_force_N: float  # force at the device at full depth, at the fastest identified speed


def largest_tangent(model: ChannelModel, theta: FloatArray) -> float:
    """Largest instantaneous stiffness F_s' + sum K_j on [0, depth] [N/mm]."""
    x = np.linspace(0.0, model.depth_mm, GRID)
    return float((model.static_slope(theta, x) + model.stiffness(theta, x).sum(axis=0)).max())


def scaling_for(
    model: ChannelModel,
    theta: FloatArray,
    *,
    clamp_N: float,
    fastest_mm_s: float,
    motion: float = DEFAULT_MOTION_SCALE,
) -> Scaling:
    """The default scale: force at full depth, at the fastest speed, takes nine tenths of the clamp.

    Raises ValueError: the tissue gives no force at full depth, so that no scale can be computed.
    """
    peak = float(loading_force(model, theta, np.array([model.depth_mm]), speed_mm_s=fastest_mm_s)[0])
    if not peak > 0.0:
        msg = f"the tissue's force at {model.depth_mm:g} mm is {peak:g} N: no force scale can be computed"
        raise ValueError(msg)
    force = CLAMP_SHARE * clamp_N / peak
    tangent = largest_tangent(model, theta) * N_PER_MM_TO_N_PER_M
    return Scaling(force, motion, tangent * force / motion, force * peak)


#: Ticks between a position sample and its force at the motor, where the device was not measured.
DEFAULT_DELAY_TICKS = 1.5
#: Frequencies in the search for the supremum: dense near 0 and near the Nyquist frequency.
FREQUENCIES = 4000
#: Depths at which the linearised law is examined.
DEPTHS = 33
N_PER_MM_TO_N_PER_M = 1000.0


def damping_bound(
    static_slope: float | FloatArray,
    stiffness: FloatArray,
    tau: FloatArray,
    *,
    period_s: float,
    delay_ticks: float,
) -> float:
    """Damping that makes one linearised law passive, or several; in the unit of ``static_slope`` times s.

    ``static_slope`` (n,): slope at fixed branch states; ``stiffness`` (branches,) and (branches, n).
    """
    angle = np.concatenate([np.geomspace(1e-6, np.pi, FREQUENCIES), np.linspace(1e-3, np.pi, FREQUENCIES)])
    # z - 1 by expm1, and below (1 - 1/z) / (1 - cos) as i exp(-i angle/2) / sin(angle/2): the plain
    # differences lose their digits near zero
    z_less_1 = np.expm1(1j * angle)
    parts = np.ones((1 + tau.size, angle.size), dtype=np.complex128)
    for row, relaxation in zip(parts[1:], tau, strict=True):
        loss = -np.expm1(-period_s / relaxation)
        row[:] = (loss * relaxation / period_s) * z_less_1 / (z_less_1 + loss)
    whole = np.floor(delay_ticks)
    part = delay_ticks - whole
    delay = np.exp(-1j * angle * whole) * ((1.0 - part) + part * np.exp(-1j * angle))
    factor = period_s / 2.0 * 1j * np.exp(-0.5j * angle) * delay / np.sin(angle / 2.0)
    # B and H are linear in the coefficients of a law: one product for all laws
    slopes = np.reshape(static_slope, (1, -1))
    laws = np.concatenate([slopes, np.reshape(stiffness, (tau.size, slopes.size))]).T
    need = laws @ (factor * parts).real
    if part:
        squared = (laws @ parts.real) ** 2 + (laws @ parts.imag) ** 2
        need = (need + np.sqrt(need**2 + part * (1.0 - part) * period_s**2 * squared)) / 2.0
    return max(float(need.max()), 0.0)


def required_damping(
    model: ChannelModel,
    theta: FloatArray,
    scaling: Scaling,
    *,
    period_s: float,
    delay_ticks: float = DEFAULT_DELAY_TICKS,
) -> float:
    """Device damping [N s/m] that renders the scaled tissue passively at every depth."""
    law, x = servo_law(model, theta), np.linspace(0.0, model.depth_mm, DEPTHS)
    slope, (stiffness, tau) = model.static_slope(theta, x), law.linearised(model, theta, x)
    factor = scaling.force / scaling.motion * N_PER_MM_TO_N_PER_M
    return damping_bound(slope * factor, stiffness * factor, tau, period_s=period_s, delay_ticks=delay_ticks)
