"""Compiled force of a tissue behind its instrument at many points side by side.

The same arithmetic as :mod:`tissueid.likelihood.instrument_kernels`, where it is explained, :data:`LANES`
points at a time (:mod:`tissueid.likelihood.lanes`).  Every number of a point has a place of its own in one
flat room, a multiple of :data:`LANES` from its neighbours: only where the distances are known when the loops
are compiled do they become vector instructions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.instrument_kernels import (
    NEWTON_DONE,
    NEWTON_STEPS,
    RELAXATION,
    STATIC_TERMS,
    TISSUE,
    Packed,
)
from tissueid.likelihood.lanes import LANES, decays

__all__ = ["tissue_paths"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# -- places in the room of a point: the tissue's law, where it stands, and what Newton's method works on
_STATIC = 0
_DELTA = 4 * LANES
_GAIN = 5 * LANES
_COMPLIANCE = 6 * LANES
_FORCE = 7 * LANES
_DEPTH = 8 * LANES
_BEFORE = 9 * LANES
_Z = 10 * LANES
_MOVE = 11 * LANES
_LAW = 12 * LANES
_SLOPE = 13 * LANES
_FOLLOW = 14 * LANES
_VALUE = 15 * LANES
_RISE = 16 * LANES
_HELD = 17 * LANES
_OPEN = 18 * LANES
_TANGENT = 19 * LANES
_LOSS = 20 * LANES
_STIFF = 21 * LANES
_RATE = 22 * LANES
_STRAIGHT = 23 * LANES
_GIVE = 24 * LANES
_U = 25 * LANES
_ROOM = 26 * LANES
# -- places in the room of a branch
_TAU = 0
_RATIO = 1 * LANES
_KEPT = 2 * LANES
_MOVED = 3 * LANES
_BENT = 4 * LANES
_OLD = 5 * LANES
_DECAYED = 6 * LANES
_STATE = 7 * LANES
_K = 8 * LANES
_NEW_K = 9 * LANES
_BY_TIME = 10 * LANES
_ARM = 11 * LANES


@kernel(fastmath={"contract"})
def _begin(
    data: Packed, log: int, theta: FloatArray, tau: FloatArray, compliance: FloatArray, gamma: FloatArray,
    delta: FloatArray, room: FloatArray, arms: FloatArray, stiffness: FloatArray,
) -> None:  # fmt: skip
    """Fill the rooms with the law of one log and a tissue at rest; stiffness by powers of depth."""
    room[:] = 0.0
    arms[:] = 0.0
    for v in range(LANES):
        room[_GAIN + v] = np.exp(gamma[log, v])
        room[_DELTA + v] = delta[log, v]
        room[_COMPLIANCE + v] = compliance[v]
    for k in range(STATIC_TERMS):
        power = data.scale**-k
        for v in range(LANES):
            value = data.own[log, k]
            if data.static > 0 and k > 0:
                value += room[_GAIN + v] * theta[k - 1, v]
            room[_STATIC + k * LANES + v] = value * power
    size = data.degree + 1
    for j in range(data.branches):
        for v in range(LANES):
            arms[j * _ARM + _TAU + v] = tau[j, v]
        for k in range(size):
            power = data.scale**-k
            for v in range(LANES):
                value = theta[data.static + j * size + k, v]
                stiffness[(j * size + k) * LANES + v] = room[_GAIN + v] * value * power


@kernel(fastmath={"contract"})
def _weigh(
    h: float, at: int, arms: FloatArray, ratio: FloatArray, kept: FloatArray, lost: FloatArray,
    power: FloatArray, bits: IntArray,
) -> None:  # fmt: skip
    """Weights of one branch over one step, and what its state is worth to ln tau."""
    for v in range(LANES):
        ratio[v] = h / arms[at + _TAU + v]
    decays(ratio, kept, lost, power, bits)
    for v in range(LANES):
        share = ratio[v]
        near = 0.5 * share
        phi = lost[v] / share
        # 1 - phi loses all digits for h << tau; the series takes over
        bent = 2.0 * (1.0 - phi) / share
        bent = bent if share > 1e-4 else 1.0 - share / 3.0
        by_time = phi - kept[v]
        by_time = by_time if share > 1e-4 else near - share * share / 3.0
        arms[at + _RATIO + v] = share
        arms[at + _KEPT + v] = kept[v]
        arms[at + _MOVED + v] = phi
        arms[at + _BENT + v] = bent
        arms[at + _BY_TIME + v] = by_time


@kernel(fastmath={"contract"})
def _law(branches: int, size: int, room: FloatArray, arms: FloatArray, stiffness: FloatArray) -> None:
    """Force, its slope by depth with the states as they are, and what the states add to it."""
    for v in range(LANES):
        z = room[_DEPTH + v] - room[_DELTA + v]
        a = room[_STATIC + v]
        b = room[_STATIC + LANES + v]
        c = room[_STATIC + 2 * LANES + v]
        d = room[_STATIC + 3 * LANES + v]
        room[_Z + v] = z
        room[_MOVE + v] = room[_DEPTH + v] - room[_BEFORE + v]
        room[_LAW + v] = a + z * (b + z * (c + z * d))
        room[_SLOPE + v] = b + z * (2.0 * c + z * 3.0 * d)
        room[_FOLLOW + v] = 0.0
    for j in range(branches):
        arm = j * _ARM
        top = (j * size + size - 1) * LANES
        for v in range(LANES):
            room[_VALUE + v] = stiffness[top + v]
            room[_RISE + v] = 0.0
        for k in range(size - 1):
            at = top - (k + 1) * LANES
            for v in range(LANES):
                value = room[_VALUE + v]
                room[_RISE + v] = room[_RISE + v] * room[_Z + v] + value
                room[_VALUE + v] = value * room[_Z + v] + stiffness[at + v]
        for v in range(LANES):
            value = room[_VALUE + v]
            state = arms[arm + _DECAYED + v] + arms[arm + _BENT + v] * room[_MOVE + v]
            arms[arm + _NEW_K + v] = value
            room[_LAW + v] += value * state
            room[_SLOPE + v] += room[_RISE + v] * state
            room[_FOLLOW + v] += value * arms[arm + _BENT + v]


@kernel(fastmath={"contract"})
def _balance(
    x: float, branches: int, size: int, room: FloatArray, arms: FloatArray, stiffness: FloatArray
) -> None:
    """Force, depth, slope and stiffness behind the frame, each point by Newton's method until it is there."""
    for v in range(LANES):
        room[_DEPTH + v] = x - room[_COMPLIANCE + v] * room[_FORCE + v]
        room[_OPEN + v] = 1.0
    for _ in range(NEWTON_STEPS):
        _law(branches, size, room, arms, stiffness)
        for j in range(branches):
            arm = j * _ARM
            for v in range(LANES):
                now = arms[arm + _NEW_K + v]
                arms[arm + _K + v] = now if room[_OPEN + v] > 0.0 else arms[arm + _K + v]
        left = 0.0
        for v in range(LANES):
            c = room[_COMPLIANCE + v]
            f = room[_FORCE + v]
            still = room[_OPEN + v]
            law = room[_LAW + v]
            step = (law - f) / (1.0 + c * (room[_SLOPE + v] + room[_FOLLOW + v]))
            rigid = c == 0.0
            there = law if rigid else f + step
            size_of = step if step > 0.0 else -step
            reach = there if there > 0.0 else -there
            more = 0.0 if size_of <= NEWTON_DONE * (1.0 + reach) else 1.0
            more = 0.0 if rigid else more
            f = there if still > 0.0 else f
            room[_HELD + v] = room[_SLOPE + v] if still > 0.0 else room[_HELD + v]
            room[_FORCE + v] = f
            room[_DEPTH + v] = x - c * f
            room[_OPEN + v] = still * more
        for v in range(LANES):
            left += room[_OPEN + v]
        if left == 0.0:
            break


