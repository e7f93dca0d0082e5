"""Compiled density of a tissue behind its instrument, at one point.

What it means is in :mod:`tissueid.posterior.instrument`; thousands of points go side by side, in
:mod:`tissueid.likelihood.density_lanes`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.instrument_kernels import (
    EFFECTS,
    INSTRUMENT,
    STATIC_TERMS,
    Packed,
    effect_count,
)
from tissueid.likelihood.knot_terms import log_terms, without_effects
from tissueid.likelihood.triangular import factor, inverse_factor

__all__ = [
    "SMALLEST_GAIN", "SMALLEST_SPREAD", "Density", "correlation_shares", "effect_prior", "inverse",
    "log_likelihood", "log_theta_prior", "tissue_precision", "tissue_precisions",
]  # fmt: skip

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Gains below this fraction of the linearised one are taken as it.
SMALLEST_GAIN = 0.05
#: A spread of ln gain below this is none; its square would be lost.
SMALLEST_SPREAD = 1e-5
#: Ridge of a matrix of unit diagonal that is inverted.
RIDGE = 1e-12


class Density(NamedTuple):
    """A specimen behind its instrument, as the kernels want it.

    Attributes
    ----------
    data : Packed
        With effects linearised where they are likely at the mode.
    sigma2 : float
        Noise variance [N^2], where it is no coordinate.
    theta, mode, slope, curvature, follow : ndarray
        As in :class:`tissueid.posterior.instrument.Behind`; ``follow`` is empty before the mode is known.
    prior_mean, prior_precision, weak : ndarray
        Prior of theta, and which branches are weak (at a state of 1 mm).
    speed_mm_s, reach_mm : ndarray, shape (ramps,)
        Of every ramp.
    offset_precision, offset_mean : ndarray, shape (logs,)
        Prior of the contact offsets [1/mm^2, mm].
    free_precision : float
        Of a log's own static coefficients [1/N^2].
    blocks : ndarray of int
    start : ndarray, shape (p, p)
        Generators of the cone (:func:`tissueid.likelihood.objective.cone_start`).
    phi : ndarray, shape (k,)
        Correlations that the logs were summed with; none where the noise is held or white.
    pulls, bands, squares : ndarray, shape (k, ...)
        Of each.
    loose : bool
        The scale of the noise is a coordinate.
    """

    data: Packed
    sigma2: float
    theta: FloatArray
    mode: FloatArray
    slope: FloatArray
    curvature: FloatArray
    follow: FloatArray
    prior_mean: FloatArray
    prior_precision: FloatArray
    weak: NDArray[np.bool_]
    speed_mm_s: FloatArray
    reach_mm: FloatArray
    offset_precision: FloatArray
    offset_mean: FloatArray
    free_precision: float
    blocks: IntArray
    start: FloatArray
    phi: FloatArray
    pulls: FloatArray
    bands: FloatArray
    squares: FloatArray
    loose: bool


@kernel()
def tissue_precision(density: Density, log_tau: FloatArray) -> FloatArray:
    """Prior precision of theta; a weak branch is known by its largest force.

    Parameters
    ----------
    density : Density
    log_tau : ndarray, shape (branches,)

    Returns
    -------
    ndarray, shape (p, p)
    """
    precision = density.prior_precision.copy()
    size = density.data.degree + 1
    for j in range(density.data.branches):
        if not density.weak[j]:
            continue
        tau = math.exp(log_tau[j])
        state = 0.0
        for i in range(density.speed_mm_s.size):
            length = density.speed_mm_s[i] * tau
            state = max(state, -length * math.expm1(-density.reach_mm[i] / length))
        first = density.data.static + j * size
        for u in range(first, first + size):
            for v in range(first, first + size):
                precision[u, v] *= state * state
    return precision


@kernel()
def tissue_precisions(density: Density, log_tau: FloatArray) -> FloatArray:
    """Prior precision of theta at several relaxation times, shape (n, branches); shape (n, p, p)."""
    p = density.prior_mean.size
    out = np.empty((log_tau.shape[0], p, p))
    for i in range(log_tau.shape[0]):
        out[i] = tissue_precision(density, log_tau[i])
    return out


@kernel()
def effect_prior(density: Density, data: Packed, gain_sd: float) -> tuple[FloatArray, FloatArray]:
    """Precision and mean of the effects, counted from where ``data`` has them; shapes (logs, q)."""
    logs = data.gamma.size
    precision, mean = np.zeros((2, logs, effect_count(data)))
    for log in range(logs):
        at = 0
        if data.gain:
            precision[log, 0] = gain_sd**-2.0
            mean[log, 0] = -data.gamma[log]
            at = 1
        if data.offset:
            precision[log, at] = density.offset_precision[log]
            mean[log, at] = density.offset_mean[log] - data.delta[log]
            at += 1
        if data.free:
            for k in range(STATIC_TERMS):
                precision[log, at + k] = density.free_precision
                mean[log, at + k] = -data.own[log, k]
    return precision, mean


@kernel()
def correlation_shares(density: Density, arctanh_phi: float) -> FloatArray:
    """Weights of the sums at a few correlations in those at another, shape (k,)."""
    phi = math.tanh(arctanh_phi)
    out = np.empty(density.phi.size)
    for k in range(density.phi.size):
        own = density.phi[k]
        weight = (1.0 - own * own) / (1.0 - phi * phi)
        for other in range(density.phi.size):
            if other != k:
                weight *= (phi - density.phi[other]) / (own - density.phi[other])
        out[k] = weight
    return out


@kernel()
def _whitened_at(density: Density, arctanh_phi: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sums on knots at another correlation, from those at a few."""
    pull = np.zeros(density.pulls.shape[1])
    band = np.zeros(density.bands.shape[1:])
    square = np.zeros(density.squares.shape[1])
    shares = correlation_shares(density, arctanh_phi)
    for k in range(shares.size):
        pull += shares[k] * density.pulls[k]
        band += shares[k] * density.bands[k]
        square += shares[k] * density.squares[k]
    return pull, band, square


