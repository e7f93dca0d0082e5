"""Compiled force of a tissue seen through an instrument, at knots, and its derivatives.

A tissue with coefficients theta stands behind a frame of compliance c, so that its depth is ``w = x - c F``
with F its own force: F is the root of a scalar equation at every knot.  Between knots the tool moves
linearly, for which the branch states are exact.  What the load channel makes of the force is in
:mod:`tissueid.likelihood.load_channel`.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.load_channel import channel
from tissueid.model.kernels import step_weights

__all__ = [
    "ALL", "EFFECTS", "INSTRUMENT", "RELAXATION", "TISSUE", "Packed", "effect_count", "instrument_force",
    "tissue_path",
]  # fmt: skip

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Which columns are wanted; each kind has those before it.
EFFECTS, TISSUE, RELAXATION, ALL = 0, 1, 2, 3
#: Skew, filter and compliance, in this order.
INSTRUMENT = 3
#: Newton steps for the force behind a frame, and the change, relative, that ends them.
NEWTON_STEPS = 40
NEWTON_DONE = 1e-13
#: Static polynomial: constant to cube.
STATIC_TERMS = 4


class Packed(NamedTuple):
    """Knots of all logs of a specimen, one behind the other, with the law's shape and the logs' effects.

    Attributes
    ----------
    time_s, depth_mm : ndarray, shape (m,)
    first : ndarray of int, shape (logs + 1,)
        Where each log begins.
    pull : ndarray, shape (m,)
        H'R^-1 e.
    band : ndarray, shape (m, w)
        H'R^-1 H: ``band[k, d]`` is the entry (k, k + d).
    square : ndarray, shape (logs,)
        e'R^-1 e [N^2].
    base : ndarray, shape (m,)
        Force of the optimum at the knots [N].
    scale : float
        Depth of u = 1 [mm].
    degree, branches, static : int
        Degree of K, branches, static coefficients in theta (3 or 0).
    gamma, delta : ndarray, shape (logs,)
        Log gains and contact offsets [mm] about which effects are linear.
    own : ndarray, shape (logs, 4)
        A log's own static polynomial by powers of u.
    gain, offset, free : bool
        Which effects the logs have: gain, contact offset, or a free cubic.
    """

    time_s: FloatArray
    depth_mm: FloatArray
    first: IntArray
    pull: FloatArray
    band: FloatArray
    square: FloatArray
    base: FloatArray
    scale: float
    degree: int
    branches: int
    static: int
    gamma: FloatArray
    delta: FloatArray
    own: FloatArray
    gain: bool
    offset: bool
    free: bool


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _law(
    static: FloatArray,
    stiffness: FloatArray,
    z: float,
    move: float,
    decayed: FloatArray,
    gain: FloatArray,
    state: FloatArray,
    k_now: FloatArray,
) -> tuple[float, float]:
    """Force, and its slope by z with the states as they are; states and K_j are written."""
    force = 0.0
    slope = 0.0
    for k in range(STATIC_TERMS - 1, -1, -1):
        slope = slope * z + force
        force = force * z + static[k]
    for j in range(stiffness.shape[0]):
        value = 0.0
        rise = 0.0
        for k in range(stiffness.shape[1] - 1, -1, -1):
            rise = rise * z + value
            value = value * z + stiffness[j, k]
        state[j] = decayed[j] + gain[j] * move
        k_now[j] = value
        force += value * state[j]
        slope += rise * state[j]
    return force, slope


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _coefficients(data: Packed, log: int, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Static (4,) and stiffness coefficients (branches, degree + 1) of one log, by powers of depth."""
    gain = np.exp(data.gamma[log])
    static = np.zeros(STATIC_TERMS)
    for k in range(STATIC_TERMS):
        static[k] = data.own[log, k]
        if data.static > 0 and k > 0:
            static[k] += gain * theta[k - 1]
        static[k] *= data.scale**-k
    size = data.degree + 1
    stiffness = np.zeros((data.branches, size))
    for j in range(data.branches):
        for k in range(size):
            stiffness[j, k] = gain * theta[data.static + j * size + k] * data.scale**-k
    return static, stiffness


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _balanced(
    static: FloatArray,
    stiffness: FloatArray,
    x: float,
    w_old: float,
    delta: float,
    compliance: float,
    f: float,
    decayed: FloatArray,
    phi: FloatArray,
    state: FloatArray,
    k_now: FloatArray,
) -> tuple[float, float, float]:
    """Force of a tissue behind a frame, its depth, and its slope; started from a force ``f``."""
    w = x - compliance * f
    for _ in range(NEWTON_STEPS):
        law, slope = _law(static, stiffness, w - delta, w - w_old, decayed, phi, state, k_now)
        if compliance == 0.0:
            return law, w, slope
        tangent = slope
        for j in range(state.size):
            tangent += k_now[j] * phi[j]
        step = (law - f) / (1.0 + compliance * tangent)
        f += step
        w = x - compliance * f
        if abs(step) <= NEWTON_DONE * (1.0 + abs(f)):
            break
    _, slope = _law(static, stiffness, w - delta, w - w_old, decayed, phi, state, k_now)
    return f, w, slope


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _direct(
    data: Packed, log: int, theta: FloatArray, f: float, slope: float, w: float, state: FloatArray,
    kind: int, row: FloatArray,
) -> int:  # fmt: skip
    """What each parameter does to the force at a given depth and history; how many come before ln tau."""
    row[:] = 0.0
    u = (w - data.delta[log]) / data.scale
    gain = np.exp(data.gamma[log])
    at = 0
    if data.gain:
        row[0] = f
        at = 1
    if data.offset:
        row[at] = -slope
        at += 1
    if data.free:
        power = 1.0
        for k in range(STATIC_TERMS):
            row[at + k] = power
            power *= u
        at += STATIC_TERMS
    if kind < TISSUE:
        return at
    power = gain * u
    for k in range(data.static):
        row[at + k] = power
        power *= u
    size = data.degree + 1
    for j in range(data.branches):
        power = gain * state[j]
        for k in range(size):
            row[at + data.static + j * size + k] = power
            power *= u
    return at + theta.size


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _by_time(h: float, tau: float, a: float, phi: float, old: float, moved: float) -> float:
    """Derivative of a branch state by ln tau over one step, the state before held."""
    if h <= 0.0:
        return 0.0
    ratio = h / tau
    # (1 - a) tau/h - a loses all digits for h << tau; the series takes over
    dphi = phi - a if ratio > 1e-4 else ratio * (0.5 - ratio / 3.0)
    return a * ratio * old + dphi * moved


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _rates(
    data: Packed, at: int, first: int, last: int, slope: float, compliance: float,
    k_now: FloatArray, state: FloatArray, tau: FloatArray,
) -> tuple[float, float]:  # fmt: skip
    """Rates of force before and after a knot: the tool's speed there, and branches that let go [N/s]."""
    loss = 0.0
    for j in range(state.size):
        slope += k_now[j]
        loss += k_now[j] * state[j] / tau[j]
    give = 1.0 + compliance * slope
    left = 0.0
    right = 0.0
    if at > first:
        span = data.time_s[at] - data.time_s[at - 1]
        left = (slope * (data.depth_mm[at] - data.depth_mm[at - 1]) / span - loss) / give
    if at < last:
        span = data.time_s[at + 1] - data.time_s[at]
        right = (slope * (data.depth_mm[at + 1] - data.depth_mm[at]) / span - loss) / give
    return left, right


