"""Normal equations of a specimen on knots at many points side by side, the effects of the logs integrated.

The same arithmetic as :mod:`tissueid.likelihood.knot_terms`, :data:`LANES` points at a time
(:mod:`tissueid.likelihood.lanes`), log by log, so that nothing is kept of a log.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.channel_lanes import channels
from tissueid.likelihood.instrument_kernels import RELAXATION, TISSUE, Packed, effect_count
from tissueid.likelihood.instrument_lanes import tissue_paths
from tissueid.likelihood.lanes import LANES

__all__ = ["Terms", "integrated_terms"]

FloatArray = NDArray[np.float64]


class Terms(NamedTuple):
    """What differs from point to point, beside the tissue and the instrument.

    Attributes
    ----------
    gamma, delta : ndarray, shape (logs, LANES)
        Log gains and contact offsets [mm] about which effects are linear.
    share : ndarray, shape (k, LANES)
        Weights of the sums at a few correlations; of shape (0, LANES) where those of the logs stand.
    pulls, bands, squares : ndarray, shape (k, m), (k, m, w), (k, logs)
        Of each of those correlations.
    precision, mean : ndarray, shape (logs, q, LANES)
        Prior of the effects, counted from where they are linearised.
    weight : ndarray, shape (logs, LANES)
        Weight of each log; 1 for all but a bootstrap.
    sigma2 : ndarray, shape (LANES,)
        Noise variance [N^2].
    """

    gamma: FloatArray
    delta: FloatArray
    share: FloatArray
    pulls: FloatArray
    bands: FloatArray
    squares: FloatArray
    precision: FloatArray
    mean: FloatArray
    weight: FloatArray
    sigma2: FloatArray


@kernel(fastmath={"contract"})
def _sums_at(
    data: Packed, terms: Terms, log: int, pull: FloatArray, band: FloatArray, square: FloatArray
) -> None:
    """Sums of one log at every point's correlation."""
    begin, few = data.first[log], terms.share.shape[0]
    for v in range(LANES):
        square[v] = data.square[log] if few == 0 else 0.0
    for k in range(few):
        for v in range(LANES):
            square[v] += terms.share[k, v] * terms.squares[k, log]
    for i in range(pull.shape[0]):
        for v in range(LANES):
            pull[i, v] = data.pull[begin + i] if few == 0 else 0.0
        for k in range(few):
            for v in range(LANES):
                pull[i, v] += terms.share[k, v] * terms.pulls[k, begin + i]
        for d in range(band.shape[1]):
            for v in range(LANES):
                band[i, d, v] = data.band[begin + i, d] if few == 0 else 0.0
            for k in range(few):
                for v in range(LANES):
                    band[i, d, v] += terms.share[k, v] * terms.bands[k, begin + i, d]


@kernel(fastmath={"contract"})
def _times_band(band: FloatArray, x: FloatArray, q: int, out: FloatArray) -> None:
    """Product of symmetric band matrices with the vectors ``x[q]``."""
    n, width = band.shape[0], band.shape[1]
    for k in range(n):
        for v in range(LANES):
            out[k, v] = band[k, 0, v] * x[q, k, v]
    for d in range(1, width):
        for k in range(n - d):
            for v in range(LANES):
                out[k, v] += band[k, d, v] * x[q, k + d, v]
            for v in range(LANES):
                out[k + d, v] += band[k, d, v] * x[q, k, v]


@kernel(fastmath={"contract"})
def _products(
    data: Packed, begin: int, change: FloatArray, shown: FloatArray, sums: tuple[FloatArray, FloatArray],
    white: FloatArray, gram: FloatArray, slope: FloatArray, square: FloatArray,
) -> None:  # fmt: skip
    """Write normal equations of one log, and add to its sum of squares what it has more than the optimum's.

    ``change[0]`` is the force that is shown, and becomes what is left.
    """
    pull, band = sums
    columns, n = shown.shape[0], shown.shape[1]
    for k in range(n):
        for v in range(LANES):
            change[0, k, v] -= data.base[begin + k]
    _times_band(band, change, 0, white)
    for k in range(n):
        for v in range(LANES):
            left = pull[k, v] - white[k, v]
            square[v] -= change[0, k, v] * (pull[k, v] + left)
            white[k, v] = left
        for v in range(LANES):
            change[0, k, v] = white[k, v]
    for q in range(columns):
        _times_band(band, shown, q, white)
        for r in range(q + 1):
            for v in range(LANES):
                gram[q, r, v] = 0.0
            for k in range(n):
                for v in range(LANES):
                    gram[q, r, v] += shown[r, k, v] * white[k, v]
        for v in range(LANES):
            slope[q, v] = 0.0
        for k in range(n):
            for v in range(LANES):
                slope[q, v] += shown[q, k, v] * change[0, k, v]


