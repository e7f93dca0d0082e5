"""Draws of a specimen's posterior, stretched about its value to the spread between its logs.

Where a model misses more than the noise, white weights make the spread of the draws that of the noise; what
logs of one specimen tell of each other is larger (:mod:`tissueid.fit.discrepancy`).  Coefficients of F_s,
viscosities K tau and ln tau move away from the value by one factor, each draw no further than is passive: the
passive set is convex, so that a draw and the value have a last passive tissue between them and beyond.  What
all gains have in common is a random effect of the model already, and is not stretched: a draw's size is taken
off before, and given back after.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.passive_normal import passive
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt

__all__ = ["stretched"]

FloatArray = NDArray[np.float64]

#: Halvings of the way to the edge of what is passive.
HALVINGS = 20


def _flat(model: KelvinVoigt, theta: FloatArray) -> FloatArray:
    """Theta (n, p) with viscosities by powers of u in the place of K, and ln tau; F_s by powers of u."""
    out = theta.copy()
    out[:, :STATIC_DEGREE] *= model.depth_mm ** np.arange(1.0, STATIC_DEGREE + 1)
    for branch in range(model.branches):
        first = STATIC_DEGREE + branch * model.block
        last = first + model.stiffness_degree + 1
        scale = model.depth_mm ** np.arange(float(last - first))
        out[:, first:last] = theta[:, first:last] * scale * theta[:, last : last + 1]
        out[:, last] = np.log(theta[:, last])
    return out


def _theta(model: KelvinVoigt, flat: FloatArray) -> FloatArray:
    """The inverse of :func:`_flat`."""
    out = flat.copy()
    out[:, :STATIC_DEGREE] *= model.depth_mm ** -np.arange(1.0, STATIC_DEGREE + 1)
    for branch in range(model.branches):
        first = STATIC_DEGREE + branch * model.block
        last = first + model.stiffness_degree + 1
        out[:, last] = np.exp(flat[:, last])
        scale = model.depth_mm ** -np.arange(float(last - first))
        out[:, first:last] = flat[:, first:last] * scale / out[:, last : last + 1]
    return out


def _log_size(model: KelvinVoigt, flat: FloatArray, speed_mm_s: float) -> FloatArray:
    """Ln of the force at the end of the deepest ramp, shape (n,)."""
    force = flat[:, :STATIC_DEGREE].sum(axis=1)
    for branch in range(model.branches):
        first = STATIC_DEGREE + branch * model.block
        last = first + model.stiffness_degree + 1
        length = speed_mm_s * np.exp(flat[:, last])
        force = force - flat[:, first:last].sum(axis=1) * speed_mm_s * np.expm1(-model.depth_mm / length)
    return np.asarray(np.log(np.maximum(force, 1e-300)))


def _scaled(model: KelvinVoigt, flat: FloatArray, log_factor: FloatArray) -> FloatArray:
    """The same tissues, stiffer by a factor each."""
    out = flat * np.exp(log_factor)[:, None]
    for branch in range(model.branches):
        last = STATIC_DEGREE + branch * model.block + model.stiffness_degree + 1
        out[:, last] = flat[:, last]
    return np.asarray(out)


def stretched(
    model: KelvinVoigt, theta: FloatArray, value: FloatArray, factor: float, speed_mm_s: float
) -> FloatArray:
    """Draws moved away from a value.

    Parameters
    ----------
    model : KelvinVoigt
    theta : ndarray, shape (n, p)
        Passive draws.
    value : ndarray, shape (p,)
        Passive.
    factor : float
        How much further from the value, at least 1.
    speed_mm_s : float
        At which forces are compared [mm/s].

    Returns
    -------
    ndarray, shape (n, p)
        Passive.
    """
    near, middle = _flat(model, theta), _flat(model, value[None])
    size_off = _log_size(model, near, speed_mm_s) - _log_size(model, middle, speed_mm_s)
    near = _scaled(model, near, -size_off)
    size = model.stiffness_degree + 1
    times = [STATIC_DEGREE + j * model.block + size for j in range(model.branches)]
    columns = np.delete(np.arange(theta.shape[1]), times)
    blocks = np.array([STATIC_DEGREE, *[size] * model.branches], dtype=np.int64)
    low, high = np.ones(theta.shape[0]), np.full(theta.shape[0], factor)

    def at(share: FloatArray) -> FloatArray:
        return np.asarray(middle + share[:, None] * (near - middle))

    good = passive(np.ascontiguousarray(at(high)[:, columns]), blocks)
    low[good] = factor
    for _ in range(HALVINGS):
        tried = 0.5 * (low + high)
        good = passive(np.ascontiguousarray(at(tried)[:, columns]), blocks)
        low, high = np.where(good, tried, low), np.where(good, high, tried)
    return _theta(model, _scaled(model, at(low), size_off))
