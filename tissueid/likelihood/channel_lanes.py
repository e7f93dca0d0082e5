"""Compiled answer of a load channel at many points side by side.

The same arithmetic as :mod:`tissueid.likelihood.load_channel`, :data:`LANES` points at a time
(:mod:`tissueid.likelihood.lanes`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.lanes import LANES, decays

__all__ = ["channels"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: A filter below this is none [s].
NO_FILTER = 1e-300
# -- places in the room of a point
_ELAPSED = 0
_SPAN = 1 * LANES
_NOW = 2 * LANES
_NEXT = 3 * LANES
_START = 4 * LANES
_END = 5 * LANES
_LAG = 6 * LANES
_LOST = 7 * LANES
_FILTER = 8 * LANES
_SHARE = 9 * LANES
_SHOWN = 10 * LANES
_SKEW = 11 * LANES
_ROOM = 12 * LANES


@kernel(fastmath={"contract"})
def _lag(room: FloatArray) -> None:
    """How far the low-pass is behind some time after a knot; see ``load_channel._lag``."""
    for v in range(LANES):
        span, elapsed, filter_s = room[_SPAN + v], room[_ELAPSED + v], room[_FILTER + v]
        start, end, lost = room[_START + v], room[_END + v], room[_LOST + v]
        mean = (room[_NEXT + v] - room[_NOW + v]) / span
        linear = (6.0 * mean - 4.0 * start - 2.0 * end) / span
        square = 3.0 * (start + end - 2.0 * mean) / (span * span)
        of_one = filter_s * lost
        of_time = filter_s * (elapsed - of_one)
        of_square = filter_s * (elapsed * elapsed - 2.0 * of_time)
        room[_LAG + v] = (
            (1.0 - lost) * room[_LAG + v] + start * of_one + linear * of_time + square * of_square
        )


@kernel(fastmath={"contract"})
def _lags(
    time_s: FloatArray, begin: int, rates: FloatArray, room: FloatArray, lag: FloatArray, keep: FloatArray,
    mean: FloatArray, work: tuple[FloatArray, FloatArray, FloatArray, FloatArray, IntArray],
) -> None:  # fmt: skip
    """How far the low-pass is behind the force at the knots, and what each step leaves of that."""
    ratio, kept, lost, power, bits = work
    for v in range(LANES):
        lag[0, v] = 0.0
        room[_LAG + v] = 0.0
    for i in range(1, lag.shape[0]):
        h = time_s[begin + i] - time_s[begin + i - 1]
        for v in range(LANES):
            ratio[v] = h / room[_FILTER + v]
        decays(ratio, kept, lost, power, bits)
        for v in range(LANES):
            room[_NOW + v] = rates[0, i - 1, v]
            room[_NEXT + v] = rates[0, i, v]
        for v in range(LANES):
            room[_START + v] = rates[2, i - 1, v]
            room[_END + v] = rates[1, i, v]
        for v in range(LANES):
            room[_LOST + v] = lost[v]
            room[_SPAN + v] = h
            room[_ELAPSED + v] = h
        _lag(room)
        for v in range(LANES):
            lag[i, v] = room[_LAG + v]
            keep[i, v] = 1.0 - room[_LOST + v]
            mean[i, v] = room[_LOST + v] * room[_FILTER + v] / h


@kernel(fastmath={"contract"})
def _shown(
    time_s: FloatArray, begin: int, rates: FloatArray, room: FloatArray, lag: FloatArray, where: IntArray,
    shares: FloatArray, y: FloatArray, work: tuple[FloatArray, FloatArray, FloatArray, FloatArray, IntArray],
) -> None:  # fmt: skip
    """Force that is shown at the knots; which knot that looks back to, and how it takes it, are written."""
    ratio, kept, lost, power, bits = work
    n = y.shape[0]
    first, last = time_s[begin], time_s[begin + n - 1]
    for v in range(LANES):
        where[0, v] = 0
    for i in range(n):
        for v in range(LANES):
            at = min(max(time_s[begin + i] - room[_SKEW + v], first), last)
            j = where[max(i - 1, 0), v]
            while j < n - 2 and time_s[begin + j + 1] <= at:
                j += 1
            where[i, v] = j
            room[_SPAN + v] = time_s[begin + j + 1] - time_s[begin + j]
            room[_ELAPSED + v] = at - time_s[begin + j]
            room[_NOW + v] = rates[0, j, v]
            room[_NEXT + v] = rates[0, j + 1, v]
            room[_START + v] = rates[2, j, v]
            room[_END + v] = rates[1, j + 1, v]
            room[_LAG + v] = lag[j, v]
        for v in range(LANES):
            ratio[v] = room[_ELAPSED + v] / room[_FILTER + v]
        decays(ratio, kept, lost, power, bits)
        for v in range(LANES):
            room[_LOST + v] = lost[v]
        for v in range(LANES):
            h, f = room[_SPAN + v], room[_NOW + v]
            s = room[_ELAPSED + v] / h
            rise = room[_NEXT + v] - f
            bend = h * room[_START + v] - rise
            twist = rise - h * room[_END + v]
            # beyond the last knot the force goes on as it did
            beyond = time_s[begin + i] - room[_SKEW + v] - last
            beyond = max(0.0, beyond)
            more = room[_END + v] * beyond
            room[_SHOWN + v] = f + s * (rise + (1.0 - s) * (bend * (1.0 - s) + twist * s)) + more
            room[_SHARE + v] = s
        _lag(room)
        for v in range(LANES):
            y[i, v] = room[_SHOWN + v] - room[_LAG + v]
        for v in range(LANES):
            shares[0, i, v] = room[_SHARE + v]
            shares[1, i, v] = 1.0 - room[_LOST + v]
            shares[2, i, v] = room[_LOST + v] * room[_FILTER + v] / room[_SPAN + v]


@kernel(fastmath={"contract"})
def _answer(
    columns: FloatArray, q: int, keep: FloatArray, mean: FloatArray, lag: FloatArray, where: IntArray,
    shares: FloatArray, answers: FloatArray,
) -> None:  # fmt: skip
    """What is shown of one derivative."""
    n = where.shape[0]
    for v in range(LANES):
        lag[0, v] = 0.0
    for i in range(1, n):
        for v in range(LANES):
            step = columns[q, i, v] - columns[q, i - 1, v]
            lag[i, v] = keep[i, v] * lag[i - 1, v] + mean[i, v] * step
    for i in range(n):
        for v in range(LANES):
            j = where[i, v]
            now = columns[q, j, v]
            step = columns[q, j + 1, v] - now
            s, kept, lost = shares[0, i, v], shares[1, i, v], shares[2, i, v]
            answers[q, i, v] = now + s * step - kept * lag[j, v] - lost * step


@kernel(fastmath={"contract"})
def channels(
    time_s: FloatArray, begin: int, rates: FloatArray, columns: FloatArray, skew_s: FloatArray,
    filter_s: FloatArray, y: FloatArray, answers: FloatArray,
) -> None:  # fmt: skip
    """:func:`tissueid.likelihood.load_channel.channel` of :data:`LANES` points.

    Parameters
    ----------
    time_s : ndarray
        Knots of all logs.
    begin : int
        Where the log begins.
    rates, columns : ndarray, shape (3, n, LANES) and (c, n, LANES)
    skew_s, filter_s : ndarray, shape (LANES,)
    y : ndarray, shape (n, LANES)
        Written [N].
    answers : ndarray, shape (c, n, LANES)
        Written.
    """
    n = y.shape[0]
    power = np.empty(LANES)
    work = (np.empty(LANES), np.empty(LANES), np.empty(LANES), power, power.view(np.int64))
    room, lag, shares = np.empty(_ROOM), np.empty((n, LANES)), np.empty((3, n, LANES))
    keep, mean = np.empty((n, LANES)), np.empty((n, LANES))
    where = np.empty((n, LANES), dtype=np.int64)
    for v in range(LANES):
        room[_FILTER + v] = max(filter_s[v], NO_FILTER)
        room[_SKEW + v] = skew_s[v]
    _lags(time_s, begin, rates, room, lag, keep, mean, work)
    _shown(time_s, begin, rates, room, lag, where, shares, y, work)
    for q in range(columns.shape[0]):
        _answer(columns, q, keep, mean, lag, where, shares, answers)
