"""Compiled density of a tissue behind its instrument, and the normal of its coefficients, at many points.

What it means is in :mod:`tissueid.posterior.instrument`.  Points go side by side
(:mod:`tissueid.likelihood.lanes`); the result of each depends on itself alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.bernstein import is_passive
from tissueid.likelihood.cone import cone_least_squares
from tissueid.likelihood.instrument_density import (
    SMALLEST_GAIN,
    SMALLEST_SPREAD,
    Density,
    correlation_shares,
    inverse,
    log_theta_prior,
    tissue_precision,
)
from tissueid.likelihood.instrument_kernels import EFFECTS, INSTRUMENT, STATIC_TERMS, TISSUE, effect_count
from tissueid.likelihood.lanes import LANES, gathered
from tissueid.likelihood.passive_normal import log_passive_mass
from tissueid.likelihood.term_lanes import Terms, integrated_terms
from tissueid.likelihood.triangular import factor, solved

__all__ = ["conditionals", "log_ratios"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Rounds for theta behind a frame, and the step, in standard deviations squared, that is the last: Newton's
#: next one would be its square, and draws are weighted by the exact density anyway.
TISSUE_ROUNDS = 6
SETTLED = 0.5
#: Dual tolerance of the passive theta about which is linearised.
NEAR_ENOUGH = 1e-6


@kernel()
def _effects_at(density: Density, points: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gains and offsets linearised where they are likely for each theta, shapes (logs, LANES).

    A gain multiplies theta: where the tissue is stiffer the gains of all logs are less.  To first order
    ``u = back . change``, with the tissue by a factor 1 - u; it is 1/(1 - u) that keeps their product.
    Without this 30 gains of 15 % would move the tissue by 2 %.
    """
    data, p = density.data, theta.shape[0]
    logs, inner = data.gamma.size, data.branches + INSTRUMENT
    gamma, delta, moved = np.empty((logs, LANES)), np.empty((logs, LANES)), np.empty(LANES)
    for log in range(logs):
        for v in range(LANES):
            gamma[log, v] = data.gamma[log]
            delta[log, v] = data.delta[log]
        if density.follow.shape[2] == 0:
            continue
        for effect in range(density.follow.shape[1]):
            for v in range(LANES):
                moved[v] = 0.0
            for k in range(p):
                by = density.follow[log, effect, k]
                for v in range(LANES):
                    moved[v] += by * (theta[k, v] - density.theta[k])
            for k in range(inner):
                by = density.follow[log, effect, p + k]
                for v in range(LANES):
                    moved[v] += by * (points[k, v] - density.mode[k])
            for v in range(LANES):
                if data.gain and effect == 0:
                    gamma[log, v] -= math.log1p(-min(moved[v], 1.0 - SMALLEST_GAIN))
                else:
                    delta[log, v] += moved[v]
    return gamma, delta


@kernel()
def _terms_at(density: Density, points: FloatArray, theta: FloatArray) -> Terms:
    """What differs from point to point; ``points`` of shape (d, LANES), ``theta`` of shape (p, LANES)."""
    data = density.data
    logs = data.gamma.size
    at = data.branches + INSTRUMENT
    gamma, delta = _effects_at(density, points, theta)
    precision, mean = np.zeros((2, logs, effect_count(data), LANES))
    share, sigma2 = np.empty((density.phi.size, LANES)), np.empty(LANES)
    for v in range(LANES):
        scale = at + 1 if data.gain else at
        sigma2[v] = math.exp(2.0 * points[scale, v]) if density.loose else density.sigma2
        if density.phi.size:
            share[:, v] = correlation_shares(density, points[points.shape[0] - 1, v])
    for log in range(logs):
        effect = 0
        if data.gain:
            for v in range(LANES):
                gain_sd = max(points[at, v], SMALLEST_SPREAD)
                precision[log, 0, v] = gain_sd**-2.0
                mean[log, 0, v] = -gamma[log, v]
            effect = 1
        if data.offset:
            for v in range(LANES):
                precision[log, effect, v] = density.offset_precision[log]
                mean[log, effect, v] = density.offset_mean[log] - delta[log, v]
            effect += 1
        if data.free:
            for k in range(STATIC_TERMS):
                for v in range(LANES):
                    precision[log, effect + k, v] = density.free_precision
                    mean[log, effect + k, v] = -data.own[log, k]
    return Terms(
        gamma, delta, share, density.pulls, density.bands, density.squares, precision, mean,
        np.ones((logs, LANES)), sigma2,
    )  # fmt: skip