@kernel()
def _data_at(density: Density, point: FloatArray, theta: FloatArray) -> Packed:
    """The logs with their gains and offsets linearised where they are likely for this theta.

    A gain multiplies theta: where the tissue is stiffer the gains of all logs are less.  To first order
    ``u = back . change``, with the tissue by a factor 1 - u; it is 1/(1 - u) that keeps their product.
    Without this 30 gains of 15 % would move the tissue by 2 %.
    """
    data = density.data
    pull, band, square = data.pull, data.band, data.square
    gamma, delta = data.gamma, data.delta
    inner = data.branches + INSTRUMENT
    if density.phi.size:
        pull, band, square = _whitened_at(density, point[point.size - 1])
    if density.follow.shape[2]:
        p = theta.size
        gamma, delta = gamma.copy(), delta.copy()
        for log in range(gamma.size):
            for effect in range(density.follow.shape[1]):
                moved = 0.0
                for k in range(p):
                    moved += density.follow[log, effect, k] * (theta[k] - density.theta[k])
                for k in range(inner):
                    moved += density.follow[log, effect, p + k] * (point[k] - density.mode[k])
                if data.gain and effect == 0:
                    gamma[log] -= math.log1p(-min(moved, 1.0 - SMALLEST_GAIN))
                else:
                    delta[log] += moved
    return Packed(
        data.time_s, data.depth_mm, data.first, pull, band, square, data.base, data.scale, data.degree,
        data.branches, data.static, gamma, delta, data.own, data.gain, data.offset, data.free,
    )  # fmt: skip


@kernel()
def _value(density: Density, point: FloatArray, theta: FloatArray) -> float:
    """The log likelihood, effects integrated."""
    branches = density.data.branches
    inner = branches + INSTRUMENT
    at = inner
    gain_sd = 1.0
    if density.data.gain:
        gain_sd = max(point[at], SMALLEST_SPREAD)
        at += 1
    sigma2 = math.exp(2.0 * point[at]) if density.loose else density.sigma2
    data = _data_at(density, point, theta)
    gram, pull, square = log_terms(data, theta, point[:branches], point[branches:inner], EFFECTS)
    precision, mean = effect_prior(density, data, gain_sd)
    return float(without_effects(gram, pull, square, np.ones(square.size), precision, mean, sigma2)[2])


@kernel()
def log_theta_prior(density: Density, point: FloatArray, theta: FloatArray) -> float:
    """Ln of theta's prior at one point, up to a constant; arguments as in :func:`log_likelihood`."""
    precision = tissue_precision(density, point[: density.data.branches])
    low = factor(precision)
    value = 0.0
    for i in range(theta.size):
        value += math.log(low[i, i])
        for k in range(theta.size):
            away = (theta[i] - density.prior_mean[i]) * (theta[k] - density.prior_mean[k])
            value -= 0.5 * precision[i, k] * away
    return value


@kernel()
def log_likelihood(density: Density, point: FloatArray, theta: FloatArray) -> float:
    """Ln of the likelihood and of theta's prior at one point, up to a constant.

    Parameters
    ----------
    density : Density
    point : ndarray, shape (d,)
        Coordinates; their own prior is not counted.
    theta : ndarray, shape (p,)
    """
    return log_theta_prior(density, point, theta) + _value(density, point, theta)


@kernel()
def inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a positive definite matrix, scaled first."""
    n = matrix.shape[0]
    unit = np.empty(n)
    scaled = np.empty((n, n))
    for i in range(n):
        unit[i] = 1.0 / math.sqrt(max(matrix[i, i], 1e-300))
    for i in range(n):
        for k in range(n):
            scaled[i, k] = matrix[i, k] * unit[i] * unit[k]
        scaled[i, i] += RIDGE
    root = inverse_factor(factor(scaled))
    out = np.empty((n, n))
    for i in range(n):
        for k in range(i + 1):
            total = 0.0
            for j in range(i, n):
                total += root[j, i] * root[j, k]
            out[i, k] = total * unit[i] * unit[k]
            out[k, i] = out[i, k]
    return out