@kernel(fastmath={"contract"})
def _leave(
    before: float, after: float, i: int, branches: int, room: FloatArray, arms: FloatArray, rates: FloatArray
) -> None:
    """States and slopes at a knot; force and its rates on both sides are written."""
    for v in range(LANES):
        room[_TANGENT + v] = room[_HELD + v]
        room[_STIFF + v] = room[_HELD + v]
        room[_LOSS + v] = 0.0
        room[_MOVE + v] = room[_DEPTH + v] - room[_BEFORE + v]
    for j in range(branches):
        arm = j * _ARM
        for v in range(LANES):
            k = arms[arm + _K + v]
            state = arms[arm + _DECAYED + v] + arms[arm + _BENT + v] * room[_MOVE + v]
            arms[arm + _STATE + v] = state
            room[_TANGENT + v] += k * arms[arm + _MOVED + v]
            room[_STIFF + v] += k
            room[_LOSS + v] += k * state / arms[arm + _TAU + v]
    for v in range(LANES):
        c = room[_COMPLIANCE + v]
        give = 1.0 / (1.0 + c * room[_STIFF + v])
        rates[0, i, v] = room[_FORCE + v]
        rates[1, i, v] = (room[_STIFF + v] * before - room[_LOSS + v]) * give
        rates[2, i, v] = (room[_STIFF + v] * after - room[_LOSS + v]) * give
    for v in range(LANES):
        room[_RATE + v] = rates[2, i, v]
        room[_GIVE + v] = 1.0 / (1.0 + room[_COMPLIANCE + v] * room[_TANGENT + v])


