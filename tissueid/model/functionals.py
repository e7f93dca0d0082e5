"""Closed forms of tests that people quote, derived from the law, and errors by the delta method.

* ideal step to x from rest: s_j = x exp(-t/tau_j);
* ramp at speed v to x, t from its end: s_j = v tau_j (1 - exp(-x/(v tau_j))) exp(-t/tau_j);
* small oscillation about rest at x: K* = F_s'(x) + sum K_j(x) i w tau_j / (1 + i w tau_j);
* sine of amplitude a about x: pi a^2 sum (K_j(x) + K_j''(x) a^2 / 8) w tau_j / (1 + w^2 tau_j^2) a cycle.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.model.channels import ChannelModel

#: Relative step of the central differences: cube root of the rounding unit, the usual compromise.
STEP = 6e-6
#: Influence of a parameter, relative to the value, below which it has none.
NO_INFLUENCE = 1e-6


def _static(model: ChannelModel, theta: FloatArray, depth_mm: float) -> tuple[float, float]:
    """F_s and F_s' at a depth."""
    at = np.array([depth_mm])
    return float(model.static_force(theta, at)[0]), float(model.static_slope(theta, at)[0])


def force_after_ramp(
    model: ChannelModel, theta: FloatArray, depth_mm: float, speed_mm_s: float | None, time_s: float
) -> float:
    """Force a time after the end of a ramp from rest, at constant speed, to a depth [N]; ``None``: a step."""
    relaxing = model.relaxing(theta, depth_mm, np.array([time_s]), speed_mm_s)
    return _static(model, theta, depth_mm)[0] + float(relaxing[0])


def complex_stiffness(
    model: ChannelModel, theta: FloatArray, depth_mm: float, frequency_Hz: float
) -> tuple[float, float]:
    """Storage and loss stiffness of a small oscillation about rest at a depth [N/mm]."""
    stiffness, tau = model.modes(theta, depth_mm)
    phase = 2.0 * np.pi * frequency_Hz * tau
    storage = _static(model, theta, depth_mm)[1] + float((stiffness * phase**2 / (1.0 + phase**2)).sum())
    return storage, float((stiffness * phase / (1.0 + phase**2)).sum())


def dissipated_per_cycle(
    model: ChannelModel, theta: FloatArray, depth_mm: float, amplitude_mm: float, frequency_Hz: float
) -> float:
    """Energy lost in one cycle of a sine of some amplitude about a depth, in lasting contact [mJ]."""
    stiffness, tau = model.modes(theta, depth_mm, amplitude_mm)
    phase = 2.0 * np.pi * frequency_Hz * tau
    return float(np.pi * amplitude_mm**2 * (stiffness * phase / (1.0 + phase**2)).sum())


def equilibrium_stiffness(model: ChannelModel, theta: FloatArray, depth_mm: float) -> tuple[float, float]:
    """Secant and tangent stiffness once every branch has relaxed [N/mm]."""
    force, slope = _static(model, theta, depth_mm)
    return force / depth_mm, slope


def instantaneous_stiffness(model: ChannelModel, theta: FloatArray, depth_mm: float) -> tuple[float, float]:
    """Secant of an ideal step from rest, and tangent of a small step at rest at a depth [N/mm]."""
    _, tangent = equilibrium_stiffness(model, theta, depth_mm)
    sudden = float(model.stiffness(theta, np.array([depth_mm])).sum())
    return force_after_ramp(model, theta, depth_mm, None, 0.0) / depth_mm, tangent + sudden


def delta_method(
    function: Callable[[FloatArray], float],
    theta: FloatArray,
    covariance: FloatArray,
    unknown: NDArray[np.bool_],
) -> tuple[float, float]:
    """Value of a smooth function of theta and its standard error, to first order.

    ``unknown`` (p,): parameters of infinite variance. The error is infinite where the value depends on
    one of them, or has no slope there.
    """
    value = function(theta)
    if not np.isfinite(value):
        return value, float("inf")
    gradient = np.zeros(theta.size)
    for i in range(theta.size):
        step = STEP * max(abs(float(theta[i])), float(np.sqrt(max(covariance[i, i], 0.0))) * STEP)
        if step == 0.0:
            continue
        up, down = theta.copy(), theta.copy()
        up[i] += step
        down[i] -= step
        with np.errstate(over="ignore", invalid="ignore"):
            gradient[i] = (function(up) - function(down)) / (2.0 * step)
    moves = np.abs(gradient * theta) > NO_INFLUENCE * abs(value)
    if (moves & unknown).any() or not np.isfinite(gradient).all():
        return value, float("inf")
    used = np.where(unknown, 0.0, gradient)
    variance = float(used @ np.where(np.isfinite(covariance), covariance, 0.0) @ used)
    return value, float(np.sqrt(max(variance, 0.0)))
