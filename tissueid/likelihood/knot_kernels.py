"""Compiled passes over knots: the sums of a log on them, the instrument's force at them, normal equations.

A tissue with coefficients theta stands behind a frame of compliance c, so that its depth is ``w = x - c F``
with F its own force: F is the root of a scalar equation at every knot.  The load channel answers with a
first-order low-pass and a delay.  Between knots the tool moves linearly, for which the branch states are
exact; the force is then a cubic (Hermite) in time, and the low-pass is exact for a rate of force that is
linear."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from tissueid.model.kernels import step_weights

__all__ = [
    "ALL", "EFFECTS", "INSTRUMENT", "RELAXATION", "TISSUE", "Packed", "accumulate", "corner_flags",
    "instrument_force", "log_terms", "without_effects",
]  # fmt: skip

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Which columns are wanted; each kind has those before it.
EFFECTS, TISSUE, RELAXATION, ALL = 0, 1, 2, 3
#: Skew, filter and compliance, in this order.
INSTRUMENT = 3
#: Steps of their difference quotients [s, s, mm/N].
SKEW_STEP, FILTER_STEP, COMPLIANCE_STEP = 1e-5, 1e-5, 1e-7
#: Newton steps for the force behind a frame, and the change, relative, that ends them.
NEWTON_STEPS = 40
NEWTON_DONE = 1e-13
#: A memory of the moving average below this is none.
FORGOTTEN = 1e-9
#: Static polynomial: constant to cube.
STATIC_TERMS = 4
MAX_BRANCHES = 3


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
def corner_flags(time_s: FloatArray, depth_mm: FloatArray, tolerance_mm: float) -> NDArray[np.bool_]:
    """Samples between which the depth is linear to a tolerance (Ramer 1972, Douglas & Peucker 1973).

    Parameters
    ----------
    time_s, depth_mm : ndarray, shape (n,)
    tolerance_mm : float
        Largest deviation in depth.

    Returns
    -------
    ndarray of bool, shape (n,)
        Both ends included.
    """
    n = time_s.size
    keep = np.zeros(n, dtype=np.bool_)
    keep[0] = True
    keep[n - 1] = True
    stack = np.empty((n, 2), dtype=np.int64)
    stack[0, 0] = 0
    stack[0, 1] = n - 1
    used = 1
    while used > 0:
        used -= 1
        low = stack[used, 0]
        high = stack[used, 1]
        span = time_s[high] - time_s[low]
        if high - low < 2 or span <= 0.0:
            continue
        slope = (depth_mm[high] - depth_mm[low]) / span
        worst = tolerance_mm
        at = -1
        for i in range(low + 1, high):
            away = abs(depth_mm[i] - depth_mm[low] - slope * (time_s[i] - time_s[low]))
            if away > worst:
                worst = away
                at = i
        if at >= 0:
            keep[at] = True
            stack[used, 0] = low
            stack[used, 1] = at
            stack[used + 1, 0] = at
            stack[used + 1, 1] = high
            used += 2
    return keep


@nb.njit(cache=True, nogil=True, error_model="numpy")
def accumulate(
    time_s: FloatArray,
    residual_N: FloatArray,
    include: NDArray[np.bool_],
    linked: NDArray[np.bool_],
    knot_s: FloatArray,
    phi: float,
    reference_step_s: float,
    moving_average: float,
) -> tuple[FloatArray, FloatArray, float]:
    """Whitened sums of hat functions and residual over the samples of one log.

    Parameters
    ----------
    time_s, residual_N : ndarray, shape (n,)
    include, linked : ndarray of bool, shape (n,)
        Samples that take part, and those that continue the chain of the sample before.
    knot_s : ndarray, shape (m,)
        Strictly growing, from the first to the last sample.
    phi, reference_step_s, moving_average : float
        See :class:`tissueid.uncertainty.NoiseFit`.

    Returns
    -------
    gram : ndarray, shape (m, m)
        H'R^-1 H, upper triangle.
    pull : ndarray, shape (m,)
        H'R^-1 e.
    square : float
        e'R^-1 e.
    """
    n, m = time_s.size, knot_s.size
    gram = np.zeros((m, m))
    pull = np.zeros(m)
    before = np.zeros(m)  # the filtered hats of the last sample, from low to high
    now = np.zeros(m)
    low = 0
    high = -1
    last = 0.0
    square = 0.0
    j = 0
    for i in range(n):
        if not include[i]:
            continue
        while j < m - 2 and time_s[i] > knot_s[j + 1]:
            j += 1
        share = (time_s[i] - knot_s[j]) / (knot_s[j + 1] - knot_s[j])
        rho = 0.0
        average = 0.0
        if linked[i]:
            average = moving_average
            if phi > 0.0:
                rho = phi ** ((time_s[i] - time_s[i - 1]) / reference_step_s)
        else:
            before[low : high + 1] = 0.0
            last = 0.0
            low = j
        while low < j and abs(before[low]) < FORGOTTEN:
            before[low] = 0.0
            low += 1
        high = j + 1
        weight = 1.0 / (1.0 - rho * rho)
        e = residual_N[i] + average * last
        fresh_e = e - rho * last
        last = e
        square += weight * fresh_e * fresh_e
        for k in range(low, high + 1):
            value = average * before[k]
            if k == j:
                value += 1.0 - share
            elif k == j + 1:
                value += share
            now[k] = value - rho * before[k]
            before[k] = value
        for k in range(low, high + 1):
            fresh = weight * now[k]
            pull[k] += fresh * fresh_e
            for q in range(k, high + 1):
                gram[k, q] += fresh * now[q]
    return gram, pull, square


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
def _path(
    data: Packed,
    log: int,
    theta: FloatArray,
    log_tau: FloatArray,
    compliance: float,
    kind: int,
    force: FloatArray,
    left: FloatArray,
    right: FloatArray,
    columns: FloatArray,
) -> None:
    """Force of the tissue behind a frame at the knots of one log, its rates on both sides, its derivatives.

    ``kind < 0`` leaves out the derivatives; otherwise ``columns`` gets those by the effects of the log, then
    by theta, then by ln tau, as far as ``kind`` goes.
    """
    begin = data.first[log]
    n = data.first[log + 1] - begin
    branches, size = data.branches, data.degree + 1
    gain = np.exp(data.gamma[log])
    delta = data.delta[log]
    static = np.zeros(STATIC_TERMS)
    unit = np.ones(STATIC_TERMS)
    for k in range(STATIC_TERMS):
        unit[k] = data.scale**-k
        static[k] = data.own[log, k] * unit[k]
        if data.static > 0 and k > 0:
            static[k] += gain * theta[k - 1] * unit[k]
    stiffness = np.zeros((branches, size))
    for j in range(branches):
        for k in range(size):
            stiffness[j, k] = gain * theta[data.static + j * size + k] * unit[k]
    tau = np.exp(log_tau)
    effects = _effect_count(data)
    p = theta.size if kind >= TISSUE else 0
    total = effects + p + (branches if kind >= RELAXATION else 0) if kind >= 0 else 0
    state = np.zeros(branches)
    old = np.zeros(branches)
    decayed = np.zeros(branches)
    a = np.ones(branches)
    phi = np.ones(branches)
    k_now = np.zeros(branches)
    by_state = np.zeros((branches, max(total, 1)))
    by_depth = np.zeros(max(total, 1))
    explicit = np.zeros((branches, max(total, 1)))
    row = np.zeros(max(total, 1))
    w = 0.0
    f = 0.0
    for i in range(n):
        x = data.depth_mm[begin + i]
        h = 0.0
        w_old = w
        for j in range(branches):
            old[j] = state[j]
            if i > 0:
                h = data.time_s[begin + i] - data.time_s[begin + i - 1]
                a[j], phi[j] = step_weights(h, tau[j])
            else:
                # at rest at the first knot, wherever it is
                a[j] = 0.0
                phi[j] = 0.0
            decayed[j] = a[j] * old[j]
        tangent = 0.0
        for _ in range(NEWTON_STEPS):
            w = x - compliance * f
            law, slope = _law(static, stiffness, w - delta, w - w_old, decayed, phi, state, k_now)
            tangent = slope
            for j in range(branches):
                tangent += k_now[j] * phi[j]
            step = (law - f) / (1.0 + compliance * tangent)
            f += step
            if compliance == 0.0 or abs(step) <= NEWTON_DONE * (1.0 + abs(f)):
                break
        if compliance != 0.0:
            w = x - compliance * f
            law, slope = _law(static, stiffness, w - delta, w - w_old, decayed, phi, state, k_now)
        force[i] = f
        # rates of force: tool speed on either side, branches that let go
        sudden = slope
        loss = 0.0
        for j in range(branches):
            sudden += k_now[j]
            loss += k_now[j] * state[j] / tau[j]
        give = 1.0 + compliance * sudden
        left[i] = 0.0
        right[i] = 0.0
        if i > 0:
            span = data.time_s[begin + i] - data.time_s[begin + i - 1]
            left[i] = (sudden * (x - data.depth_mm[begin + i - 1]) / span - loss) / give
        if i < n - 1:
            span = data.time_s[begin + i + 1] - data.time_s[begin + i]
            right[i] = (sudden * (data.depth_mm[begin + i + 1] - x) / span - loss) / give
        if total == 0:
            continue
        # what each parameter does to the force at a given depth and history
        z = w - delta
        u = z / data.scale
        row[:] = 0.0
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
        if p > 0:
            power = gain * u
            for k in range(data.static):
                row[at + k] = power
                power *= u
            for j in range(branches):
                power = gain * state[j]
                for k in range(size):
                    row[at + data.static + j * size + k] = power
                    power *= u
        if kind >= RELAXATION and h > 0.0:
            # the columns of other parameters stay zero
            for j in range(branches):
                ratio = h / tau[j]
                da = a[j] * ratio
                # (1 - a) tau/h - a loses all digits for h << tau; the series takes over
                dphi = phi[j] - a[j] if ratio > 1e-4 else ratio * (0.5 - ratio / 3.0)
                explicit[j, at + p + j] = da * old[j] + dphi * (w - w_old)
        if compliance == 0.0:
            # a rigid frame: the depth is known, and states depend on nothing but ln tau
            for q in range(total):
                columns[q, i] = row[q]
            for j in range(branches):
                if kind >= RELAXATION:
                    q = at + p + j
                    by_state[j, q] = a[j] * by_state[j, q] + explicit[j, q]
                    columns[q, i] = k_now[j] * by_state[j, q]
            continue
        divide = 1.0 / (1.0 + compliance * tangent)
        for q in range(total):
            value = row[q]
            for j in range(branches):
                value += k_now[j] * (a[j] * by_state[j, q] - phi[j] * by_depth[q] + explicit[j, q])
            value *= divide
            columns[q, i] = value
            moved = -compliance * value
            for j in range(branches):
                by_state[j, q] = a[j] * by_state[j, q] + phi[j] * (moved - by_depth[q]) + explicit[j, q]
            by_depth[q] = moved


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _effect_count(data: Packed) -> int:
    count = 0
    if data.gain:
        count += 1
    if data.offset:
        count += 1
    if data.free:
        count += STATIC_TERMS
    return count


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _lag(lag: float, start: float, end: float, span: float, elapsed: float, filter_s: float) -> float:
    """How far the low-pass is behind, for a rate of force that goes from ``start`` to ``end`` over a span."""
    ratio = elapsed / filter_s
    keep = math.exp(-ratio)
    lost = -filter_s * math.expm1(-ratio)
    bend = (end - start) / span
    return keep * lag + start * lost + bend * filter_s * (elapsed - lost)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _respond(
    time_s: FloatArray,
    force: FloatArray,
    left: FloatArray,
    right: FloatArray,
    columns: FloatArray,
    total: int,
    skew_s: float,
    filter_s: float,
    y: FloatArray,
    answers: FloatArray,
) -> None:
    """What the load channel shows at the knots: low-passed, and later by ``skew_s``.

    Derivatives are taken as linear between knots.
    """
    n = time_s.size
    lag = np.zeros(n)
    lags = np.zeros((max(total, 1), n))
    filtered = filter_s > 0.0
    if filtered:
        for i in range(1, n):
            h = time_s[i] - time_s[i - 1]
            lag[i] = _lag(lag[i - 1], right[i - 1], left[i], h, h, filter_s)
            ratio = h / filter_s
            keep = np.exp(-ratio)
            mean = -np.expm1(-ratio) / ratio
            for q in range(total):
                lags[q, i] = keep * lags[q, i - 1] + mean * (columns[q, i] - columns[q, i - 1])
    j = 0
    for i in range(n):
        at = time_s[i] - skew_s
        while j < n - 2 and time_s[j + 1] <= at:
            j += 1
        if skew_s == 0.0:
            y[i] = force[i] - lag[i]
            for q in range(total):
                answers[q, i] = columns[q, i] - lags[q, i]
            continue
        if at <= time_s[0]:
            y[i] = force[0]
            for q in range(total):
                answers[q, i] = columns[q, 0]
            continue
        h = time_s[j + 1] - time_s[j]
        elapsed = at - time_s[j]
        s = elapsed / h
        if s > 1.0:
            # beyond the last knot the force goes on as it did
            more = elapsed - h
            y[i] = force[n - 1] + left[n - 1] * more
            if filtered:
                y[i] -= _lag(lag[n - 1], left[n - 1], left[n - 1], 1.0, more, filter_s)
            for q in range(total):
                answers[q, i] = columns[q, n - 1] - lags[q, n - 1]
            continue
        rise = force[j + 1] - force[j]
        bend = h * right[j] - rise
        twist = rise - h * left[j + 1]
        y[i] = force[j] + s * (rise + (1.0 - s) * (bend * (1.0 - s) + twist * s))
        keep = 0.0
        mean = 0.0
        if filtered:
            y[i] -= _lag(lag[j], right[j], left[j + 1], h, elapsed, filter_s)
            ratio = elapsed / filter_s
            keep = np.exp(-ratio)
            mean = -np.expm1(-ratio) * filter_s / h
        for q in range(total):
            step = columns[q, j + 1] - columns[q, j]
            answers[q, i] = columns[q, j] + s * step - keep * lags[q, j] - mean * step


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
        _path(data, log, theta, log_tau, instrument[2], -1, rates[0], rates[1], rates[2], none)
        _respond(
            data.time_s[begin:end], rates[0], rates[1], rates[2], none, 0,
            instrument[0], instrument[1], out[begin:end], none,
        )  # fmt: skip
    return out


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _times_band(band: FloatArray, v: FloatArray, out: FloatArray) -> None:
    """Product of a symmetric band matrix with a vector."""
    n, width = band.shape
    for k in range(n):
        out[k] = band[k, 0] * v[k]
    for d in range(1, width):
        for k in range(n - d):
            out[k] += band[k, d] * v[k + d]
            out[k + d] += band[k, d] * v[k]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def log_terms(
    data: Packed, theta: FloatArray, log_tau: FloatArray, instrument: FloatArray, kind: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sum of squares of every log and its normal equations, on knots alone.

    Parameters
    ----------
    data : Packed
    theta, log_tau, instrument
        As in :func:`instrument_force`.
    kind : int
        :data:`EFFECTS`, :data:`TISSUE` (and theta), :data:`RELAXATION` (and ln tau) or :data:`ALL` (and skew,
        filter, compliance).

    Returns
    -------
    gram : ndarray, shape (logs, v, v)
        C'R^-1 C; columns are the effects of the log, theta, ln tau, instrument.
    pull : ndarray, shape (logs, v)
        C'R^-1 of what the model leaves.
    square : ndarray, shape (logs,)
        Sum of squares of what it leaves [N^2].
    """
    logs = data.first.size - 1
    total = _effect_count(data)
    if kind >= TISSUE:
        total += theta.size
    if kind >= RELAXATION:
        total += log_tau.size
    columns = total + (INSTRUMENT if kind >= ALL else 0)
    gram = np.zeros((logs, columns, columns))
    pull = np.zeros((logs, columns))
    square = np.zeros(logs)
    none = np.zeros((1, 1))
    for log in range(logs):
        begin, end = data.first[log], data.first[log + 1]
        n = end - begin
        rates = np.empty((3, n))
        y = np.empty(n)
        time_s = data.time_s[begin:end]
        tissue = np.empty((total, n))
        shown = np.empty((columns, n))
        _path(data, log, theta, log_tau, instrument[2], kind, rates[0], rates[1], rates[2], tissue)
        _respond(
            time_s, rates[0], rates[1], rates[2], tissue, total, instrument[0], instrument[1], y, shown
        )  # fmt: skip
        for which in range(columns - total):
            moved = instrument.copy()
            step = SKEW_STEP if which == 0 else FILTER_STEP if which == 1 else COMPLIANCE_STEP
            moved[which] += step
            if which == INSTRUMENT - 1:
                _path(data, log, theta, log_tau, moved[2], -1, rates[0], rates[1], rates[2], none)
            other = shown[total + which]
            _respond(time_s, rates[0], rates[1], rates[2], none, 0, moved[0], moved[1], other, none)
            for k in range(n):
                other[k] = (other[k] - y[k]) / step
        band = data.band[begin:end]
        change = y - data.base[begin:end]
        left = np.empty(n)
        _times_band(band, change, left)
        left = data.pull[begin:end] - left
        square[log] = data.square[log]
        for k in range(n):
            square[log] -= change[k] * (data.pull[begin + k] + left[k])
        whitened = np.empty((columns, n))
        for q in range(columns):
            _times_band(band, shown[q], whitened[q])
        pull[log] = shown @ left
        gram[log] = shown @ whitened.T
    return gram, pull, square


