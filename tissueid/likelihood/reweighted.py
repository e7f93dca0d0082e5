"""Compiled fit of a specimen on knots, started at an optimum, its logs weighted anew."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.cone import cone_least_squares
from tissueid.likelihood.instrument_density import Density, effect_prior, inverse, tissue_precision
from tissueid.likelihood.instrument_kernels import RELAXATION
from tissueid.likelihood.knot_terms import log_terms, without_effects
from tissueid.likelihood.lanes import LANES, gathered
from tissueid.likelihood.term_lanes import Terms, integrated_terms

__all__ = ["refits"]

FloatArray = NDArray[np.float64]

#: Gauss-Newton steps of a replicate; after the first the change is some hundredths of it.
STEPS = 3
#: Largest step in ln tau.
REACH = 0.5
#: Curvature of ln tau below which it is not moved: its standard deviation would be a thousand.
IDLE = 1e-6


@kernel()
def _stepped(
    density: Density,
    curvature: FloatArray,
    slope: FloatArray,
    stated: tuple[FloatArray, FloatArray],
    bounds: tuple[float, float],
    theta: FloatArray,
    log_tau: FloatArray,
) -> None:
    """Take one step of a replicate, in place, from its normal equations without priors of the tissue."""
    p, branches = theta.size, log_tau.size
    mean, precision = stated
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
    theta[:] = cone_least_squares(block, target, density.blocks, density.start)[0]
    log_tau += change


@kernel()
def _repeated(values: FloatArray) -> FloatArray:
    """The same for each of the points that go side by side, shape (..., LANES)."""
    out = np.empty((values.size, LANES))
    flat = values.ravel()
    for k in range(values.size):
        out[k] = flat[k]
    return out.reshape((*values.shape, LANES))


@kernel()
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
    data, branches = density.data, density.data.branches
    instrument, gain_sd = fixed
    begin = density.mode[:branches].copy()
    precision, mean = effect_prior(density, data, gain_sd)
    # the first step is taken from the same place by all
    first = log_terms(data, density.theta, begin, instrument, RELAXATION)
    count = weights.shape[0]
    thetas, taus = np.empty((count, density.theta.size)), np.empty((count, branches))
    for i in range(count):
        thetas[i], taus[i] = density.theta, begin
        curvature, slope, _, _ = without_effects(
            first[0], first[1], first[2], weights[i], precision, mean, density.sigma2
        )
        _stepped(density, curvature, slope, stated, bounds, thetas[i], taus[i])
    none = np.zeros((0, LANES)), np.zeros((0, 0)), np.zeros((0, 0, 0))
    for start in range(0, count, LANES):
        rows = np.arange(start, min(start + LANES, count))
        terms = Terms(
            _repeated(data.gamma), _repeated(data.delta), none[0], none[1], none[2], none[1],
            _repeated(precision), _repeated(mean), gathered(weights, rows, 0, weights.shape[1]),
            np.full(LANES, density.sigma2),
        )  # fmt: skip
        held = _repeated(instrument)
        for _ in range(1, STEPS):
            theta, tau = gathered(thetas, rows, 0, thetas.shape[1]), gathered(taus, rows, 0, branches)
            curvatures, slopes, _ = integrated_terms(data, terms, theta, np.exp(tau), held, RELAXATION)
            for v in range(rows.size):
                curvature, slope = curvatures[:, :, v].copy(), slopes[:, v].copy()
                _stepped(density, curvature, slope, stated, bounds, thetas[rows[v]], taus[rows[v]])
    return thetas, taus
