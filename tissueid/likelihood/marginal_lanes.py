"""The marginal likelihood of :mod:`tissueid.likelihood.marginal` at many points side by side.

The effects of the logs, most of its work, are integrated for :data:`LANES` points at a time
(:mod:`tissueid.likelihood.lanes`).  A point's result depends on itself alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.lag_kernels import lag_weights
from tissueid.likelihood.lanes import LANES
from tissueid.likelihood.linearised import Linearised
from tissueid.likelihood.marginal import short_of_passive
from tissueid.likelihood.marginal_parts import begun, finished
from tissueid.likelihood.passive_normal import log_passive_mass

__all__ = ["FEW", "log_marginals_together", "log_peaks_together"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Fewer points than this are not worth a group of their own.
FEW = 32


@kernel(fastmath={"contract"})
def _weighed(coefficient: FloatArray, tables: FloatArray, log: int, r: int, k: int, out: FloatArray) -> None:
    """Write the weighted sum of one entry of the tables of a log."""
    for v in range(LANES):
        out[v] = 0.0
    for c in range(coefficient.shape[0]):
        entry = tables[log, c, r, k]
        if entry != 0.0:
            for v in range(LANES):
                out[v] += coefficient[c, v] * entry


@kernel(fastmath={"contract"})
def _by_columns(
    data: Linearised, log: int, coefficient: FloatArray, weights: FloatArray, filled: IntArray,
    starts: IntArray, x: FloatArray, entry: FloatArray,
) -> None:  # fmt: skip
    """Write the effects of one log by theta's columns.

    ``filled`` are the columns that a row of weights touches, row k from ``starts[k]``.
    """
    for r in range(x.shape[0]):
        for u in range(x.shape[1]):
            for v in range(LANES):
                x[r, u, v] = 0.0
        for k in range(weights.shape[0]):
            if starts[k] == starts[k + 1]:
                continue
            _weighed(coefficient, data.cross, log, r, k, entry)
            for at in range(starts[k], starts[k + 1]):
                u = filled[at]
                for v in range(LANES):
                    x[r, u, v] += weights[k, u, v] * entry[v]


@kernel(fastmath={"contract"})
def _integrate(
    data: Linearised, coefficient: FloatArray, weights: FloatArray, pattern: tuple[IntArray, IntArray],
    inverse_sigma2: FloatArray, gain: FloatArray, tilt: FloatArray, full: FloatArray, log_det: FloatArray,
) -> None:  # fmt: skip
    """Take the effects of every log out of ``full``; see ``marginal._without_effects``."""
    logs, q, p = data.cross.shape[0], data.cross.shape[2], weights.shape[1] - 1
    x, low = np.empty((q, p + 1, LANES)), np.zeros((q, q, LANES))
    entry, stated = np.empty(LANES), np.empty(LANES)
    for i in range(logs):
        _by_columns(data, i, coefficient, weights, pattern[0], pattern[1], x, entry)
        for r in range(q):
            for v in range(LANES):
                stated[v] = gain[v] if r == 0 and data.has_gain else data.effect_precision[i, r]
            for u in range(p + 1):
                for v in range(LANES):
                    x[r, u, v] *= inverse_sigma2[v]
            for t in range(r + 1):
                _weighed(coefficient, data.own, i, r, t, entry)
                for v in range(LANES):
                    entry[v] *= inverse_sigma2[v]
                    if t == r:
                        entry[v] += stated[v]
                for k in range(t):
                    for v in range(LANES):
                        entry[v] -= low[r, k, v] * low[t, k, v]
                for v in range(LANES):
                    low[r, t, v] = np.sqrt(entry[v]) if t == r else entry[v] / low[t, t, v]
            for v in range(LANES):
                pull = stated[v] * data.effect_mean[i, r]
                x[r, p, v] += pull - (tilt[v] / logs if r == 0 else 0.0)
                full[p, p, v] += pull * data.effect_mean[i, r]
            for v in range(LANES):
                log_det[v] += np.log(low[r, r, v] * low[r, r, v] / stated[v])
            for u in range(p + 1):
                for t in range(r):
                    for v in range(LANES):
                        x[r, u, v] -= low[r, t, v] * x[t, u, v]
                for v in range(LANES):
                    x[r, u, v] /= low[r, r, v]
            for u in range(p + 1):
                for w in range(u + 1):
                    for v in range(LANES):
                        full[u, w, v] -= x[r, u, v] * x[r, w, v]


@kernel()
def _pattern(data: Linearised) -> tuple[IntArray, IntArray]:
    """Columns of theta that each row of the weights touches, and where those of a row begin."""
    m, p, r = data.shared.shape[1], data.best.size, data.mixing.shape[1]
    size = data.degree + 1
    filled, starts = np.empty(2 * m, dtype=np.int64), np.zeros(m + 1, dtype=np.int64)
    count = 0
    for k in range(m):
        starts[k] = count
        if k < data.static:
            filled[count] = k
            count += 1
        elif k < m - 1:
            block = (k - data.static) // r
            if block < data.branches * size:
                filled[count] = data.static + block
                count += 1
        if k >= data.static:
            filled[count] = p
            count += 1
    starts[m] = count
    return filled[:count], starts


@kernel()
def _together(
    data: Linearised, points: FloatArray, first: int, count: int, mean: FloatArray, covariance: FloatArray,
    value: FloatArray,
) -> None:  # fmt: skip
    """Write mean and covariance of theta and the ln of the marginal likelihood of some points."""
    m, p = data.shared.shape[1], data.best.size
    at = data.branches + 1 + data.has_phi
    weights, full = np.empty((m, p + 1, LANES)), np.empty((p + 1, p + 1, LANES))
    reference, prior, noise = np.empty((LANES, p)), np.empty((LANES, p, p)), np.empty((LANES, 2))
    coefficient = np.empty((data.shared.shape[0], LANES))
    gain, tilt, inverse_sigma2, log_det = np.ones(LANES), np.empty(LANES), np.empty(LANES), np.zeros(LANES)
    for v in range(LANES):
        point = points[first + min(v, count - 1)]
        if v < count:
            own, reference[v], normal, prior[v], said, tilt[v] = begun(data, point)
            noise[v, 0], noise[v, 1] = said
            weights[:, :, v], full[:, :, v] = own, normal
            coefficient[:, v] = lag_weights(noise[v, 1], data.ratio)
        else:
            # lanes that are left over
            weights[:, :, v], full[:, :, v] = weights[:, :, 0], full[:, :, 0]
            coefficient[:, v], tilt[v], noise[v] = coefficient[:, 0], tilt[0], noise[0]
        inverse_sigma2[v] = 1.0 / noise[v, 0]
        if data.has_gain:
            gain[v] = np.exp(-2.0 * point[at])
    if data.cross.shape[2]:
        _integrate(data, coefficient, weights, _pattern(data), inverse_sigma2, gain, tilt, full, log_det)
    for v in range(count):
        normal = full[:, :, v].copy()
        for u in range(p + 1):
            for w in range(u):
                normal[w, u] = normal[u, w]
        said = noise[v, 0], noise[v, 1]
        mean[v], covariance[v], value[v] = finished(data, normal, log_det[v], reference[v], prior[v], said)


@kernel()
def log_marginals_together(data: Linearised, points: FloatArray) -> FloatArray:
    """As :func:`tissueid.likelihood.marginal.log_marginals`."""
    p = data.best.size
    out = np.empty(points.shape[0])
    mean, covariance, value = np.empty((LANES, p)), np.empty((LANES, p, p)), np.empty(LANES)
    for first in range(0, points.shape[0], LANES):
        count = min(LANES, points.shape[0] - first)
        _together(data, points, first, count, mean, covariance, value)
        for v in range(count):
            out[first + v] = -np.inf
            if np.isfinite(value[v]):
                mass = log_passive_mass(mean[v], covariance[v], data.blocks)
                out[first + v] = value[v] + mass - data.prior_log_mass
    return out


@kernel()
def log_peaks_together(data: Linearised, points: FloatArray, start: FloatArray) -> FloatArray:
    """As :func:`tissueid.likelihood.marginal.log_peaks`."""
    p = data.best.size
    out = np.empty(points.shape[0])
    mean, covariance, value = np.empty((LANES, p)), np.empty((LANES, p, p)), np.empty(LANES)
    for first in range(0, points.shape[0], LANES):
        count = min(LANES, points.shape[0] - first)
        _together(data, points, first, count, mean, covariance, value)
        for v in range(count):
            out[first + v] = -np.inf
            if np.isfinite(value[v]):
                out[first + v] = value[v] - short_of_passive(data, mean[v], covariance[v], start)
    return out
