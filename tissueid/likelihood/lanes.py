"""Points side by side: arithmetic that a processor does on several numbers at a time.

What a point costs on its own is mostly waiting, each number for the one before it.  Here :data:`LANES` points
go through the same knots together, point by point in the last axis of every array, and the loops over that
axis have no branches: they become vector instructions.  A point's result depends on itself alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel

__all__ = ["LANES", "decays", "gathered"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Points that go side by side.
LANES = 64
#: Steps beyond this many relaxation times leave nothing.
LONGEST = 700.0
#: Added to a number it leaves its nearest whole number in the last bits; those bits, and those of 1.
ROUNDING = 1.5 * 2.0**52
BITS = 0x4338000000000000 + 1023
#: ln 2 in two parts, so that whole multiples of the first are exact.
LN2_HIGH = 0.693147180369123816490
LN2_LOW = 1.90821492927058770002e-10
LOG2_E = 1.0 / math.log(2.0)


@kernel(fastmath={"contract"})
def decays(ratio: FloatArray, kept: FloatArray, lost: FloatArray, power: FloatArray, bits: IntArray) -> None:
    """Write ``exp(-ratio)`` and ``-expm1(-ratio)`` to rounding.

    Parameters
    ----------
    ratio : ndarray, shape (n,)
        Not negative.
    kept, lost : ndarray, shape (n,)
        Written.
    power, bits : ndarray, shape (n,)
        Room to work in, the second a view of the first as whole numbers.
    """
    for v in range(ratio.size):
        x = min(LONGEST, ratio[v])
        whole = x * LOG2_E + ROUNDING
        power[v] = whole
        whole -= ROUNDING
        lost[v] = (whole * LN2_HIGH - x) + whole * LN2_LOW
    for v in range(ratio.size):
        bits[v] = (BITS - bits[v]) << 52
    for v in range(ratio.size):
        t = lost[v]
        # Taylor's series of (exp(t) - 1) / t for |t| < 0.35: the next term is 4e-18
        p = 1.0 / 87178291200.0
        p = p * t + 1.0 / 6227020800.0
        p = p * t + 1.0 / 479001600.0
        p = p * t + 1.0 / 39916800.0
        p = p * t + 1.0 / 3628800.0
        p = p * t + 1.0 / 362880.0
        p = p * t + 1.0 / 40320.0
        p = p * t + 1.0 / 5040.0
        p = p * t + 1.0 / 720.0
        p = p * t + 1.0 / 120.0
        p = p * t + 1.0 / 24.0
        p = p * t + 1.0 / 6.0
        p = p * t + 0.5
        p = p * t * t + t
        kept[v] = power[v] + power[v] * p
        lost[v] = (1.0 - power[v]) - power[v] * p


@kernel(fastmath={"contract"})
def gathered(points: FloatArray, rows: IntArray, first: int, size: int) -> FloatArray:
    """Some columns of some points, side by side; the last point fills lanes that are left over.

    Parameters
    ----------
    points : ndarray, shape (n, d)
    rows : ndarray of int
        At most :data:`LANES` of them.
    first, size : int
        Columns.

    Returns
    -------
    ndarray, shape (size, LANES)
    """
    out = np.empty((size, LANES))
    for k in range(size):
        for v in range(LANES):
            out[k, v] = points[rows[min(v, rows.size - 1)], first + k]
    return out
