"""Compiled recursions of the branch state: exact for displacement that is linear between samples.

The series branch of the modified Kelvin-Voigt model obeys ``tau ds/dt + s = tau dx/dt`` (model.md 1,
reconstructed from Sadeghnejad et al., equations (3) and (6)).  With ``x`` linear over a step ``h``::

    s[n+1] = a s[n] + phi (x[n+1] - x[n]),   a = exp(-h/tau),   phi = (1 - a) tau / h

which has no step-size error and is stable for any ``h``; ``h = 0`` is a jump (a = phi = 1).  Values
below 1e-200 are set to zero, because denormal numbers slow the loop ninefold.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "branch_sensitivity",
    "branch_state",
    "step_weights",
    "surface_path",
    "tissue_step",
    "tissue_step_in",
]

FloatArray = NDArray[np.float64]

#: Magnitude below which a branch state counts as zero [mm]; far above the denormal range.
FLUSH_MM = 1e-200
#: Newton steps allowed for the detached surface; it converges in 3 or 4, bisection alone in 50.
MAX_DETACHED_ITERATIONS = 60


@nb.njit(cache=True, nogil=True)
def step_weights(h: float, tau: float) -> tuple[float, float]:
    """Weights ``(a, phi)`` of one step of ``h`` seconds."""
    ratio = h / tau
    if ratio <= 0.0:
        return 1.0, 1.0
    return math.exp(-ratio), -math.expm1(-ratio) / ratio


@nb.njit(cache=True, nogil=True)
def branch_state(time_s: FloatArray, depth_mm: FloatArray, tau: float, initial: float) -> FloatArray:
    """State of one branch at every sample.

    Parameters
    ----------
    time_s, depth_mm : ndarray, shape (n,)
        Non-decreasing times [s] and depths [mm].
    tau : float
        Relaxation time [s].
    initial : float
        State at the first sample [mm]; 0 for a tissue at rest.

    Returns
    -------
    ndarray, shape (n,)
        Spring elongation of the branch [mm].
    """
    n = time_s.size
    out = np.empty(n)
    s = initial
    out[0] = s
    last_h = -1.0
    a = 1.0
    phi = 1.0
    for i in range(1, n):
        h = time_s[i] - time_s[i - 1]
        if h != last_h:
            a, phi = step_weights(h, tau)
            last_h = h
        s = a * s + phi * (depth_mm[i] - depth_mm[i - 1])
        if abs(s) < FLUSH_MM:
            s = 0.0
        out[i] = s
    return out


@nb.njit(cache=True, nogil=True)
def branch_sensitivity(time_s: FloatArray, depth_mm: FloatArray, tau: float) -> tuple[FloatArray, FloatArray]:
    """State of one branch from rest and its derivative by the relaxation time.

    Returns
    -------
    state, derivative : ndarray, shape (n,)
        [mm] and [mm/s].
    """
    n = time_s.size
    state = np.zeros(n)
    derivative = np.zeros(n)
    s = 0.0
    d = 0.0
    for i in range(1, n):
        h = time_s[i] - time_s[i - 1]
        dx = depth_mm[i] - depth_mm[i - 1]
        a, phi = step_weights(h, tau)
        if h > 0.0:
            da = a * h / (tau * tau)
            ratio = h / tau
            # (1 - a)/h - a/tau loses all digits for h << tau; the series takes over
            if ratio < 1e-4:
                dphi = ratio * (0.5 - ratio * (1.0 / 3.0 - ratio / 8.0)) / tau
            else:
                dphi = -math.expm1(-ratio) / h - a / tau
        else:
            da = 0.0
            dphi = 0.0
        d = a * d + da * s + dphi * dx
        s = a * s + phi * dx
        if abs(s) < FLUSH_MM:
            s = 0.0
        if abs(d) < FLUSH_MM:
            d = 0.0
        state[i] = s
        derivative[i] = d
    return state, derivative


@nb.njit(cache=True, nogil=True)
def _continued(coefficients: FloatArray, x: float, depth: float) -> tuple[float, float]:
    """Value and slope of a polynomial in x, continued beyond ``depth`` with its end slope, not below 0.

    Below 0 the value at 0 is kept, and the slope there is returned.
    """
    inside = min(max(x, 0.0), depth)
    value = 0.0
    slope = 0.0
    for k in range(coefficients.size - 1, -1, -1):
        slope = slope * inside + value
        value = value * inside + coefficients[k]
    if x > depth:
        slope = max(slope, 0.0)
        value += slope * (x - depth)
    return value, slope


@nb.njit(cache=True, nogil=True)
def _following_force(
    static: FloatArray,
    stiffness: FloatArray,
    depth: float,
    surface: float,
    decayed: FloatArray,
    gain: FloatArray,
    y: float,
) -> tuple[float, float]:
    """Force on a surface that moves linearly from ``surface`` to ``y`` in this step, and its slope by y."""
    force, slope = _continued(static, y, depth)
    for j in range(decayed.size):
        state = decayed[j] + gain[j] * (y - surface)
        k, dk = _continued(stiffness[j], y, depth)
        force += k * state
        slope += dk * state + k * gain[j]
    return force, slope


@nb.njit(cache=True, nogil=True)
def _force_free_surface(
    static: FloatArray,
    stiffness: FloatArray,
    depth: float,
    surface: float,
    target: float,
    decayed: FloatArray,
    gain: FloatArray,
) -> float:
    """Position deeper than ``target`` at which a free surface ends this step: bracketed Newton.

    The force at ``target`` is negative.  Where a fast branch still pushes while a slow one pulls, or
    where the force falls with depth, the surface may even have to end deeper than it started.
    """
    low = target
    high = max(surface, target)
    width = 1e-3 * depth
    force, slope = _following_force(static, stiffness, depth, surface, decayed, gain, high)
    for _ in range(MAX_DETACHED_ITERATIONS):
        if force >= 0.0:
            break
        low = high
        high += width
        width *= 2.0
        force, slope = _following_force(static, stiffness, depth, surface, decayed, gain, high)
    y = high
    resolution = 1e-14 * depth
    for _ in range(MAX_DETACHED_ITERATIONS):
        if abs(force) <= resolution * slope or high - low <= resolution:
            break
        if force > 0.0:
            high = y
        else:
            low = y
        candidate = y - force / slope if slope > 0.0 else low
        if not low < candidate < high:
            candidate = 0.5 * (low + high)
        y = candidate
        force, slope = _following_force(static, stiffness, depth, surface, decayed, gain, y)
    return y


@nb.njit(cache=True, nogil=True)
def tissue_step_in(
    static: FloatArray,
    stiffness: FloatArray,
    tau: FloatArray,
    depth: float,
    surface: float,
    states: FloatArray,
    x: float,
    h: float,
    decayed: FloatArray,
    gain: FloatArray,
) -> tuple[float, float]:
    """Advance the tissue by one step under a tool that can push but not pull.

    Unilateral contact (model.md 1.2, derived): force >= 0, surface >= tool, and one of the two is an
    equality.  If following the tool would need tension, the surface detaches and recovers along the
    force-free path, found as the root of the force in the surface position of this very step, so that
    the step stays exact for a surface that moves linearly.

    Parameters
    ----------
    static : ndarray, shape (4,)
        Coefficients of F_s by powers of x, constant term first (0) [N/mm^k].
    stiffness : ndarray, shape (branches, degree + 1)
        Coefficients of K_j by powers of x [N/mm^(k+1)].
    tau : ndarray, shape (branches,)
        Relaxation times [s].
    depth : float
        Largest identified depth [mm]; the law is continued beyond it.
    surface : float
        Surface position at the start of the step [mm].
    states : ndarray, shape (branches,)
        Branch states [mm]; **updated in place**.
    x : float
        Tool position at the end of the step [mm]; negative is in air.
    h : float
        Measured step [s].
    decayed, gain : ndarray, shape (branches,)
        Room to work in, so that a loop allocates nothing.

    Returns
    -------
    force, surface : float
        Force on the tool [N], never negative, and the new surface position [mm], never negative.
    """
    n = states.size
    target = max(x, 0.0)
    for j in range(n):
        a, phi = step_weights(h, tau[j])
        decayed[j] = a * states[j]
        gain[j] = phi
    force, _slope = _following_force(static, stiffness, depth, surface, decayed, gain, target)
    y = target
    if force < 0.0 and n > 0:
        y = _force_free_surface(static, stiffness, depth, surface, target, decayed, gain)
    for j in range(n):
        states[j] = decayed[j] + gain[j] * (y - surface)
        if abs(states[j]) < FLUSH_MM:
            states[j] = 0.0
    # a tool in air touches nothing, even where rounding leaves a force at the rest level
    return (max(force, 0.0) if x >= 0.0 else 0.0), y


@nb.njit(cache=True, nogil=True)
def tissue_step(
    static: FloatArray,
    stiffness: FloatArray,
    tau: FloatArray,
    depth: float,
    surface: float,
    states: FloatArray,
    x: float,
    h: float,
) -> tuple[float, float]:
    """:func:`tissue_step_in` with room of its own: the same step, where an allocation does no harm."""
    decayed = np.empty(states.size)
    gain = np.empty(states.size)
    return tissue_step_in(static, stiffness, tau, depth, surface, states, x, h, decayed, gain)


@nb.njit(cache=True, nogil=True)
def surface_path(
    static: FloatArray,
    stiffness: FloatArray,
    tau: FloatArray,
    depth: float,
    time_s: FloatArray,
    tool_mm: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Surface of a tissue and force on a tool along a whole path, at rest at the first sample.

    Parameters
    ----------
    static, stiffness, tau, depth
        As in :func:`tissue_step_in`.
    time_s, tool_mm : ndarray, shape (n,)
        Non-decreasing times [s] and tool position [mm], negative in air.

    Returns
    -------
    surface, force : ndarray, shape (n,)
        [mm], never negative and never above the tool; [N], never negative.
    """
    n = time_s.size
    surface = np.empty(n)
    force = np.empty(n)
    states = np.zeros(tau.size)
    surface[0] = max(tool_mm[0], 0.0)
    force[0] = _continued(static, surface[0], depth)[0] if tool_mm[0] >= 0.0 else 0.0
    for i in range(1, n):
        force[i], surface[i] = tissue_step(
            static, stiffness, tau, depth, surface[i - 1], states, tool_mm[i], time_s[i] - time_s[i - 1]
        )
    return surface, force