@nb.njit(cache=True, nogil=True, error_model="numpy")
def without_effects(
    gram: FloatArray,
    pull: FloatArray,
    square: FloatArray,
    weight: FloatArray,
    precision: FloatArray,
    mean: FloatArray,
    sigma2: float,
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Integrate the effects of every log.

    Parameters
    ----------
    gram, pull, square
        From :func:`log_terms`.
    weight : ndarray, shape (logs,)
        Weight of each log; 1 for all but a bootstrap.
    precision, mean : ndarray, shape (logs, q)
        Prior of the effects, counted from where they are linearised.
    sigma2 : float
        Noise variance [N^2].

    Returns
    -------
    curvature : ndarray, shape (v, v)
    slope : ndarray, shape (v,)
        The log likelihood is ``constant + slope'd - d'curvature d / 2`` for a change d.
    value : float
        That constant, up to the noise's own terms.
    back : ndarray, shape (logs, q, v + 1)
        Mean of the effects: ``back[:, :, v] - back[:, :, :v] @ d``.
    """
    logs, columns = pull.shape
    q = precision.shape[1]
    v = columns - q
    curvature = np.zeros((v, v))
    slope = np.zeros(v)
    back = np.zeros((logs, q, v + 1))
    value = 0.0
    low = np.zeros((q, q))
    for log in range(logs):
        scale = weight[log] / sigma2
        value -= 0.5 * scale * square[log]
        for i in range(v):
            slope[i] += scale * pull[log, q + i]
            for j in range(v):
                curvature[i, j] += scale * gram[log, q + i, q + j]
        x = np.empty((q, v + 1))
        for i in range(q):
            pulled = weight[log] * precision[log, i] * mean[log, i]
            value -= 0.5 * pulled * mean[log, i]
            x[i, v] = scale * pull[log, i] + pulled
            for j in range(v):
                x[i, j] = scale * gram[log, i, q + j]
            for j in range(i + 1):
                entry = scale * gram[log, i, j]
                if i == j:
                    entry += weight[log] * precision[log, i]
                for k in range(j):
                    entry -= low[i, k] * low[j, k]
                low[i, j] = np.sqrt(entry) if i == j else entry / low[j, j]
            value -= np.log(low[i, i]) - 0.5 * np.log(precision[log, i])
            for k in range(i):
                x[i] -= low[i, k] * x[k]
            x[i] /= low[i, i]
        for i in range(q):
            value += 0.5 * x[i, v] * x[i, v]
            for j in range(v):
                slope[j] -= x[i, j] * x[i, v]
                for k in range(v):
                    curvature[j, k] -= x[i, j] * x[i, k]
        for i in range(q - 1, -1, -1):
            for k in range(i + 1, q):
                x[i] -= low[k, i] * x[k]
            x[i] /= low[i, i]
        back[log] = x
    return curvature, slope, value, back
