"""Compiled force of a tissue seen through an instrument, at knots, and its derivatives.

A tissue with coefficients theta stands behind a frame of compliance c, so that its depth is ``w = x - c F``
with F its own force: F is the root of a scalar equation at every knot.  Between knots the tool moves
linearly.  So does the tip behind a rigid frame; behind another it leaves a knot at the speed that the force's
rate there leaves it and comes to the next on a parabola, for which the branch states are exact.  A straight
line would leave them late by half of what the speed changes from knot to knot.  What the load channel makes
of the force is in :mod:`tissueid.likelihood.load_channel`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
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
#: Newton steps for the force behind a frame, and the change, relative, that ends them: what is left after
#: it is less than its square.
NEWTON_STEPS = 40
NEWTON_DONE = 1e-7
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


@kernel()
def _law(
    static: tuple[float, float, float, float],
    stiffness: FloatArray,
    z: float,
    move: float,
    decayed: FloatArray,
    gains: FloatArray,
    i: int,
    k_now: FloatArray,
) -> tuple[float, float, float]:
    """Force, its slope by z with the states as they are, and that with the states following; K_j are written.

    ``gains[i]`` are those of the step: a row of its own would be made anew at every knot.
    """
    a, b, c, d = static
    force = a + z * (b + z * (c + z * d))
    slope = b + z * (2.0 * c + z * 3.0 * d)
    follow = 0.0
    for j in range(stiffness.shape[0]):
        value = 0.0
        rise = 0.0
        for k in range(stiffness.shape[1] - 1, -1, -1):
            rise = rise * z + value
            value = value * z + stiffness[j, k]
        state = decayed[j] + gains[i, j] * move
        k_now[j] = value
        force += value * state
        slope += rise * state
        follow += value * gains[i, j]
    return force, slope, slope + follow


@kernel()
def _coefficients(
    data: Packed, log: int, theta: FloatArray
) -> tuple[tuple[float, float, float, float], FloatArray]:
    """Static (4) and stiffness coefficients (branches, degree + 1) of one log, by powers of depth."""
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
    return (static[0], static[1], static[2], static[3]), stiffness


@kernel()
def _balanced(
    static: tuple[float, float, float, float],
    stiffness: FloatArray,
    x: float,
    w_old: float,
    delta: float,
    compliance: float,
    f: float,
    decayed: FloatArray,
    gains: FloatArray,
    i: int,
    k_now: FloatArray,
) -> tuple[float, float, float]:
    """Force of a tissue behind a frame, its depth, and its slope with the states as they are.

    Started from a force ``f``.  The slope is that before the last step, which is too small to change it.
    """
    w = x - compliance * f
    slope = 0.0
    for _ in range(NEWTON_STEPS):
        law, slope, tangent = _law(static, stiffness, w - delta, w - w_old, decayed, gains, i, k_now)
        if compliance == 0.0:
            return law, w, slope
        step = (law - f) / (1.0 + compliance * tangent)
        f += step
        w = x - compliance * f
        if abs(step) <= NEWTON_DONE * (1.0 + abs(f)):
            break
    return f, w, slope


@kernel()
def _direct(
    effects: tuple[bool, bool, bool], terms: tuple[int, int], gain: float, u: float, f: float, slope: float,
    state: FloatArray, kind: int, row: FloatArray,
) -> int:  # fmt: skip
    """What each parameter does to the force at a given depth and history; how many come before ln tau."""
    with_gain, with_offset, free = effects
    static, size = terms
    at = 0
    if with_gain:
        row[0] = f
        at = 1
    if with_offset:
        row[at] = -slope
        at += 1
    if free:
        power = 1.0
        for k in range(STATIC_TERMS):
            row[at + k] = power
            power *= u
        at += STATIC_TERMS
    if kind < TISSUE:
        return at
    power = gain * u
    for k in range(static):
        row[at + k] = power
        power *= u
    at += static
    for j in range(state.size):
        power = gain * state[j]
        for k in range(size):
            row[at + k] = power
            power *= u
        at += size
    return at


@kernel()
def _by_time(h: float, tau: float, a: float, phi: float, old: float, moved: float) -> float:
    """Derivative of a branch state by ln tau over one step, the state before held."""
    if h <= 0.0:
        return 0.0
    ratio = h / tau
    # (1 - a) tau/h - a loses all digits for h << tau; the series takes over
    dphi = phi - a if ratio > 1e-4 else ratio * (0.5 - ratio / 3.0)
    return a * ratio * old + dphi * moved


@kernel()
def _rates(
    before: float, after: float, slope: float, compliance: float,
    k_now: FloatArray, state: FloatArray, tau: FloatArray,
) -> tuple[float, float]:  # fmt: skip
    """Rates of force before and after a knot, from the tool's speeds and the branches that let go [N/s]."""
    loss = 0.0
    for j in range(state.size):
        slope += k_now[j]
        loss += k_now[j] * state[j] / tau[j]
    give = 1.0 / (1.0 + compliance * slope)
    return (slope * before - loss) * give, (slope * after - loss) * give