@kernel(fastmath={"contract"})
def _integrate(
    terms: Terms, log: int, gram: FloatArray, pull: FloatArray, square: FloatArray, low: FloatArray,
    x: FloatArray, scale: FloatArray, curvature: FloatArray, slope: FloatArray, value: FloatArray,
) -> None:  # fmt: skip
    """Add one log without its effects; see :func:`tissueid.likelihood.knot_terms.without_effects`."""
    q = terms.precision.shape[1]
    v_count = pull.shape[0] - q
    for v in range(LANES):
        scale[v] = terms.weight[log, v] / terms.sigma2[v]
        value[v] -= 0.5 * scale[v] * square[v]
    for i in range(v_count):
        for v in range(LANES):
            slope[i, v] += scale[v] * pull[q + i, v]
        for j in range(i + 1):
            for v in range(LANES):
                curvature[i, j, v] += scale[v] * gram[q + i, q + j, v]
    for i in range(q):
        for v in range(LANES):
            weight = terms.weight[log, v]
            pulled = weight * terms.precision[log, i, v] * terms.mean[log, i, v]
            value[v] -= 0.5 * pulled * terms.mean[log, i, v]
            x[i, v_count, v] = scale[v] * pull[i, v] + pulled
        for j in range(v_count):
            for v in range(LANES):
                x[i, j, v] = scale[v] * gram[q + j, i, v]
        for j in range(i + 1):
            for v in range(LANES):
                entry = scale[v] * gram[i, j, v]
                if i == j:
                    entry += terms.weight[log, v] * terms.precision[log, i, v]
                for k in range(j):
                    entry -= low[i, k, v] * low[j, k, v]
                low[i, j, v] = np.sqrt(entry) if i == j else entry / low[j, j, v]
        for v in range(LANES):
            if terms.weight[log, v] > 0.0:
                value[v] -= np.log(low[i, i, v]) - 0.5 * np.log(terms.precision[log, i, v])
            else:
                # nothing is known of this log, and nothing is asked
                low[i, i, v] = 1.0
        for j in range(v_count + 1):
            for k in range(i):
                for v in range(LANES):
                    x[i, j, v] -= low[i, k, v] * x[k, j, v]
            for v in range(LANES):
                x[i, j, v] /= low[i, i, v]
        for j in range(v_count):
            for v in range(LANES):
                slope[j, v] -= x[i, j, v] * x[i, v_count, v]
            for k in range(j + 1):
                for v in range(LANES):
                    curvature[j, k, v] -= x[i, j, v] * x[i, k, v]
        for v in range(LANES):
            value[v] += 0.5 * x[i, v_count, v] * x[i, v_count, v]


@kernel(fastmath={"contract"})
def integrated_terms(
    data: Packed, terms: Terms, theta: FloatArray, tau: FloatArray, instrument: FloatArray, kind: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Curvature, slope and value of the log likelihood of :data:`LANES` points, effects integrated.

    Parameters
    ----------
    data : Packed
    terms : Terms
    theta, tau, instrument : ndarray, shape (p, LANES), (branches, LANES) and (3, LANES)
        Relaxation times [s]; skew [s], filter [s] and compliance [mm/N].
    kind : int
        As in :func:`tissueid.likelihood.knot_terms.log_terms`; :data:`RELAXATION` at the most.

    Returns
    -------
    curvature : ndarray, shape (v, v, LANES)
    slope : ndarray, shape (v, LANES)
    value : ndarray, shape (LANES,)
    """
    effects = effect_count(data)
    count = theta.shape[0] if kind >= TISSUE else 0
    count += tau.shape[0] if kind >= RELAXATION else 0
    columns = effects + count
    curvature, slope, value = np.zeros((count, count, LANES)), np.zeros((count, LANES)), np.zeros(LANES)
    gram, pull = np.empty((columns, columns, LANES)), np.empty((columns, LANES))
    low, x = np.zeros((effects, effects, LANES)), np.empty((effects, count + 1, LANES))
    square, scale = np.empty(LANES), np.empty(LANES)
    width = data.band.shape[1] if terms.share.shape[0] == 0 else terms.bands.shape[2]
    for log in range(data.first.size - 1):
        begin = data.first[log]
        n = data.first[log + 1] - begin
        rates, change = np.empty((3, n, LANES)), np.empty((1, n, LANES))
        tissue, shown = np.empty((columns, n, LANES)), np.empty((columns, n, LANES))
        pulled, band = np.empty((n, LANES)), np.empty((n, width, LANES))
        tissue_paths(data, log, theta, tau, instrument[2], terms.gamma, terms.delta, kind, rates, tissue)
        channels(data.time_s, begin, rates, tissue, instrument[0], instrument[1], change[0], shown)
        _sums_at(data, terms, log, pulled, band, square)
        _products(data, begin, change, shown, (pulled, band), rates[0], gram, pull, square)
        _integrate(terms, log, gram, pull, square, low, x, scale, curvature, slope, value)
    for i in range(count):
        for j in range(i):
            for v in range(LANES):
                curvature[j, i, v] = curvature[i, j, v]
    return curvature, slope, value
