"""Compiled fit of a specimen on knots, started at an optimum, its logs weighted anew."""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.cone import cone_least_squares
from tissueid.likelihood.instrument_density import Density, effect_prior, inverse, tissue_precision
from tissueid.likelihood.instrument_kernels import RELAXATION
from tissueid.likelihood.knot_terms import log_terms, without_effects

__all__ = ["refits"]

FloatArray = NDArray[np.float64]

#: Gauss-Newton steps of a replicate; after the first the change is some hundredths of it.
STEPS = 3
#: Largest step in ln tau.
REACH = 0.5
#: Curvature of ln tau below which it is not moved: its standard deviation would be a thousand.
IDLE = 1e-6


@nb.njit(cache=True, nogil=True, error_model="numpy")
def refits(
    density: Density,
    weights: FloatArray,
    fixed: tuple[FloatArray, float],
    stated: tuple[FloatArray, FloatArray],
    bounds: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """Theta by powers of u and ln tau of every replicate.

    Parameters
    ----------
    density : Density
        Its ``theta`` and ``mode`` are where each begins.
    weights : ndarray, shape (n, logs)
    fixed : tuple
        What is held: skew, filter and compliance, shape (3,), and the standard deviation of the gains.
    stated : tuple of ndarray, shape (branches,)
        Prior mean of ln tau, and its precision: 0 where nothing is stated.
    bounds : tuple of float
        Of ln tau.

    Returns
    -------
    theta : ndarray, shape (n, p)
    log_tau : ndarray, shape (n, branches)
    """
    data, p, branches = density.data, density.theta.size, density.data.branches
    instrument, gain_sd = fixed
    mean, precision = stated
    begin = density.mode[:branches].copy()
    effect_precision, effect_mean = effect_prior(density, data, gain_sd)
    first = log_terms(data, density.theta, begin, instrument, RELAXATION)
    thetas, taus = np.empty((weights.shape[0], p)), np.empty((weights.shape[0], branches))
    for i in range(weights.shape[0]):
        theta, log_tau = density.theta, begin
        for step in range(STEPS):
            terms = log_terms(data, theta, log_tau, instrument, RELAXATION) if step else first
            curvature, slope, _, _ = without_effects(
                terms[0], terms[1], terms[2], weights[i], effect_precision, effect_mean, density.sigma2
            )
            prior = tissue_precision(density, log_tau)
            curvature[:p, :p] += prior
            slope[:p] += prior @ (density.prior_mean - theta)
            for j in range(branches):
                curvature[p + j, p + j] += precision[j]
                slope[p + j] -= (log_tau[j] - mean[j]) * precision[j]
                # a branch without stiffness says nothing of its relaxation time, which then stays
                if curvature[p + j, p + j] < IDLE:
                    curvature[p + j, p + j] += 1.0
            change = (inverse(curvature) @ slope)[p:]
            change = np.minimum(np.maximum(change, -REACH), REACH)
            change = np.minimum(np.maximum(log_tau + change, bounds[0]), bounds[1]) - log_tau
            block = np.ascontiguousarray(curvature[:p, :p])
            target = block @ theta + slope[:p] - np.ascontiguousarray(curvature[:p, p:]) @ change
            theta = cone_least_squares(block, target, density.blocks, density.start)[0]
            log_tau = log_tau + change
        thetas[i], taus[i] = theta, log_tau
    return thetas, taus