@kernel()
def _weights(time_s: FloatArray, tau: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights of every branch over the steps that end at the knots, each of shape (n, branches).

    Of its state before, of a move at constant speed, and of one whose speed grows from nothing.
    """
    a, phi, psi = np.zeros((3, time_s.size, tau.size))
    # before the first knot the tissue is at rest, wherever the tool is
    for i in range(1, time_s.size):
        for j in range(tau.size):
            h = time_s[i] - time_s[i - 1]
            ratio = h / tau[j]
            a[i, j], phi[i, j] = step_weights(h, tau[j])
            # 1 - phi loses all digits for h << tau; the series takes over
            psi[i, j] = 2.0 * (1.0 - phi[i, j]) / ratio if ratio > 1e-4 else 1.0 - ratio / 3.0
    return a, phi, psi


@kernel()
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
        Written: force, its rate before and its rate after each knot; after the last the tool goes on.
    columns : ndarray, shape (c, n)
        Written: derivatives by the effects of the log, by theta, by ln tau, as far as ``kind`` goes; of tips
        that move linearly between knots.
    """
    time_s = data.time_s[data.first[log] : data.first[log + 1]]
    depth_mm = data.depth_mm[data.first[log] : data.first[log + 1]]
    last = time_s.size - 1
    branches, delta, gain = data.branches, data.delta[log], np.exp(data.gamma[log])
    effects, terms = (data.gain, data.offset, data.free), (data.static, data.degree + 1)
    static, stiffness = _coefficients(data, log, theta)
    tau = np.exp(log_tau)
    weights, gains, bends = _weights(time_s, tau)
    total = columns.shape[0] if kind >= EFFECTS else 0
    state, old, decayed, k_now = np.zeros((4, branches))
    row, by_depth = np.zeros((2, max(total, 1)))
    by_state = np.zeros((branches, max(total, 1)))
    w = 0.0
    f = 0.0
    speed = 0.0
    for i in range(last + 1):
        h = time_s[i] - time_s[i - 1] if i > 0 else 0.0
        # how far the tip would go at the speed that it starts with
        straight = h * (speed - compliance * rates[2, i - 1]) if i > 0 else 0.0
        for j in range(branches):
            old[j] = state[j]
            decayed[j] = weights[i, j] * old[j] + (gains[i, j] - bends[i, j]) * straight
        w_old = w
        f, w, slope = _balanced(
            static, stiffness, depth_mm[i], w_old, delta, compliance, f, decayed, bends, i, k_now
        )
        tangent = slope
        for j in range(branches):
            state[j] = decayed[j] + bends[i, j] * (w - w_old)
            tangent += k_now[j] * gains[i, j]
        before = speed
        if i < last:
            speed = (depth_mm[i + 1] - depth_mm[i]) / (time_s[i + 1] - time_s[i])
        rates[0, i] = f
        rates[1, i], rates[2, i] = _rates(before, speed, slope, compliance, k_now, state, tau)
        if total == 0:
            continue
        times = _direct(effects, terms, gain, (w - delta) / data.scale, f, slope, state, kind, row)
        give = 1.0 / (1.0 + compliance * tangent)
        for q in range(total):
            value = row[q] if q < times else 0.0
            for j in range(branches):
                carried = weights[i, j] * by_state[j, q] - gains[i, j] * by_depth[q]
                if kind >= RELAXATION and q == times + j:
                    carried += _by_time(h, tau[j], weights[i, j], gains[i, j], old[j], w - w_old)
                by_state[j, q] = carried
                value += k_now[j] * carried
            value *= give
            columns[q, i] = value
            moved = -compliance * value
            for j in range(branches):
                by_state[j, q] += gains[i, j] * moved
            by_depth[q] = moved


@kernel()
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


@kernel()
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
