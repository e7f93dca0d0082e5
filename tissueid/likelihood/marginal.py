"""The marginal likelihood of relaxation times and scales, everything linear integrated.

With the contact points and gains linearised at the joint optimum, a specimen's force is for given
relaxation times a linear Gaussian model

    e_i = C_i(tau) theta - C_i(tau^) theta^ + N_i u_i + noise,        u_i ~ N(mean_i, 1 / precision_i)

with e_i the residual at the optimum, theta the coefficients of F_s and K, and u_i the effects of log i (gain,
contact offset, or a free cubic).  theta has a normal prior cut to the passive cone.  Both are integrated in
closed form, on matrices whose size is that of the model; the whitening by AR(1) noise is a weighted sum of
a few such matrices (:mod:`tissueid.likelihood.lag_sums`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.cone import cone_least_squares
from tissueid.likelihood.lag_kernels import lag_weights
from tissueid.likelihood.linearised import Linearised
from tissueid.likelihood.marginal_parts import begun, finished
from tissueid.likelihood.passive_normal import log_passive_mass
from tissueid.likelihood.triangular import factor, inverse_factor, weigh

__all__ = [
    "conditionals",
    "draw_effects",
    "log_joints",
    "log_marginals",
    "log_peaks",
    "log_shares",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Reduced gradient, relative, to which the nearest passive theta is sought: a distance good to some 0.01.
NEAR_ENOUGH = 1e-7


@kernel()
def _effects_of(
    cross: FloatArray, own: FloatArray, coefficient: FloatArray, weights: FloatArray, filled: IntArray,
    sigma2: float, precision: FloatArray, mixed: FloatArray, x: FloatArray, low: FloatArray,
) -> None:  # fmt: skip
    """Effects of one log by theta's columns into ``x``, and the factor of their precision into ``low``."""
    weigh(coefficient, cross, mixed)
    for r in range(x.shape[0]):
        for at in range(filled.shape[0]):
            x[r, filled[at, 1]] += weights[filled[at, 0], filled[at, 1]] * mixed[r, filled[at, 0]]
        for u in range(x.shape[1]):
            x[r, u] /= sigma2
        for t in range(r + 1):
            value = 0.0
            for c in range(coefficient.size):
                value += coefficient[c] * own[c, r, t]
            value /= sigma2
            if t == r:
                value += precision[r]
            for k in range(t):
                value -= low[r, k] * low[t, k]
            low[r, t] = np.sqrt(value) if t == r else value / low[t, t]


@kernel()
def _without_effects(
    data: Linearised,
    coefficient: FloatArray,
    weights: FloatArray,
    sigma2: float,
    precision: FloatArray,
    full: FloatArray,
    tilt: float,
) -> tuple[FloatArray, FloatArray, float]:
    """Take the effects of every log out of the normal equations ``full`` (in place).

    ``tilt`` is the slope of -ln density in the mean of the gains, see ``marginal_parts._determined``.

    Returns
    -------
    back : ndarray, shape (logs, q, p + 1)
        Conditional mean of the effects: ``back[:, :, p] - back[:, :, :p] @ (theta - reference)``.
    spread : ndarray, shape (logs, q, q)
        Cholesky factor (lower) of their conditional precision.
    log_det : float
        ln det of the effects' precision after, over that before the data.
    """
    p = weights.shape[1] - 1
    logs, q = data.cross.shape[0], data.cross.shape[2]
    back = np.zeros((logs, q, p + 1))
    spread = np.zeros((logs, q, q))
    log_det = 0.0
    if q == 0:
        return back, spread, log_det
    # a coefficient of K touches the nodes of one branch
    filled = np.argwhere(weights)
    mixed = np.empty(data.cross.shape[2:])
    for i in range(logs):
        x, low = back[i], spread[i]
        _effects_of(
            data.cross[i], data.own[i], coefficient, weights, filled, sigma2, precision[i], mixed, x, low
        )
        for r in range(q):
            pull = precision[i, r] * data.effect_mean[i, r]
            x[r, p] += pull
            if r == 0:
                x[r, p] -= tilt / logs
            full[p, p] += pull * data.effect_mean[i, r]
            log_det += 2.0 * np.log(low[r, r]) - np.log(precision[i, r])
            for u in range(p + 1):
                for t in range(r):
                    x[r, u] -= low[r, t] * x[t, u]
                x[r, u] /= low[r, r]
        for r in range(q):
            for u in range(p + 1):
                for v in range(p + 1):
                    full[u, v] -= x[r, u] * x[r, v]
        for r in range(q - 1, -1, -1):
            for u in range(p + 1):
                for t in range(r + 1, q):
                    x[r, u] -= low[t, r] * x[t, u]
                x[r, u] /= low[r, r]
    return back, spread, log_det