@nb.njit(cache=True, nogil=True, error_model="numpy")
def tissue_path(
    data: Packed,
    log: int,
    theta: FloatArray,
    log_tau: FloatArray,
    compliance: float,
    kind: int,
    rates: FloatArray,
    columns: FloatArray,
) -> None:
    """Force of the tissue behind a frame at the knots of one log, its rates on both sides, its derivatives.

    Parameters
    ----------
    data : Packed
    log : int
    theta, log_tau : ndarray
    compliance : float
        Of the frame [mm/N].
    kind : int
        Derivatives that are wanted; negative for none.
    rates : ndarray, shape (3, n)
        Written: force, its rate before and its rate after each knot.
    columns : ndarray, shape (c, n)
        Written: derivatives by the effects of the log, by theta, by ln tau, as far as ``kind`` goes.
    """
    first, last = data.first[log], data.first[log + 1] - 1
    branches = data.branches
    static, stiffness = _coefficients(data, log, theta)
    tau = np.exp(log_tau)
    total = columns.shape[0] if kind >= EFFECTS else 0
    state, old, decayed, phi, a, k_now = np.zeros((6, branches))
    row, by_depth = np.zeros((2, max(total, 1)))
    by_state = np.zeros((branches, max(total, 1)))
    w = 0.0
    f = 0.0
    for i in range(last - first + 1):
        h = data.time_s[first + i] - data.time_s[first + i - 1] if i > 0 else 0.0
        for j in range(branches):
            old[j] = state[j]
            if i > 0:
                # before the first knot the tissue is at rest, wherever the tool is
                a[j], phi[j] = step_weights(h, tau[j])
            decayed[j] = a[j] * old[j]
        w_old = w
        f, w, slope = _balanced(
            static, stiffness, data.depth_mm[first + i], w_old, data.delta[log], compliance, f,
            decayed, phi, state, k_now,
        )  # fmt: skip
        rates[0, i] = f
        rates[1, i], rates[2, i] = _rates(
            data, first + i, first, last, slope, compliance, k_now, state, tau
        )  # fmt: skip
        if total == 0:
            continue
        times = _direct(data, log, theta, f, slope, w, state, kind, row)
        tangent = slope
        for j in range(branches):
            tangent += k_now[j] * phi[j]
        for q in range(total):
            value = row[q]
            for j in range(branches):
                carried = a[j] * by_state[j, q] - phi[j] * by_depth[q]
                if kind >= RELAXATION and q == times + j:
                    carried += _by_time(h, tau[j], a[j], phi[j], old[j], w - w_old)
                by_state[j, q] = carried
                value += k_now[j] * carried
            value /= 1.0 + compliance * tangent
            columns[q, i] = value
            moved = -compliance * value
            for j in range(branches):
                by_state[j, q] += phi[j] * moved
            by_depth[q] = moved


