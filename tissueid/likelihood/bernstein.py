"""Bernstein coefficients of the blocks of theta, and which of their passive bounds are near.

A polynomial of degree 2 with Bernstein coefficients (c0, c1, c2) is passive where ``c0 >= 0``, ``c2 >= 0``
and ``c1 >= -sqrt(c0 c2)``, one of degree 0 or 1 where no coefficient is negative (see
:mod:`tissueid.model.polynomial`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.cone import QUADRATIC

__all__ = ["FREE", "PARABOLA", "ZERO", "brought_inside", "is_passive", "ordered", "to_bernstein", "to_powers"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Points inside (0, 1) at which a quadratic is looked at for the distance to its bound.
GRID = 16
#: Rounding, as a factor of the bound of c1.
INSIDE = 1.0 - 1e-9
#: What a coordinate is cut by: nothing, zero, or the parabola -sqrt(c0 c2) of the two before it.
FREE, ZERO, PARABOLA = 0, 1, 2


@kernel()
def to_bernstein(mean: FloatArray, cov: FloatArray, blocks: IntArray) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of the Bernstein coefficients."""
    centre = mean.copy()
    half = cov.copy()
    for axis in range(2):
        start = 0
        for size in blocks:
            if axis == 0 and size == QUADRATIC:
                centre[start + 2] += centre[start] + centre[start + 1]
                centre[start + 1] = centre[start] + 0.5 * centre[start + 1]
            elif axis == 0 and size > 1:
                centre[start + 1] += centre[start]
            for j in range(mean.size):
                if size == QUADRATIC:
                    half[start + 2, j] += half[start, j] + half[start + 1, j]
                    half[start + 1, j] = half[start, j] + 0.5 * half[start + 1, j]
                elif size > 1:
                    half[start + 1, j] += half[start, j]
            start += size
        half = np.ascontiguousarray(half.T)
    return centre, half


@kernel()
def to_powers(c: FloatArray, blocks: IntArray) -> FloatArray:
    """Coefficients by powers of u from Bernstein coefficients."""
    theta = c.copy()
    start = 0
    for size in blocks:
        if size == QUADRATIC:
            theta[start + 1] = 2.0 * (c[start + 1] - c[start])
            theta[start + 2] = c[start] - 2.0 * c[start + 1] + c[start + 2]
        elif size > 1:
            theta[start + 1] = c[start + 1] - c[start]
        start += size
    return theta


@kernel()
def is_passive(theta: FloatArray, blocks: IntArray) -> bool:
    """As :func:`tissueid.model.polynomial.minimum_on_unit` >= 0 for each block."""
    start = 0
    for size in blocks:
        first = theta[start]
        total = first
        for k in range(1, size):
            total += theta[start + k]
        if not (first >= 0.0 and total >= 0.0):
            return False
        if size == QUADRATIC and theta[start + 2] > 0.0:
            vertex = -theta[start + 1] / (2.0 * theta[start + 2])
            if 0.0 < vertex < 1.0:
                low = first + vertex * (theta[start + 1] + vertex * theta[start + 2])
                if not low >= 0.0:
                    return False
        start += size
    return True


@kernel()
def brought_inside(bernstein: FloatArray, blocks: IntArray) -> FloatArray:
    """Coefficients by powers of u of what rounding has put outside the passive set."""
    c = np.maximum(bernstein, 0.0)
    start = 0
    for size in blocks:
        if size == QUADRATIC:
            c[start + 1] = max(bernstein[start + 1], -INSIDE * math.sqrt(c[start] * c[start + 2]))
        start += size
    return to_powers(c, blocks)


@kernel()
def _inner_distance(c: FloatArray, s: FloatArray, start: int) -> float:
    """Standard deviations from a quadratic to its bound inside (0, 1): least mean over sd along u."""
    least = np.inf
    curvature = c[start] - 2.0 * c[start + 1] + c[start + 2]
    for i in range(1, GRID + 1):
        u = i / GRID
        if i == GRID:
            # the lowest point of the mean: a narrow dip between the others
            u = (c[start] - c[start + 1]) / curvature if curvature > 0.0 else 0.5
            u = min(max(u, 0.0), 1.0)
        b0, b1, b2 = (1.0 - u) ** 2, 2.0 * u * (1.0 - u), u * u
        value = b0 * c[start] + b1 * c[start + 1] + b2 * c[start + 2]
        variance = b0 * (b0 * s[start, start] + 2.0 * b1 * s[start, start + 1])
        variance += b1 * (b1 * s[start + 1, start + 1] + 2.0 * b2 * s[start + 1, start + 2])
        variance += b2 * (b2 * s[start + 2, start + 2] + 2.0 * b0 * s[start, start + 2])
        least = min(least, value / math.sqrt(max(variance, 1e-300)))
    return least


@kernel()
def ordered(c: FloatArray, s: FloatArray, blocks: IntArray, far: float) -> tuple[IntArray, IntArray, int]:
    """Coordinates with a bound nearer than ``far`` sd, each with its kind, then the others; how many are cut.

    c1 of a quadratic comes right after its c0 and c2, which its bound depends on.
    """
    p = c.size
    index = np.empty(p, dtype=np.int64)
    kind = np.zeros(p, dtype=np.int64)
    free = np.ones(p, dtype=np.bool_)
    near = np.empty(p, dtype=np.bool_)
    for i in range(p):
        near[i] = c[i] < far * math.sqrt(s[i, i])
    count = 0
    start = 0
    for size in blocks:
        curved = size == QUADRATIC and near[start + 1] and _inner_distance(c, s, start) < far
        for position in range(min(size, 2)):
            i = start + position * (size - 1)
            if curved or near[i]:
                index[count] = i
                kind[count] = ZERO
                free[i] = False
                count += 1
        if curved:
            index[count] = start + 1
            kind[count] = PARABOLA
            free[start + 1] = False
            count += 1
        start += size
    last = count
    for i in range(p):
        if free[i]:
            index[last] = i
            last += 1
    return index, kind, count