@kernel(fastmath={"contract"})
def _direct(data: Packed, kind: int, room: FloatArray, arms: FloatArray, row: FloatArray) -> int:
    """What each parameter does to the force at a given depth and history; how many come before ln tau."""
    at = 0
    for v in range(LANES):
        room[_U + v] = (room[_DEPTH + v] - room[_DELTA + v]) / data.scale
    if data.gain:
        for v in range(LANES):
            row[v] = room[_FORCE + v]
        at = 1
    if data.offset:
        for v in range(LANES):
            row[at * LANES + v] = -room[_HELD + v]
        at += 1
    if data.free:
        for v in range(LANES):
            row[at * LANES + v] = 1.0
        for k in range(1, STATIC_TERMS):
            for v in range(LANES):
                row[(at + k) * LANES + v] = row[(at + k - 1) * LANES + v] * room[_U + v]
        at += STATIC_TERMS
    if kind < TISSUE:
        return at
    for k in range(data.static):
        for v in range(LANES):
            power = room[_GAIN + v] if k == 0 else row[(at + k - 1) * LANES + v]
            row[(at + k) * LANES + v] = power * room[_U + v]
    at += data.static
    for j in range(data.branches):
        for v in range(LANES):
            row[at * LANES + v] = room[_GAIN + v] * arms[j * _ARM + _STATE + v]
        for k in range(1, data.degree + 1):
            for v in range(LANES):
                row[(at + k) * LANES + v] = row[(at + k - 1) * LANES + v] * room[_U + v]
        at += data.degree + 1
    return at


