"""Compiled part of the pass for correlated noise: pre-filtered rows, their differences, and their links."""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

__all__ = ["link_rows"]

FloatArray = NDArray[np.float64]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def link_rows(group: NDArray[np.int64], theta: float, rows: FloatArray, change: FloatArray) -> None:
    """Pre-filter design rows chain by chain, in place, and take the differences of neighbours.

    Parameters
    ----------
    group : ndarray of int, shape (k,)
        -1 where a row starts a chain.
    theta : float
        ``zeta_n = z_n + theta zeta_(n-1)``; 0 leaves the rows as they are.
    rows : ndarray, shape (chunk + 1, m)
        Row ``i + 1`` belongs to ``group[i]``; row 0 is the last (pre-filtered) row of the chunk before.
    change : ndarray, shape (chunk + 1, m)
        Receives ``zeta_n - zeta_(n-1)``, zero where a row starts a chain.
    """
    m = rows.shape[1]
    for i in range(group.size):
        row = rows[i + 1]
        before = rows[i]
        difference = change[i + 1]
        if group[i] < 0:
            for k in range(m):
                difference[k] = 0.0
            continue
        if theta != 0.0:
            for k in range(m):
                row[k] += theta * before[k]
        for k in range(m):
            difference[k] = row[k] - before[k]
