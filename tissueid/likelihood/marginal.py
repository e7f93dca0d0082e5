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

import numba as nb
import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.cone import cone_least_squares
from tissueid.likelihood.lag_kernels import lag_weights
from tissueid.likelihood.linearised import Linearised
from tissueid.likelihood.passive_normal import log_passive_mass
from tissueid.likelihood.triangular import (
    factor,
    inverse_factor,
    sparse_times,
    weigh,
    weighted_sum,
)

__all__ = [
    "conditionals",
    "draw_effects",
    "log_marginals",
    "log_peaks",
    "log_shares",
    "prior_precision",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Reduced gradient, relative, to which the nearest passive theta is sought: a distance good to some 0.01.
NEAR_ENOUGH = 1e-7
LOG_TWO_PI = float(np.log(2.0 * np.pi))
STATIC_PARAMETERS = 3


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _interpolation(at: float, nodes: FloatArray, barycentric: FloatArray) -> FloatArray:
    """Weights of the nodes in the interpolating polynomial at one point (barycentric formula)."""
    out = np.zeros(nodes.size)
    total = 0.0
    for k in range(nodes.size):
        distance = at - nodes[k]
        if distance == 0.0:
            out[:] = 0.0
            out[k] = 1.0
            return out
        out[k] = barycentric[k] / distance
        total += out[k]
    return out / total


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _columns(data: Linearised, log_tau: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights of the sums' columns in (theta's columns, what is to be explained), and the reference theta.

    The reference keeps every viscosity K tau at its best value, so that what is left to explain is of the
    size of the noise, and no digits are lost between large numbers.
    """
    size = data.degree + 1
    r = data.mixing.shape[1]
    p = data.best.size
    weights = np.zeros((data.shared.shape[1], p + 1))
    reference = data.best.copy()
    for k in range(data.static):
        weights[k, k] = 1.0
    for j in range(data.branches):
        here = data.mixing[j] @ _interpolation(log_tau[j], data.nodes[j], data.barycentric[j])
        there = data.mixing[j] @ _interpolation(data.best_tau[j], data.nodes[j], data.barycentric[j])
        shrink = np.exp(data.best_tau[j] - log_tau[j])
        for q in range(size):
            at = data.static + j * size + q
            reference[at] = data.best[at] * shrink
            first = data.static + (j * size + q) * r
            for k in range(r):
                weights[first + k, at] = here[k]
                weights[first + k, p] = data.best[at] * there[k] - reference[at] * here[k]
    weights[-1, p] = 1.0
    return weights, reference


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _determined(gram: FloatArray, prior: FloatArray) -> float:
    """How many coefficients of theta the data determine at given gains: the trace of the shrinkage.

    Gains and theta enter as a product: the data pin e^c theta where all ln gains change by c.  At a gain of
    e^c the likelihood is e^-c as wide in every direction of theta that the data determine, so the density
    over c, theta integrated, carries e^(-n c) with n their number.  The linearised model has a likelihood of
    constant width and needs that factor: without it, gains that scatter by 15 % bias F_s and K by a quarter
    of their standard deviation.  Directions that the prior determines keep their width and do not count.
    """
    inverse = inverse_factor(factor(gram + prior))
    return float(np.sum((inverse.T @ inverse) * gram))


@nb.njit(cache=True, nogil=True, error_model="numpy")
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
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

    ``tilt`` is the slope of -ln density in the mean of the gains, see :func:`_determined`.

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


@nb.njit(cache=True, nogil=True, error_model="numpy")
def prior_precision(data: Linearised, log_tau: FloatArray) -> FloatArray:
    """Prior precision of theta at these relaxation times: a weak branch is known by its largest force.

    Parameters
    ----------
    data : Linearised
    log_tau : ndarray, shape (branches,)

    Returns
    -------
    ndarray, shape (p, p)
    """
    precision = data.prior_precision.copy()
    size = data.degree + 1
    for j in range(data.branches):
        if data.weak[j]:
            tau = np.exp(log_tau[j])
            state = 0.0
            for i in range(data.speed_mm_s.size):
                length = data.speed_mm_s[i] * tau
                state = max(state, -length * np.expm1(-data.depth_mm[i] / length))
            first = data.static + j * size
            for u in range(first, first + size):
                for v in range(first, first + size):
                    precision[u, v] *= state * state
    return precision


@nb.njit(cache=True, nogil=True, error_model="numpy")
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
    at = data.branches
    sigma2 = np.exp(2.0 * point[at])
    phi = data.phi
    if data.has_phi:
        at += 1
        phi = np.tanh(point[at])
    precision = data.effect_precision
    if data.has_gain:
        precision = precision.copy()
        precision[:, 0] = np.exp(-2.0 * point[at + 1])
    log_tau = point[: data.branches]
    weights, reference = _columns(data, log_tau)
    coefficient = lag_weights(phi, data.ratio)
    half = sparse_times(weights, weighted_sum(coefficient, data.shared))
    full = sparse_times(weights, np.ascontiguousarray(half.T)) / sigma2
    p = reference.size
    prior = prior_precision(data, log_tau)
    tilt = _determined(full[:p, :p], prior) if data.has_gain else 0.0
    back, spread, log_det = _without_effects(data, coefficient, weights, sigma2, precision, full, tilt)
    away = data.prior_mean - reference
    pull = prior @ away
    low = factor(full[:p, :p] + prior)
    before = factor(prior)
    t = full[:p, p] + pull
    c = full[p, p] + away @ pull
    for i in range(p):
        for k in range(i):
            t[i] -= low[i, k] * t[k]
        t[i] /= low[i, i]
        c -= t[i] * t[i]
        log_det += 2.0 * (np.log(low[i, i]) - np.log(before[i, i]))
    for i in range(p - 1, -1, -1):
        for k in range(i + 1, p):
            t[i] -= low[k, i] * t[k]
        t[i] /= low[i, i]
    for k in range(data.ratio.size):
        if phi > 0.0:
            log_det += data.links[k] * np.log1p(-(phi ** (2.0 * data.ratio[k])))
    value = -0.5 * (data.samples * (LOG_TWO_PI + np.log(sigma2)) + log_det + c)
    inverse = inverse_factor(low)
    return reference + t, inverse.T @ inverse, reference, back, spread, value


@nb.njit(cache=True, nogil=True, error_model="numpy")
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _short_of_passive(data: Linearised, mean: FloatArray, covariance: FloatArray, start: FloatArray) -> float:
    """Half the squared distance from theta's mean to the passive cone, in its own standard deviations."""
    root = inverse_factor(factor(covariance))
    precision = np.ascontiguousarray(root.T) @ root
    b = precision @ mean
    nearest, _, _ = cone_least_squares(precision, b, data.blocks, start, NEAR_ENOUGH)
    away = nearest - mean
    return 0.5 * float(away @ (precision @ away))


@nb.njit(cache=True, nogil=True, error_model="numpy")
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
            out[i] = value - _short_of_passive(data, mean, covariance, start)
    return out


@nb.njit(cache=True, nogil=True, error_model="numpy")
def log_shares(data: Linearised, points: FloatArray, start: FloatArray) -> FloatArray:
    """What :func:`log_marginals` has more than :func:`log_peaks`; NaN where there is no density."""
    out = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        mean, covariance, _, _, _, value = _conditional(data, points[i])
        out[i] = np.nan
        if np.isfinite(value):
            out[i] = log_passive_mass(mean, covariance, data.blocks) - data.prior_log_mass
            out[i] += _short_of_passive(data, mean, covariance, start)
    return out


@nb.njit(cache=True, nogil=True, error_model="numpy")
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
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
