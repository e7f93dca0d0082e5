"""Recursion of the branch state along a sampled path, exact for displacement that is linear between samples.

``tau ds/dt + s = tau dx/dt`` (Sadeghnejad et al., equations (3) and (6)) over a step ``h``::

    s[n+1] = a s[n] + phi (x[n+1] - x[n]),   a = exp(-h/tau),   phi = (1 - a) tau / h

stable for any ``h``; ``h = 0`` is a jump.  The servo steps the same in :mod:`tissueid.model.kernels`.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray

#: Magnitude below which a branch state counts as zero [mm]; far above the denormal range.
FLUSH_MM = 1e-200
#: Steps over tau below which (1 - a)/h - a/tau loses all digits, and its series takes over.
SHORT = 1e-4


def _recurrence(decay: FloatArray, gain: FloatArray) -> FloatArray:
    """``s[n+1] = decay[n] s[n] + gain[n]`` from rest, (..., n - 1) -> (..., n), in log2(n) passes."""
    state = np.concatenate([np.zeros((*gain.shape[:-1], 1)), gain], axis=-1)
    s, decay, reach = state[..., 1:], decay.copy(), 1
    while reach < s.shape[-1] and decay[..., reach:].any():
        s[..., reach:] += decay[..., reach:] * s[..., :-reach]
        decay[..., reach:] *= decay[..., :-reach]
        reach *= 2
    state[np.abs(state) < FLUSH_MM] = 0.0
    return state


def _weights(step_s: FloatArray, tau: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Steps over tau and their weights a and phi, (n - 1,) and (t,) -> (t, n - 1) each."""
    ratio = step_s / tau[:, None]
    moved = -np.expm1(-ratio)
    phi = np.divide(moved, ratio, out=np.ones_like(ratio), where=ratio > 0.0)
    return ratio, np.exp(-ratio), phi


def branch_states(time_s: FloatArray, driver: FloatArray, tau: FloatArray) -> FloatArray:
    """Convolutions of a driver's rate with exponentials, linear in between; (n,) and (t,) -> (t, n)."""
    _, decay, phi = _weights(np.diff(time_s), tau)
    return _recurrence(decay, phi * np.diff(driver))


def branch_sensitivity(time_s: FloatArray, depth_mm: FloatArray, tau: float) -> tuple[FloatArray, FloatArray]:
    """State of one branch from rest and its derivative by the relaxation time, (n,) [mm] and [mm/s]."""
    step, move = np.diff(time_s), np.diff(depth_mm)
    ratio, decay, phi = (one[0] for one in _weights(step, np.array([tau])))
    state = _recurrence(decay, phi * move)
    series = ratio * (0.5 - ratio * (1.0 / 3.0 - ratio / 8.0)) / tau
    exact = np.divide(phi - decay, tau, out=np.zeros_like(phi), where=step > 0.0)
    slope = np.where(ratio < SHORT, series, exact)
    return state, _recurrence(decay, decay * ratio / tau * state[:-1] + slope * move)
