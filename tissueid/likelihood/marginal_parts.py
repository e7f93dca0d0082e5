"""The marginal likelihood of :mod:`tissueid.likelihood.marginal` before and after the logs' effects."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.lag_kernels import lag_weights
from tissueid.likelihood.linearised import Linearised
from tissueid.likelihood.triangular import factor, inverse_factor, sparse_times, weighted_sum

__all__ = ["begun", "finished", "prior_precision"]

FloatArray = NDArray[np.float64]

LOG_TWO_PI = float(np.log(2.0 * np.pi))


@kernel()
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


@kernel()
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


@kernel()
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


@kernel()
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


@kernel()
def begun(
    data: Linearised, point: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[float, float], float]:
    """The normal equations of theta at one point of the sampled coordinates, effects not yet integrated.

    Parameters
    ----------
    data : Linearised
    point : ndarray, shape (d,)
        ln tau of every branch, ln sigma, arctanh phi (where sampled), ln of the gain's sd (where sampled).

    Returns
    -------
    weights : ndarray, shape (m, p + 1)
        Of the sums' columns in theta's columns and in what is to be explained.
    reference : ndarray, shape (p,)
        What theta is counted from.
    full : ndarray, shape (p + 1, p + 1)
        Over the noise variance.
    prior : ndarray, shape (p, p)
        Precision of theta.
    noise : tuple of float
        Its variance and correlation.
    tilt : float
        See :func:`_determined`.
    """
    at = data.branches
    sigma2 = np.exp(2.0 * point[at])
    phi = np.tanh(point[at + 1]) if data.has_phi else data.phi
    log_tau = point[: data.branches]
    weights, reference = _columns(data, log_tau)
    half = sparse_times(weights, weighted_sum(lag_weights(phi, data.ratio), data.shared))
    full = sparse_times(weights, np.ascontiguousarray(half.T)) / sigma2
    p = reference.size
    prior = prior_precision(data, log_tau)
    tilt = _determined(full[:p, :p], prior) if data.has_gain else 0.0
    return weights, reference, full, prior, (sigma2, phi), tilt


@kernel()
def finished(
    data: Linearised,
    full: FloatArray,
    log_det: float,
    reference: FloatArray,
    prior: FloatArray,
    noise: tuple[float, float],
) -> tuple[FloatArray, FloatArray, float]:
    """Mean and covariance of theta, and ln of the marginal likelihood, the passive mass not yet counted.

    Parameters
    ----------
    data : Linearised
    full, reference, prior, noise
        From :func:`begun`, the effects integrated.
    log_det : float
        Ln det of the effects' precision after, over that before the data.
    """
    sigma2, phi = noise
    p = reference.size
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
    return reference + t, inverse.T @ inverse, value
