"""Compiled passes over the samples of a log: where its motion turns, and its sums on knots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel

__all__ = ["accumulate", "corner_flags"]

FloatArray = NDArray[np.float64]

#: A memory of the moving average below this is none.
FORGOTTEN = 1e-9


@kernel()
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


@kernel()
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
