"""Compiled triangular factors of the small matrices of a model: LAPACK's calls cost more than their work."""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import kernel


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
