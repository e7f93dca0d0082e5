"""Compiled loops over correlated noise: design rows and their differences, and the filter of a residual."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

__all__ = ["filter_chain", "link_rows"]

FloatArray = NDArray[np.float64]

#: The filter's gain has settled when its variance moves by less than this part, which is rounding.
SETTLED = 1e-15


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


@nb.njit(cache=True, nogil=True, error_model="numpy")
def filter_chain(
    residual: FloatArray, starts: NDArray[np.bool_], ratio: FloatArray, phi: float, white: float
) -> tuple[float, float]:
    """Innovations of white noise plus AR(1), of total variance one: the scalar Kalman filter.

    Exact for any steps and breaks.  Over equal steps the filter's gain settles, and from then on a sample
    costs two multiply-adds.

    Parameters
    ----------
    residual : ndarray, shape (n,)
    starts : ndarray of bool, shape (n,)
        True where a chain starts.
    ratio : ndarray, shape (n,)
        Step since the sample before over the reference step; unused at starts.
    phi : float
        Correlation of the AR(1) part over the reference step, in [0, 1).
    white : float
        White part of the variance, in [0, 1].

    Returns
    -------
    square, log_det : float
        ``r' R^-1 r`` and ``ln det R``.
    """
    square = 0.0
    log_det = 0.0
    slow = 1.0 - white
    decay = math.log(phi) if phi > 0.0 else -math.inf
    mean = 0.0
    left = slow
    last_ratio = -1.0
    rho = 0.0
    fresh = slow
    before = -1.0
    variance = 1.0
    gain = slow
    log_variance = 0.0
    for n in range(residual.size):
        if starts[n]:
            mean = 0.0
            variance = 1.0
            gain = slow
            left = slow * white
            log_variance = 0.0
            before = -1.0
        else:
            if ratio[n] != last_ratio:
                last_ratio = ratio[n]
                rho = math.exp(decay * last_ratio)
                fresh = -slow * math.expm1(2.0 * decay * last_ratio)
                before = -1.0
            mean *= rho
            if abs(left - before) > SETTLED * variance:
                before = left
                expected = rho * rho * left + fresh
                variance = expected + white
                gain = expected / variance
                left = expected * (white / variance)
                log_variance = math.log(variance)
        innovation = residual[n] - mean
        square += innovation * innovation / variance
        log_det += log_variance
        mean += gain * innovation
    return square, log_det
