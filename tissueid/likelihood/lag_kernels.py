"""Compiled loops over correlated noise: linked rows, the filter of rows and of residuals, weights of sums."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.gram_kernels import TILE

__all__ = ["filter_chain", "filter_rows", "lag_weights", "link_rows"]

FloatArray = NDArray[np.float64]

#: The filter's gain has settled when its variance moves by less than this part, which is rounding.
SETTLED = 1e-15


@nb.njit(cache=True, nogil=True, error_model="numpy")
def link_rows(rows: FloatArray, place: NDArray[np.int64], before: float, now: float, out: FloatArray) -> None:
    """Put the same weighted sum of every sample and the one before where the sample's place is.

    Parameters
    ----------
    rows : ndarray, shape (m, chunk + 1)
        Design rows; column ``i + 1`` belongs to ``place[i]``, column 0 ends the chunk before.
    place : ndarray of int, shape (k,)
    before, now : float
        Weights.
    out : ndarray, shape (m, samples)
    """
    count = place.size
    ordered = True
    for i in range(count):
        ordered = ordered and place[i] == i
    for k in range(rows.shape[0]):
        row, linked = rows[k], out[k]
        if ordered:
            for i in range(count):
                linked[i] = before * row[i] + now * row[i + 1]
        else:
            for i in range(count):
                linked[place[i]] = before * row[i] + now * row[i + 1]


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
        Group of a sample's link, -1 where it starts a chain.
    rho : ndarray, shape (groups,)
        Correlation of the AR(1) part over the step of each group.
    white : float
        White part of the noise, whose variance is one.
    variance : float
        Variance of zeta.
    left : float
        Variance that the filter leaves after the sample before.
    mean : ndarray, shape (m,)
        The filter's state after the sample before; updated in place.
    rows : ndarray, shape (m, chunk + 1)
        Column ``i + 1`` belongs to ``group[i]``; column 0 is the last filtered one of the chunk before.

    Returns
    -------
    float
        Variance that the filter leaves after the last sample.
    """
    weight = np.empty((4, group.size))
    for i in range(group.size):
        r = rho[group[i]] if group[i] >= 0 else 0.0
        expected = r * r * left + (1.0 - white) * (1.0 - r * r)
        gain = expected / (expected + white)
        left = gain * white
        weight[0, i] = r
        weight[1, i] = gain
        weight[2, i] = r * white / (expected + white)
        weight[3, i] = math.sqrt(variance * (1.0 - r * r) / (expected + white))
    # four rows at a time: each of them waits for its sample before
    for k in range(0, mean.size, TILE):
        row0, row1, row2, row3 = rows[k], rows[k + 1], rows[k + 2], rows[k + 3]
        m0, m1, m2, m3 = mean[k], mean[k + 1], mean[k + 2], mean[k + 3]
        f0, f1, f2, f3 = row0[0], row1[0], row2[0], row3[0]
        for i in range(group.size):
            r, gain, kept, scale = weight[0, i], weight[1, i], weight[2, i], weight[3, i]
            z0, z1, z2, z3 = row0[i + 1], row1[i + 1], row2[i + 1], row3[i + 1]
            f0 = scale * (z0 - r * m0) + r * f0
            f1 = scale * (z1 - r * m1) + r * f1
            f2 = scale * (z2 - r * m2) + r * f2
            f3 = scale * (z3 - r * m3) + r * f3
            m0 = kept * m0 + gain * z0
            m1 = kept * m1 + gain * z1
            m2 = kept * m2 + gain * z2
            m3 = kept * m3 + gain * z3
            row0[i + 1], row1[i + 1], row2[i + 1], row3[i + 1] = f0, f1, f2, f3
        mean[k], mean[k + 1], mean[k + 2], mean[k + 3] = m0, m1, m2, m3
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
    kept = 0.0
    # innovations of one variance are summed before they are divided by it
    pending = 0.0
    held = 0
    for n in range(residual.size):
        moving = starts[n] or ratio[n] != last_ratio or abs(left - before) > SETTLED * variance
        if moving:
            square += pending / variance
            log_det += held * math.log(variance)
            pending = 0.0
            held = 0
        if starts[n]:
            mean = 0.0
            variance = 1.0
            gain = slow
            kept = 0.0
            left = slow * white
            before = -1.0
        elif moving:
            if ratio[n] != last_ratio:
                last_ratio = ratio[n]
                rho = math.exp(decay * last_ratio)
                fresh = -slow * math.expm1(2.0 * decay * last_ratio)
            before = left
            expected = rho * rho * left + fresh
            variance = expected + white
            gain = expected / variance
            kept = rho * white / variance
            left = expected * (white / variance)
        innovation = residual[n] if starts[n] else residual[n] - rho * mean
        mean = kept * mean + gain * residual[n]
        pending += innovation * innovation
        held += 1
    return square + pending / variance, log_det + held * math.log(variance)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def lag_weights(phi: float, ratio: FloatArray) -> FloatArray:
    """Weights of (start, then later, earlier, difference of each step) in the whitened Gram matrix."""
    out = np.empty(1 + 3 * ratio.size)
    out[0] = 1.0
    for k in range(ratio.size):
        rho = phi ** ratio[k] if phi > 0.0 else 0.0
        out[1 + 3 * k] = 1.0 / (1.0 + rho)
        out[2 + 3 * k] = -rho / (1.0 + rho)
        out[3 + 3 * k] = rho / (1.0 - rho * rho)
    return out
