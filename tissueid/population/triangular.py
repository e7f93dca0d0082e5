"""Compiled triangular factors of the small matrices of a model: LAPACK's calls cost more than their work."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel

__all__ = [
    "factor",
    "inverse_factor",
    "solved",
    "sparse_times",
    "squared_distances",
    "weigh",
    "weighted_sum",
]

FloatArray = NDArray[np.float64]


@kernel()
def factor(a: FloatArray) -> FloatArray:
    """Lower factor; NaN on the diagonal where the matrix is not positive definite."""
    n = a.shape[0]
    low = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            value = a[i, j]
            for k in range(j):
                value -= low[i, k] * low[j, k]
            low[i, j] = np.sqrt(value) if i == j else value / low[j, j]
    return low


@kernel()
def inverse_factor(low: FloatArray) -> FloatArray:
    """Inverse of a lower triangular matrix."""
    inverse = np.zeros(low.shape)
    for i in range(low.shape[0]):
        inverse[i, i] = 1.0 / low[i, i]
        for j in range(i):
            for k in range(j, i):
                inverse[i, j] -= low[i, k] * inverse[k, j]
            inverse[i, j] /= low[i, i]
    return inverse


@kernel()
def solved(low: FloatArray, away: FloatArray) -> FloatArray:
    """The z of ``low @ z = away``."""
    z = away.copy()
    for i in range(z.size):
        for k in range(i):
            z[i] -= low[i, k] * z[k]
        z[i] /= low[i, i]
    return z


@kernel()
def squared_distances(points: FloatArray, means: FloatArray, lows: FloatArray) -> FloatArray:
    """Squared lengths of the z of ``lows[k] @ z = points[i] - means[k]``, shape (n, k)."""
    n, d = points.shape
    out = np.zeros((n, means.shape[0]))
    z = np.empty(d)
    for k in range(means.shape[0]):
        for i in range(n):
            for row in range(d):
                rest = points[i, row] - means[k, row]
                for j in range(row):
                    rest -= lows[k, row, j] * z[j]
                z[row] = rest / lows[k, row, row]
                out[i, k] += z[row] * z[row]
    return out


@kernel()
def weigh(coefficient: FloatArray, matrices: FloatArray, out: FloatArray) -> None:
    """Write the weighted sum of matrices, without a copy of any."""
    out[:] = 0.0
    for k in range(coefficient.size):
        c = coefficient[k]
        if c != 0.0:
            for i in range(out.shape[0]):
                for j in range(out.shape[1]):
                    out[i, j] += c * matrices[k, i, j]


@kernel()
def weighted_sum(coefficient: FloatArray, matrices: FloatArray) -> FloatArray:
    """Weighted sum of matrices."""
    out = np.empty(matrices.shape[1:])
    weigh(coefficient, matrices, out)
    return out


@kernel()
def sparse_times(weights: FloatArray, a: FloatArray) -> FloatArray:
    """``weights.T @ a`` where most weights are zero: a coefficient of K touches the nodes of one branch."""
    out = np.zeros((weights.shape[1], a.shape[1]))
    for k in range(weights.shape[0]):
        for j in range(weights.shape[1]):
            w = weights[k, j]
            if w != 0.0:
                for i in range(a.shape[1]):
                    out[j, i] += w * a[k, i]
    return out