@kernel()
def _conditional(
    data: Linearised, point: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Everything at one point of the sampled coordinates.

    Parameters
    ----------
    data : Linearised
    point : ndarray, shape (d,)
        ln tau of every branch, ln sigma, arctanh phi (where sampled), ln of the gain's sd (where sampled).

    Returns
    -------
    mean : ndarray, shape (p,)
        Of theta, before it is cut to the passive cone.
    covariance : ndarray, shape (p, p)
    reference : ndarray, shape (p,)
        What ``back`` counts theta from.
    back, spread : ndarray
        Conditional of the effects, see :func:`_without_effects`.
    value : float
        ln of the marginal likelihood, the mass of the cone not yet counted.
    """
    weights, reference, full, prior, noise, tilt = begun(data, point)
    precision = data.effect_precision
    if data.has_gain:
        precision = precision.copy()
        precision[:, 0] = np.exp(-2.0 * point[data.branches + 1 + data.has_phi])
    coefficient = lag_weights(noise[1], data.ratio)
    back, spread, log_det = _without_effects(data, coefficient, weights, noise[0], precision, full, tilt)
    mean, covariance, value = finished(data, full, log_det, reference, prior, noise)
    return mean, covariance, reference, back, spread, value


@kernel()
def log_marginals(data: Linearised, points: FloatArray) -> FloatArray:
    """Ln of the marginal likelihood at points of shape (n, d), the passive mass counted."""
    out = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        mean, covariance, _, _, _, value = _conditional(data, points[i])
        if np.isfinite(value):
            out[i] = value + log_passive_mass(mean, covariance, data.blocks) - data.prior_log_mass
        else:
            out[i] = -np.inf
    return out


@kernel()
def short_of_passive(data: Linearised, mean: FloatArray, covariance: FloatArray, start: FloatArray) -> float:
    """Half the squared distance from theta's mean to the passive cone, in its own standard deviations."""
    root = inverse_factor(factor(covariance))
    precision = np.ascontiguousarray(root.T) @ root
    b = precision @ mean
    nearest, _, _ = cone_least_squares(precision, b, data.blocks, start, NEAR_ENOUGH)
    away = nearest - mean
    return 0.5 * float(away @ (precision @ away))


@kernel()
def log_peaks(data: Linearised, points: FloatArray, start: FloatArray) -> FloatArray:
    """As :func:`log_marginals`, the density at the best passive theta in the place of the passive mass.

    Parameters
    ----------
    points : ndarray, shape (n, d)
    start : ndarray, shape (p, p)
        Generators of the cone (:func:`tissueid.likelihood.objective.cone_start`).
    """
    out = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        mean, covariance, _, _, _, value = _conditional(data, points[i])
        out[i] = -np.inf
        if np.isfinite(value):
            out[i] = value - short_of_passive(data, mean, covariance, start)
    return out


@kernel()
def log_shares(data: Linearised, points: FloatArray, start: FloatArray) -> FloatArray:
    """What :func:`log_marginals` has more than :func:`log_peaks`; NaN where there is no density."""
    out = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        mean, covariance, _, _, _, value = _conditional(data, points[i])
        out[i] = np.nan
        if np.isfinite(value):
            out[i] = log_passive_mass(mean, covariance, data.blocks) - data.prior_log_mass
            out[i] += short_of_passive(data, mean, covariance, start)
    return out


@kernel()
def conditionals(data: Linearised, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (n, p) and covariance (n, p, p) of theta at points, before it is cut to the passive cone."""
    p = data.best.size
    means = np.empty((points.shape[0], p))
    covariances = np.empty((points.shape[0], p, p))
    for i in range(points.shape[0]):
        mean, covariance, _, _, _, _ = _conditional(data, points[i])
        means[i] = mean
        covariances[i] = covariance
    return means, covariances


@kernel()
def log_joints(data: Linearised, points: FloatArray, theta: FloatArray) -> FloatArray:
    """Ln of the likelihood of points (n, d) and of theta (n, p) with its prior, effects integrated."""
    out = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        mean, covariance, _, _, _, value = _conditional(data, points[i])
        root = inverse_factor(factor(covariance))
        away = root @ (theta[i] - mean)
        out[i] = value - 0.5 * float(away @ away)
        for k in range(mean.size):
            out[i] += math.log(root[k, k])
    return out


@kernel()
def draw_effects(data: Linearised, points: FloatArray, theta: FloatArray, normal: FloatArray) -> FloatArray:
    """The effects of every log given theta.

    Parameters
    ----------
    points : ndarray, shape (n, d)
    theta : ndarray, shape (n, p)
    normal : ndarray, shape (n, logs, q)
        Standard normal numbers.

    Returns
    -------
    ndarray, shape (n, logs, q)
    """
    n, logs, q = normal.shape
    p = theta.shape[1]
    out = np.empty((n, logs, q))
    if q == 0:
        return out
    for i in range(n):
        _, _, reference, back, spread, _ = _conditional(data, points[i])
        moved = theta[i] - reference
        for log in range(logs):
            for r in range(q - 1, -1, -1):
                noise = normal[i, log, r]
                for s in range(r + 1, q):
                    noise -= spread[log, s, r] * (out[i, log, s])
                out[i, log, r] = noise / spread[log, r, r]
            for r in range(q):
                out[i, log, r] += back[log, r, p]
                for k in range(p):
                    out[i, log, r] -= back[log, r, k] * moved[k]
    return out
