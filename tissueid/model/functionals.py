"""What a fitted tissue does in tests that people quote: closed forms, and errors by the delta method.

Relaxation times and stiffnesses of several branches move with the window and with their number; what
they do together moves much less (statistics.md 5b).  All functions are pure; depth in mm below contact,
force in N, time in s, frequency in Hz.

Closed forms (derived from F = F_s(x) + sum K_j(x) s_j, tau_j s_j' + s_j = tau_j x'):

* ideal step to x from rest: s_j = x exp(-t/tau_j);
* ramp at speed v to x, t from its end: s_j = v tau_j (1 - exp(-x/(v tau_j))) exp(-t/tau_j);
* small oscillation about rest at x: K* = F_s'(x) + sum K_j(x) i w tau_j / (1 + i w tau_j);
* sine of amplitude a about x, in contact throughout: the energy dissipated in a cycle is
  pi a^2 sum (K_j(x) + K_j''(x) a^2 / 8) w tau_j / (1 + w^2 tau_j^2), exact for K of degree 2 (F_s returns
  its work; the linear part of K gives nothing by symmetry).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tissueid.model.kelvin_voigt import KelvinVoigt

__all__ = [
    "complex_stiffness",
    "delta_method",
    "dissipated_per_cycle",
    "equilibrium_stiffness",
    "force_after_ramp",
    "force_after_step",
    "instantaneous_stiffness",
]

FloatArray = NDArray[np.float64]

#: Relative step of the central differences: cube root of the rounding unit, the usual compromise.
STEP = 6e-6
#: Influence of a parameter, relative to the value, below which it has none.
NO_INFLUENCE = 1e-6


def _static(model: KelvinVoigt, theta: FloatArray, depth_mm: float) -> tuple[float, float]:
    """F_s and F_s' at a depth."""
    a = model.split(theta)[0]
    x = depth_mm
    return float(x * (a[0] + x * (a[1] + x * a[2]))), float(a[0] + x * (2.0 * a[1] + 3.0 * x * a[2]))


def _stiffness(model: KelvinVoigt, theta: FloatArray, depth_mm: float) -> FloatArray:
    """K_j at a depth, shape (branches,)."""
    return model.stiffness(theta, np.array([depth_mm]))[:, 0]


def force_after_step(model: KelvinVoigt, theta: FloatArray, depth_mm: float, time_s: float) -> float:
    """Force a time after an ideal step from rest to a depth [N]."""
    tau = model.split(theta)[2]
    branches = _stiffness(model, theta, depth_mm) * depth_mm * np.exp(-time_s / tau)
    return _static(model, theta, depth_mm)[0] + float(branches.sum())


def force_after_ramp(
    model: KelvinVoigt, theta: FloatArray, depth_mm: float, speed_mm_s: float, time_s: float
) -> float:
    """Force a time after the end of a ramp from rest, at constant speed, to a depth [N]."""
    tau = model.split(theta)[2]
    length = speed_mm_s * tau
    state = -length * np.expm1(-depth_mm / length) * np.exp(-time_s / tau)
    branches = _stiffness(model, theta, depth_mm) * state
    return _static(model, theta, depth_mm)[0] + float(branches.sum())


def complex_stiffness(
    model: KelvinVoigt, theta: FloatArray, depth_mm: float, frequency_Hz: float
) -> tuple[float, float]:
    """Storage and loss stiffness of a small oscillation about rest at a depth [N/mm]."""
    phase = 2.0 * np.pi * frequency_Hz * model.split(theta)[2]
    stiffness = _stiffness(model, theta, depth_mm)
    storage = _static(model, theta, depth_mm)[1] + float((stiffness * phase**2 / (1.0 + phase**2)).sum())
    return storage, float((stiffness * phase / (1.0 + phase**2)).sum())


def dissipated_per_cycle(
    model: KelvinVoigt, theta: FloatArray, depth_mm: float, amplitude_mm: float, frequency_Hz: float
) -> float:
    """Energy lost in one cycle of a sine of some amplitude about a depth, in lasting contact [mJ]."""
    _, coefficients, tau = model.split(theta)
    phase = 2.0 * np.pi * frequency_Hz * tau
    curved = coefficients[:, 2] if coefficients.shape[1] > 2 else np.zeros(tau.size)
    stiffness = _stiffness(model, theta, depth_mm) + curved * amplitude_mm**2 / 4.0
    return float(np.pi * amplitude_mm**2 * (stiffness * phase / (1.0 + phase**2)).sum())


def equilibrium_stiffness(model: KelvinVoigt, theta: FloatArray, depth_mm: float) -> tuple[float, float]:
    """Secant and tangent stiffness once every branch has relaxed [N/mm]."""
    force, slope = _static(model, theta, depth_mm)
    return force / depth_mm, slope


def instantaneous_stiffness(model: KelvinVoigt, theta: FloatArray, depth_mm: float) -> tuple[float, float]:
    """Secant of an ideal step from rest, and tangent of a small step at rest at a depth [N/mm]."""
    secant, tangent = equilibrium_stiffness(model, theta, depth_mm)
    sudden = float(_stiffness(model, theta, depth_mm).sum())
    return secant + sudden, tangent + sudden


def delta_method(
    function: Callable[[FloatArray], float],
    theta: FloatArray,
    covariance: FloatArray,
    unknown: NDArray[np.bool_],
) -> tuple[float, float]:
    """Value of a smooth function of theta and its standard error, to first order.

    Parameters
    ----------
    function : callable
    theta : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
    unknown : ndarray of bool, shape (p,)
        Parameters of infinite variance (their rows of the covariance are not looked at).

    Returns
    -------
    value, stderr : float
        The error is infinite where the value depends on an unknown parameter.
    """
    value = function(theta)
    gradient = np.zeros(theta.size)
    for i in range(theta.size):
        step = STEP * max(abs(float(theta[i])), float(np.sqrt(max(covariance[i, i], 0.0))) * STEP)
        if step == 0.0:
            continue
        up, down = theta.copy(), theta.copy()
        up[i] += step
        down[i] -= step
        gradient[i] = (function(up) - function(down)) / (2.0 * step)
    moves = np.abs(gradient * theta) > NO_INFLUENCE * abs(value)
    if (moves & unknown).any():
        return value, float("inf")
    used = np.where(unknown, 0.0, gradient)
    variance = float(used @ np.where(np.isfinite(covariance), covariance, 0.0) @ used)
    return value, float(np.sqrt(max(variance, 0.0)))
