"""Normal equations of a specimen on knots, log by log, and the effects of the logs integrated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.instrument_kernels import (
    ALL,
    INSTRUMENT,
    RELAXATION,
    TISSUE,
    Packed,
    effect_count,
    tissue_path,
)
from tissueid.likelihood.load_channel import channel

__all__ = ["log_terms", "without_effects"]

FloatArray = NDArray[np.float64]

#: Steps of the difference quotients by skew [s], filter [s] and compliance [mm/N].
STEPS = (1e-5, 1e-5, 1e-7)


@kernel()
def _times_band(band: FloatArray, begin: int, v: FloatArray, out: FloatArray) -> None:
    """Product of a symmetric band matrix, that of the log beginning there, with a vector."""
    n, width = v.size, band.shape[1]
    for k in range(n):
        out[k] = band[begin + k, 0] * v[k]
    for d in range(1, width):
        for k in range(n - d):
            out[k] += band[begin + k, d] * v[k + d]
            out[k + d] += band[begin + k, d] * v[k]


@kernel()
def _products(
    data: Packed, begin: int, y: FloatArray, shown: FloatArray, gram: FloatArray, pull: FloatArray
) -> float:
    """Write normal equations of one log; what its sum of squares has more than about the optimum.

    The matrices are too small for BLAS: its calls would cost more than their work.
    """
    columns, n = shown.shape
    change, white = np.empty(n), np.empty(n)
    for k in range(n):
        change[k] = y[k] - data.base[begin + k]
    _times_band(data.band, begin, change, white)
    more = 0.0
    for k in range(n):
        left = data.pull[begin + k] - white[k]
        more -= change[k] * (data.pull[begin + k] + left)
        change[k] = left
    for q in range(columns):
        _times_band(data.band, begin, shown[q], white)
        for r in range(q + 1):
            total = 0.0
            for k in range(n):
                total += shown[r, k] * white[k]
            gram[q, r] = total
            gram[r, q] = total
        total = 0.0
        for k in range(n):
            total += shown[q, k] * change[k]
        pull[q] = total
    return more


@kernel()
def log_terms(
    data: Packed, theta: FloatArray, log_tau: FloatArray, instrument: FloatArray, kind: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sum of squares of every log and its normal equations, on knots alone.

    Parameters
    ----------
    data : Packed
    theta, log_tau, instrument
        As in :func:`instrument_force`.
    kind : int
        :data:`EFFECTS`, :data:`TISSUE` (and theta), :data:`RELAXATION` (and ln tau) or :data:`ALL` (and skew,
        filter, compliance).

    Returns
    -------
    gram : ndarray, shape (logs, v, v)
        C'R^-1 C; columns are the effects of the log, theta, ln tau, instrument.
    pull : ndarray, shape (logs, v)
        C'R^-1 of what the model leaves.
    square : ndarray, shape (logs,)
        Sum of squares of what it leaves [N^2].
    """
    logs = data.first.size - 1
    total = effect_count(data)
    if kind >= TISSUE:
        total += theta.size
    if kind >= RELAXATION:
        total += log_tau.size
    columns = total + (INSTRUMENT if kind >= ALL else 0)
    gram = np.zeros((logs, columns, columns))
    pull = np.zeros((logs, columns))
    square = np.zeros(logs)
    none = np.zeros((0, 1))
    for log in range(logs):
        begin, end = data.first[log], data.first[log + 1]
        n = end - begin
        rates = np.empty((3, n))
        y = np.empty(n)
        time_s = data.time_s[begin:end]
        tissue = np.empty((total, n))
        shown = np.empty((columns, n))
        tissue_path(data, log, theta, log_tau, instrument[2], kind, rates, tissue)
        channel(time_s, rates, tissue, instrument[0], instrument[1], y, shown)
        for which in range(columns - total):
            moved = instrument.copy()
            moved[which] += STEPS[which]
            if which == INSTRUMENT - 1:
                tissue_path(data, log, theta, log_tau, moved[2], -1, rates, none)
            other = shown[total + which]
            channel(time_s, rates, none, moved[0], moved[1], other, none)
            for k in range(n):
                other[k] = (other[k] - y[k]) / STEPS[which]
        square[log] = data.square[log]
        square[log] += _products(data, begin, y, shown, gram[log], pull[log])
    return gram, pull, square


@kernel()
def without_effects(
    gram: FloatArray,
    pull: FloatArray,
    square: FloatArray,
    weight: FloatArray,
    precision: FloatArray,
    mean: FloatArray,
    sigma2: float,
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Integrate the effects of every log.

    Parameters
    ----------
    gram, pull, square
        From :func:`log_terms`.
    weight : ndarray, shape (logs,)
        Weight of each log; 1 for all but a bootstrap.
    precision, mean : ndarray, shape (logs, q)
        Prior of the effects, counted from where they are linearised.
    sigma2 : float
        Noise variance [N^2].

    Returns
    -------
    curvature : ndarray, shape (v, v)
    slope : ndarray, shape (v,)
        The log likelihood is ``constant + slope'd - d'curvature d / 2`` for a change d.
    value : float
        That constant, up to the noise's own terms.
    back : ndarray, shape (logs, q, v + 1)
        Mean of the effects: ``back[:, :, v] - back[:, :, :v] @ d``.
    """
    logs, columns = pull.shape
    q = precision.shape[1]
    v = columns - q
    curvature = np.zeros((v, v))
    slope = np.zeros(v)
    back = np.zeros((logs, q, v + 1))
    value = 0.0
    low = np.zeros((q, q))
    for log in range(logs):
        if weight[log] <= 0.0:
            continue
        scale = weight[log] / sigma2
        value -= 0.5 * scale * square[log]
        for i in range(v):
            slope[i] += scale * pull[log, q + i]
            for j in range(v):
                curvature[i, j] += scale * gram[log, q + i, q + j]
        x = np.empty((q, v + 1))
        for i in range(q):
            pulled = weight[log] * precision[log, i] * mean[log, i]
            value -= 0.5 * pulled * mean[log, i]
            x[i, v] = scale * pull[log, i] + pulled
            for j in range(v):
                x[i, j] = scale * gram[log, i, q + j]
            for j in range(i + 1):
                entry = scale * gram[log, i, j]
                if i == j:
                    entry += weight[log] * precision[log, i]
                for k in range(j):
                    entry -= low[i, k] * low[j, k]
                low[i, j] = np.sqrt(entry) if i == j else entry / low[j, j]
            value -= np.log(low[i, i]) - 0.5 * np.log(precision[log, i])
            for k in range(i):
                x[i] -= low[i, k] * x[k]
            x[i] /= low[i, i]
        for i in range(q):
            value += 0.5 * x[i, v] * x[i, v]
            for j in range(v):
                slope[j] -= x[i, j] * x[i, v]
                for k in range(v):
                    curvature[j, k] -= x[i, j] * x[i, k]
        for i in range(q - 1, -1, -1):
            for k in range(i + 1, q):
                x[i] -= low[k, i] * x[k]
            x[i] /= low[i, i]
        back[log] = x
    return curvature, slope, value, back
