"""Compiled loops over correlated noise: design rows and their differences, and the filter of a residual."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

__all__ = ["filter_chain", "filter_rows", "link_rows"]

FloatArray = NDArray[np.float64]

#: The filter's gain has settled when its variance moves by less than this part, which is rounding.
SETTLED = 1e-15


@nb.njit(cache=True, nogil=True, error_model="numpy")
def link_rows(group: NDArray[np.int64], rows: FloatArray, change: FloatArray) -> None:
    """Take the differences of neighbouring design rows.

    Parameters
    ----------
    group : ndarray of int, shape (k,)
        -1 where a row starts a chain.
    rows : ndarray, shape (chunk + 1, m)
        Row ``i + 1`` belongs to ``group[i]``; row 0 is the last row of the chunk before.
    change : ndarray, shape (chunk + 1, m)
        Receives ``z_n - z_(n-1)``, zero where a row starts a chain.
    """
    m = rows.shape[1]
    for i in range(group.size):
        row = rows[i + 1]
        before = rows[i]
        difference = change[i + 1]
        linked = 1.0 if group[i] >= 0 else 0.0
        for k in range(m):
            difference[k] = linked * (row[k] - before[k])


@nb.njit(cache=True, nogil=True, error_model="numpy")
def filter_rows(
    group: NDArray[np.int64],
    rho: FloatArray,
    white: float,
    variance: float,
    left: float,
    mean: FloatArray,
    rows: FloatArray,
) -> float:
    """Turn white plus AR(1) noise into AR(1): design rows are filtered chain by chain, in place.

    With v_n and F_n the innovations of the scalar Kalman filter and their variances, the new rows are
    ``zeta_n = rho zeta_(n-1) + v_n sqrt(variance (1 - rho^2) / F_n)``: their AR(1) innovations are those of
    the filter, at the start of a chain as well as after it.

    Parameters
    ----------
    group : ndarray of int, shape (k,)
        Group of a row's link, -1 where it starts a chain.
    rho : ndarray, shape (groups,)
        Correlation of the AR(1) part over the step of each group.
    white : float
        White part of the noise, whose variance is one.
    variance : float
        Variance of zeta.
    left : float
        Variance that the filter leaves after the row before.
    mean : ndarray, shape (m,)
        The filter's state after the row before; updated in place.
    rows : ndarray, shape (chunk + 1, m)
        Row ``i + 1`` belongs to ``group[i]``; row 0 is the last filtered row of the chunk before.

    Returns
    -------
    float
        Variance that the filter leaves after the last row.
    """
    m = rows.shape[1]
    for i in range(group.size):
        r = rho[group[i]] if group[i] >= 0 else 0.0
        expected = r * r * left + (1.0 - white) * (1.0 - r * r)
        gain = expected / (expected + white)
        scale = math.sqrt(variance * (1.0 - r * r) / (expected + white))
        left = gain * white
        row = rows[i + 1]
        before = rows[i]
        for k in range(m):
            innovation = row[k] - r * mean[k]
            mean[k] = r * mean[k] + gain * innovation
            row[k] = scale * innovation + r * before[k]
    return left


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