@nb.njit(cache=True, nogil=True, error_model="numpy")
def effect_count(data: Packed) -> int:
    """Effects of a log."""
    count = 0
    if data.gain:
        count += 1
    if data.offset:
        count += 1
    if data.free:
        count += STATIC_TERMS
    return count


@nb.njit(cache=True, nogil=True, error_model="numpy")
def instrument_force(
    data: Packed, theta: FloatArray, log_tau: FloatArray, instrument: FloatArray
) -> FloatArray:
    """Force that the load channel shows at all knots [N], shape (m,).

    Parameters
    ----------
    data : Packed
        ``pull``, ``band``, ``square`` and ``base`` are not looked at.
    theta : ndarray, shape (p,)
        By powers of u, as in :class:`tissueid.likelihood.linearise.Optimum`.
    log_tau : ndarray, shape (branches,)
    instrument : ndarray, shape (3,)
        Skew [s], filter [s], compliance [mm/N].
    """
    out = np.empty(data.time_s.size)
    none = np.zeros((1, 1))
    for log in range(data.first.size - 1):
        begin, end = data.first[log], data.first[log + 1]
        rates = np.empty((3, end - begin))
        tissue_path(data, log, theta, log_tau, instrument[2], -1, rates, none)
        channel(data.time_s[begin:end], rates, none[:0], instrument[0], instrument[1], out[begin:end], none)
    return out
