"""Compiled answer of a load channel: a first-order low-pass and a delay, between knots of time.

The force between knots is a cubic (Hermite) in time from its values and rates, and the low-pass is exact for
it: of a force that relaxes as fast as its channel, a rate that is linear from knot to knot is too high.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel

__all__ = ["channel"]

FloatArray = NDArray[np.float64]


@kernel()
def _lag(
    lag: float, rise: float, start: float, end: float, span: float, elapsed: float, filter_s: float
) -> float:
    """How far the low-pass is behind, some time after a knot where it was behind by ``lag``.

    The force rises by ``rise`` over the span, its rate goes from ``start`` to ``end``.
    """
    mean = rise / span
    linear = (6.0 * mean - 4.0 * start - 2.0 * end) / span
    square = 3.0 * (start + end - 2.0 * mean) / (span * span)
    # what is left at the end of rates 1, t and t^2
    lost = -math.expm1(-elapsed / filter_s)
    of_one = filter_s * lost
    of_time = filter_s * (elapsed - of_one)
    of_square = filter_s * (elapsed * elapsed - 2.0 * of_time)
    return (1.0 - lost) * lag + start * of_one + linear * of_time + square * of_square


@kernel()
def _lags(
    time_s: FloatArray, rates: FloatArray, columns: FloatArray, filter_s: float
) -> tuple[FloatArray, FloatArray]:
    """How far the low-pass is behind the force, and behind its derivatives, at the knots."""
    n = time_s.size
    lag = np.zeros(n)
    lags = np.zeros((columns.shape[0], n))
    if filter_s <= 0.0:
        return lag, lags
    for i in range(1, n):
        h = time_s[i] - time_s[i - 1]
        rise = rates[0, i] - rates[0, i - 1]
        lag[i] = _lag(lag[i - 1], rise, rates[2, i - 1], rates[1, i], h, h, filter_s)
        lost = -math.expm1(-h / filter_s)
        keep, mean = 1.0 - lost, lost * filter_s / h
        for q in range(columns.shape[0]):
            lags[q, i] = keep * lags[q, i - 1] + mean * (columns[q, i] - columns[q, i - 1])
    return lag, lags


@kernel()
def channel(
    time_s: FloatArray,
    rates: FloatArray,
    columns: FloatArray,
    skew_s: float,
    filter_s: float,
    y: FloatArray,
    answers: FloatArray,
) -> None:
    """What the load channel shows at the knots: low-passed, and later by ``skew_s``.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    rates, columns : ndarray
        From :func:`tissueid.likelihood.instrument_kernels.tissue_path`.  Derivatives are taken as linear
        between knots.
    skew_s, filter_s : float
        Negative skew: the force is early.
    y : ndarray, shape (n,)
        Written [N].
    answers : ndarray, shape (>= c, n)
        Written: the same of each derivative.
    """
    n, total = time_s.size, columns.shape[0]
    lag, lags = _lags(time_s, rates, columns, filter_s)
    j = 0
    for i in range(n):
        at = min(max(time_s[i] - skew_s, time_s[0]), time_s[n - 1])
        while j < n - 2 and time_s[j + 1] <= at:
            j += 1
        h = time_s[j + 1] - time_s[j]
        elapsed = at - time_s[j]
        s = elapsed / h
        rise = rates[0, j + 1] - rates[0, j]
        bend = h * rates[2, j] - rise
        twist = rise - h * rates[1, j + 1]
        y[i] = rates[0, j] + s * (rise + (1.0 - s) * (bend * (1.0 - s) + twist * s))
        keep = 0.0
        mean = 0.0
        if filter_s > 0.0:
            y[i] -= _lag(lag[j], rise, rates[2, j], rates[1, j + 1], h, elapsed, filter_s)
            lost = -math.expm1(-elapsed / filter_s)
            keep, mean = 1.0 - lost, lost * filter_s / h
        # beyond the last knot the force goes on as it did
        beyond = time_s[i] - skew_s - time_s[n - 1]
        if beyond > 0.0:
            y[i] += rates[1, n - 1] * beyond
        for q in range(total):
            step = columns[q, j + 1] - columns[q, j]
            answers[q, i] = columns[q, j] + s * step - keep * lags[q, j] - mean * step
