"""Compiled Gram matrices of design rows that lie one behind the other in memory, samples running fastest.

A product Z Z' of many samples and few rows is bound by loads, not by multiplications.  Sixteen entries of it,
four rows against four, are kept in registers while the samples run past: eight loads for sixteen
multiply-adds, no stores.  Only tiles on and above the diagonal are made.  Rows times a power of one weight
make a Gram matrix each, from the same loads: the columns x^p s_k of a stiffness that grows with depth need
2 degree + 1 of the small products S' diag(x^q) S, not one of all columns with each other.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numba.extending import is_jitted
from numpy.typing import NDArray

__all__ = [
    "LANES",
    "TILE",
    "add_grams",
    "chunk_samples",
    "clear_gaps",
    "mirrored",
    "places",
    "plain_grams",
    "tiled_grams",
    "tiled_rows",
]

FloatArray = NDArray[np.float64]

#: Rows and columns of a tile; the number of rows of a design is a multiple of it.
TILE = 4
#: Samples that a register holds on any common processor: sums over a multiple of it have no remainder.
LANES = 8
#: Samples of a block: rows of so many are summed before they are added up.
BLOCK = 1024
#: Numbers in the rows of a chunk of samples: they stay in the second-level cache.
CELLS = 72 * 1024
#: What the compiler may do to a sum: split it over the lanes of a register, and multiply and add in one.
SUMMED_IN_LANES = {"reassoc", "contract", "nsz"}


def tiled_rows(count: int) -> int:
    """The next multiple of :data:`TILE`."""
    return -(-count // TILE) * TILE


def chunk_samples(rows: int) -> int:
    """Samples whose design rows are made at a time, where there are so many rows."""
    return max(CELLS // rows // LANES, 1) * LANES


def mirrored(upper: FloatArray) -> FloatArray:
    """Symmetric matrices from what stands on and above their diagonals; shape (..., m, m)."""
    return np.asarray(np.triu(upper) + np.swapaxes(np.triu(upper, 1), -1, -2))


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMMED_IN_LANES)
def tiled_grams(
    rows: FloatArray, weight: FloatArray, plain: int, first: int, last: int, out: FloatArray
) -> None:
    """:func:`add_grams`, compiled."""
    powers, m, _ = out.shape
    scaled = np.empty((TILE, BLOCK))
    for begin in range(first, last, BLOCK):
        end = min(begin + BLOCK, last)
        n = end - begin
        w = weight[begin:end]
        for k in range(0, m, TILE):
            a0, a1, a2, a3 = scaled[0, :n], scaled[1, :n], scaled[2, :n], scaled[3, :n]
            for a in range(TILE):
                scaled[a, :n] = rows[k + a, begin:end]
            for q in range(powers if k >= plain else 1):
                if q > 0:
                    for i in range(n):
                        a0[i] *= w[i]
                    for i in range(n):
                        a1[i] *= w[i]
                    for i in range(n):
                        a2[i] *= w[i]
                    for i in range(n):
                        a3[i] *= w[i]
                for c in range(k, m, TILE):
                    b0, b1 = rows[c, begin:end], rows[c + 1, begin:end]
                    b2, b3 = rows[c + 2, begin:end], rows[c + 3, begin:end]
                    s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = 0.0
                    s20 = s21 = s22 = s23 = s30 = s31 = s32 = s33 = 0.0
                    for i in range(n):
                        s00 += a0[i] * b0[i]
                        s01 += a0[i] * b1[i]
                        s02 += a0[i] * b2[i]
                        s03 += a0[i] * b3[i]
                        s10 += a1[i] * b0[i]
                        s11 += a1[i] * b1[i]
                        s12 += a1[i] * b2[i]
                        s13 += a1[i] * b3[i]
                        s20 += a2[i] * b0[i]
                        s21 += a2[i] * b1[i]
                        s22 += a2[i] * b2[i]
                        s23 += a2[i] * b3[i]
                        s30 += a3[i] * b0[i]
                        s31 += a3[i] * b1[i]
                        s32 += a3[i] * b2[i]
                        s33 += a3[i] * b3[i]
                    tile = out[q, k : k + TILE, c : c + TILE]
                    tile[0, 0] += s00
                    tile[0, 1] += s01
                    tile[0, 2] += s02
                    tile[0, 3] += s03
                    tile[1, 0] += s10
                    tile[1, 1] += s11
                    tile[1, 2] += s12
                    tile[1, 3] += s13
                    tile[2, 0] += s20
                    tile[2, 1] += s21
                    tile[2, 2] += s22
                    tile[2, 3] += s23
                    tile[3, 0] += s30
                    tile[3, 1] += s31
                    tile[3, 2] += s32
                    tile[3, 3] += s33


def plain_grams(
    rows: FloatArray, weight: FloatArray, plain: int, first: int, last: int, out: FloatArray
) -> None:
    """:func:`add_grams` as matrix products, for a run without compilation."""
    part = rows[:, first:last]
    out[0] += part @ part.T
    for q in range(1, out.shape[0]):
        out[q, plain:] += (part[plain:] * weight[first:last] ** q) @ part.T


def add_grams(
    rows: FloatArray, weight: FloatArray, plain: int, first: int, last: int, out: FloatArray
) -> None:
    """Add the weighted Gram matrices of samples [first, last): ``sum_i w_i^q z_ki z_li``.

    Parameters
    ----------
    rows : ndarray, shape (m, samples)
        Design rows, m a multiple of :data:`TILE`.
    weight : ndarray, shape (samples,)
        Looked at where more than one power is asked for.
    plain : int
        So many leading rows, a multiple of :data:`TILE`, take part in the power zero alone.
    first, last : int
    out : ndarray, shape (powers, m, m)
        One matrix a power q; right on and above the diagonal (:func:`mirrored`).
    """
    (tiled_grams if is_jitted(tiled_grams) else plain_grams)(rows, weight, plain, first, last, out)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def places(label: NDArray[np.int64], kinds: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns that put samples of one label side by side, in their order.

    Parameters
    ----------
    label : ndarray of int, shape (count,)
        In [0, kinds).
    kinds : int

    Returns
    -------
    place : ndarray of int, shape (count,)
    bound : ndarray of int, shape (kinds, 2)
        First column of each label, a multiple of :data:`LANES`, and the one behind its last.
    """
    bound = np.zeros((kinds, 2), dtype=np.int64)
    for one in label:
        bound[one, 1] += 1
    column = 0
    for k in range(kinds):
        count = bound[k, 1]
        bound[k] = column
        column += -(-count // LANES) * LANES
    place = np.empty(label.size, dtype=np.int64)
    for i in range(label.size):
        place[i] = bound[label[i], 1]
        bound[label[i], 1] += 1
    return place, bound


def clear_gaps(rows: FloatArray, bound: NDArray[np.int64]) -> None:
    """Zero the columns between labels: they are summed with the label before."""
    for stop in bound[:, 1].tolist():
        if stop % LANES:
            rows[:, stop : -(-stop // LANES) * LANES] = 0.0