@kernel(fastmath={"contract"})
def _derive(
    i: int, times: int, total: int, branches: int, kind: int, room: FloatArray, arms: FloatArray,
    row: FloatArray, by_depth: FloatArray, by_state: FloatArray, columns: FloatArray,
) -> None:  # fmt: skip
    """Derivatives at one knot, through depth and history; they are written and carried on."""
    for q in range(total):
        own = q * LANES
        if q >= times:
            for v in range(LANES):
                row[own + v] = 0.0
        for j in range(branches):
            arm, at = j * _ARM, (q * branches + j) * LANES
            for v in range(LANES):
                carried = (
                    arms[arm + _KEPT + v] * by_state[at + v] - arms[arm + _MOVED + v] * by_depth[own + v]
                )
                by_state[at + v] = carried
            if kind >= RELAXATION and q == times + j:
                for v in range(LANES):
                    lost = arms[arm + _KEPT + v] * arms[arm + _RATIO + v] * arms[arm + _OLD + v]
                    by_state[at + v] += lost + arms[arm + _BY_TIME + v] * room[_MOVE + v]
            for v in range(LANES):
                row[own + v] += arms[arm + _K + v] * by_state[at + v]
        for v in range(LANES):
            value = row[own + v] * room[_GIVE + v]
            columns[q, i, v] = value
            by_depth[own + v] = -room[_COMPLIANCE + v] * value
        for j in range(branches):
            arm, at = j * _ARM, (q * branches + j) * LANES
            for v in range(LANES):
                by_state[at + v] += arms[arm + _MOVED + v] * by_depth[own + v]


@kernel(fastmath={"contract"})
def tissue_paths(
    data: Packed, log: int, theta: FloatArray, tau: FloatArray, compliance: FloatArray, gamma: FloatArray,
    delta: FloatArray, kind: int, rates: FloatArray, columns: FloatArray,
) -> None:  # fmt: skip
    """:func:`tissueid.likelihood.instrument_kernels.tissue_path` of :data:`LANES` points.

    Parameters
    ----------
    data : Packed
        Its ``gamma`` and ``delta`` are not looked at.
    log : int
    theta, tau, compliance : ndarray, shape (p, LANES), (branches, LANES) and (LANES,)
        Relaxation times [s] and the frame's compliance [mm/N] of every point.
    gamma, delta : ndarray, shape (logs, LANES)
    kind : int
        :data:`RELAXATION` at the most.
    rates : ndarray, shape (3, n, LANES)
        Written.
    columns : ndarray, shape (c, n, LANES)
        Written.
    """
    begin, end = data.first[log], data.first[log + 1]
    last = end - begin - 1
    branches, size, total = data.branches, data.degree + 1, columns.shape[0]
    room, arms = np.empty(_ROOM), np.empty(max(branches, 1) * _ARM)
    stiffness = np.empty(max(branches * size, 1) * LANES)
    ratio, kept, lost, power = np.empty(LANES), np.empty(LANES), np.empty(LANES), np.empty(LANES)
    bits = power.view(np.int64)
    row, by_depth = np.zeros(max(total, 1) * LANES), np.zeros(max(total, 1) * LANES)
    by_state = np.zeros(max(total * branches, 1) * LANES)
    _begin(data, log, theta, tau, compliance, gamma, delta, room, arms, stiffness)
    speed = 0.0
    for i in range(last + 1):
        at = begin + i
        h = data.time_s[at] - data.time_s[at - 1] if i > 0 else 0.0
        for v in range(LANES):
            # how far the tip would go at the speed that it starts with
            room[_STRAIGHT + v] = h * (speed - room[_COMPLIANCE + v] * room[_RATE + v])
            room[_BEFORE + v] = room[_DEPTH + v]
        for j in range(branches):
            arm = j * _ARM
            if i > 0:
                _weigh(h, arm, arms, ratio, kept, lost, power, bits)
            for v in range(LANES):
                old = arms[arm + _STATE + v]
                ahead = (arms[arm + _MOVED + v] - arms[arm + _BENT + v]) * room[_STRAIGHT + v]
                arms[arm + _OLD + v] = old
                arms[arm + _DECAYED + v] = arms[arm + _KEPT + v] * old + ahead
        _balance(data.depth_mm[at], branches, size, room, arms, stiffness)
        before = speed
        if i < last:
            speed = (data.depth_mm[at + 1] - data.depth_mm[at]) / (data.time_s[at + 1] - data.time_s[at])
        _leave(before, speed, i, branches, room, arms, rates)
        if total:
            times = _direct(data, kind, room, arms, row)
            _derive(i, times, total, branches, kind, room, arms, row, by_depth, by_state, columns)