@kernel()
def _normals(
    density: Density, points: FloatArray, rows: IntArray, theta: FloatArray, kind: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Curvature, slope and value of the log likelihood of at most LANES points, effects integrated."""
    branches = density.data.branches
    side = gathered(points, rows, 0, points.shape[1])
    tissue = gathered(theta, rows, 0, theta.shape[1])
    return integrated_terms(
        density.data,
        _terms_at(density, side, tissue),
        tissue,
        np.exp(side[:branches]),
        side[branches : branches + INSTRUMENT],
        kind,
    )


@kernel()
def _nearest(density: Density, centre: FloatArray, curvature: FloatArray) -> FloatArray:
    """The passive theta nearest to a centre: what is left of its normal lies there."""
    if is_passive(centre, density.blocks):
        return centre
    return cone_least_squares(curvature, curvature @ centre, density.blocks, density.start, NEAR_ENOUGH)[0]


@kernel()
def conditionals(
    density: Density, points: FloatArray, rows: IntArray, mean: FloatArray, covariance: FloatArray
) -> None:
    """Write mean and covariance of theta at some of the points, before it is cut to the passive set.

    Linearised where the cut normal has most of its mass, which may be far from that mean.

    Parameters
    ----------
    density : Density
    points : ndarray, shape (n, d)
    rows : ndarray of int
        Which of them.
    mean, covariance : ndarray, shape (n, p) and (n, p, p)
        Written.
    """
    p, branches = density.theta.size, density.data.branches
    own = np.ascontiguousarray(density.curvature[:p, :p])
    theta = np.empty((points.shape[0], p))
    for i in rows:
        theta[i] = _nearest(density, density.theta + density.slope @ (points[i] - density.mode), own)
    moving = rows.copy()
    count = moving.size
    for _ in range(TISSUE_ROUNDS):
        left = 0
        for first in range(0, count, LANES):
            some = moving[first : min(first + LANES, count)].copy()
            curvatures, slopes, _ = _normals(density, points, some, theta, TISSUE)
            for v in range(some.size):
                i = some[v]
                precision = tissue_precision(density, points[i, :branches])
                curvature = curvatures[:, :, v] + precision
                covariance[i] = inverse(curvature)
                pull = slopes[:, v] + precision @ (density.prior_mean - theta[i])
                mean[i] = theta[i] + covariance[i] @ pull
                if points[i, branches + INSTRUMENT - 1] == 0.0:
                    continue
                step = _nearest(density, mean[i], curvature) - theta[i]
                if not step @ (curvature @ step) < SETTLED:
                    theta[i] += step
                    moving[left] = i
                    left += 1
        count = left


@kernel()
def log_ratios(
    density: Density,
    points: FloatArray,
    rows: IntArray,
    theta: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    out: FloatArray,
) -> None:
    """Write the log likelihood of some points over the density that theta was drawn with there.

    Parameters
    ----------
    density : Density
    points, rows, mean, covariance
        From :func:`conditionals`.
    theta : ndarray, shape (n, p)
        Drawn from the normals, cut to the passive set.
    out : ndarray, shape (n,)
        Written.
    """
    for first in range(0, rows.size, LANES):
        some = rows[first : first + LANES].copy()
        values = _normals(density, points, some, theta, EFFECTS)[2]
        for v in range(some.size):
            i = some[v]
            low = factor(covariance[i])
            z = solved(low, theta[i] - mean[i])
            drawn = -0.5 * (z @ z)
            for k in range(z.size):
                drawn -= math.log(low[k, k])
            drawn -= log_passive_mass(mean[i], covariance[i], density.blocks)
            out[i] = log_theta_prior(density, points[i], theta[i]) + values[v] - drawn
