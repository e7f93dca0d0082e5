"""How much damping a device needs to render a tissue without adding energy (model.md 6.4, derived).

Sampled-data passivity after Colgate & Schenkel (doi 10.1002/rob.4620140110): a law rendered at step
T through a zero-order hold, with ``delay`` ticks between encoder and motor, needs a device damping

    b > (T / 2) sup_w  Re{ (1 - exp(-i w T)) H(exp(i w T)) } / (1 - cos w T),   0 <= w <= pi / T

where H is the linearised law from sampled position to force.  For the Kelvin-Voigt tissue
``H(z) = k0 + sum_j K_j phi_j (z - 1) / (z - a_j)``, times ``z^-delay``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.model.scaling import Scaling

__all__ = ["DEFAULT_DELAY_TICKS", "damping_bound", "required_damping"]

FloatArray = NDArray[np.float64]

#: Ticks between a position sample and its force at the motor, where the device was not measured.
DEFAULT_DELAY_TICKS = 1.5
#: Frequencies in the search for the supremum: dense near 0 and near the Nyquist frequency.
FREQUENCIES = 4000
#: Depths at which the linearised law is examined.
DEPTHS = 33
N_PER_MM_TO_N_PER_M = 1000.0


def damping_bound(
    static_slope: float, stiffness: FloatArray, tau: FloatArray, *, period_s: float, delay_ticks: float
) -> float:
    """Damping that makes one linearised law passive.

    Parameters
    ----------
    static_slope : float
        k0, slope of the force by depth at fixed branch states.
    stiffness : ndarray, shape (branches,)
        K_j, in the unit of ``static_slope``.
    tau : ndarray, shape (branches,)
        Relaxation times [s].
    period_s : float
        Servo period [s].
    delay_ticks : float
        Delay in servo periods, fractions allowed.

    Returns
    -------
    float
        Smallest damping, in the unit of ``static_slope`` times seconds; never negative.
    """
    angle = np.concatenate([np.geomspace(1e-6, np.pi, FREQUENCIES), np.linspace(1e-3, np.pi, FREQUENCIES)])
    z = np.exp(1j * angle)
    a = np.exp(-period_s / tau)
    phi = -np.expm1(-period_s / tau) * tau / period_s
    law = np.full(angle.size, complex(static_slope))
    for weight, decay, gain in zip(stiffness, a, phi, strict=True):
        law += weight * gain * (z - 1.0) / (z - decay)
    law = law * z ** (-delay_ticks)
    # 1 - cos is computed as 2 sin^2 of the half angle: the difference loses its digits near zero
    need = ((1.0 - 1.0 / z) * law).real / (2.0 * np.sin(angle / 2.0) ** 2)
    return float(max(period_s / 2.0 * need.max(), 0.0))


def required_damping(
    model: KelvinVoigt,
    theta: FloatArray,
    scaling: Scaling,
    *,
    period_s: float,
    delay_ticks: float = DEFAULT_DELAY_TICKS,
) -> float:
    """Device damping [N s/m] that renders the scaled tissue passively at every depth.

    The tissue is linearised at rest at depths over [0, depth_mm]; the largest need counts.
    """
    static, _, tau = model.split(theta)
    x = np.linspace(0.0, model.depth_mm, DEPTHS)
    slope = static[0] + x * (2.0 * static[1] + 3.0 * x * static[2])
    stiffness = model.stiffness(theta, x)
    factor = scaling.force / scaling.motion * N_PER_MM_TO_N_PER_M
    return max(
        damping_bound(
            float(slope[i]) * factor,
            stiffness[:, i] * factor,
            tau,
            period_s=period_s,
            delay_ticks=delay_ticks,
        )
        for i in range(x.size)
    )
