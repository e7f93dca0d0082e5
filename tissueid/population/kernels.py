"""State of a chain over a population, and the parts of its sweep that are normal; compiled.

The t distribution is a scale mixture of normals.  Given the weights of the mixture, the mean, the effects of
covariates and of levels are normal; every part is linear in the number of specimens.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.population.scale_kernels import draw_log_sd
from tissueid.population.triangular import factor, inverse_factor, solved

__all__ = [
    "Cohort",
    "Hyper",
    "State",
    "centre_of",
    "draw_coefficients",
    "draw_effects",
    "squares",
    "unit_factor",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Cohort(NamedTuple):
    """Specimens as the chain knows them.

    Attributes
    ----------
    phi : ndarray of float32, shape (N, p)
        Stage-1 draws of all specimens, one after the other.
    log_reference, log_pilot : ndarray of float32, shape (N,)
        Ln densities of phi, up to a constant for each specimen.
    cumulative : ndarray, shape (N,)
        Running sums, within a specimen, of its frozen weights; they end at 1.
    start : ndarray of int, shape (n + 1,)
        Where each specimen's draws begin.
    smooth : ndarray of int, shape (n,)
        Row in the arrays of smooth likelihoods, -1 for a specimen that is among its draws.
    linear : ndarray of bool, shape (p,)
        See :func:`tissueid.population.mixture_kernels.log_mixture`, as the next four.
    middle : ndarray, shape (s, p)
    log_weight : ndarray, shape (s, c)
    component : ndarray, shape (s, c, p)
    unit : ndarray, shape (s, c, p, p)
    likely, precision : ndarray, shapes (s, p) and (s, p, p)
        Of one normal that proposals are made with.
    ascending : ndarray of int
        Coordinates that ascend.
    design : ndarray, shape (n, q)
        A column of ones, then covariates.
    group : ndarray of int, shape (L, n)
        Row in ``State.effect`` of each specimen's group, for each level.
    level_of : ndarray of int, shape (G,)
        Level of each group.
    """

    phi: NDArray[np.float32]
    log_reference: NDArray[np.float32]
    log_pilot: NDArray[np.float32]
    cumulative: FloatArray
    start: IntArray
    smooth: IntArray
    linear: NDArray[np.bool_]
    middle: FloatArray
    log_weight: FloatArray
    component: FloatArray
    unit: FloatArray
    likely: FloatArray
    precision: FloatArray
    ascending: IntArray
    design: FloatArray
    group: IntArray
    level_of: IntArray


class Hyper(NamedTuple):
    """Priors of the population: see :class:`tissueid.priors.PopulationPriors`.

    Attributes
    ----------
    coefficient_sd : ndarray, shape (q,)
    scale : ndarray, shape (3,)
        Mean and sd of ln D, shape of LKJ.
    level : ndarray, shape (2,)
        Mean and sd of the ln SD of a level.
    nu : ndarray, shape (2,)
        Shape and rate of a gamma distribution.
    heavy : bool
        False takes a normal instead of a t.
    far : float
        Squared distance beyond which a specimen is far from the population.
    """

    coefficient_sd: FloatArray
    scale: FloatArray
    level: FloatArray
    nu: FloatArray
    heavy: bool
    far: float


class State(NamedTuple):
    """State of a chain; changed in place.

    Attributes
    ----------
    phi : ndarray, shape (n, p)
        Where each specimen is.
    pick : ndarray of int, shape (n,)
        Row of ``Cohort.phi`` of a specimen that is among its draws.
    likelihood : ndarray, shape (n,)
        Ln of the smooth likelihood of the others.
    coefficient : ndarray, shape (q, p)
    effect : ndarray, shape (G, p)
        Of the groups of all levels.
    level_log_sd : ndarray, shape (L, p)
    log_sd : ndarray, shape (p,)
    partial : ndarray, shape (p, p)
        Partial correlations, strictly lower.
    nu : ndarray, shape (1,)
    weight, distance2 : ndarray, shape (n,)
        Of the scale mixture, and squared distance from the population.
    step : ndarray, shape (3, p)
        Ln of the steps of joint moves of mean and of scale, and, first of its row, of the whole mean.
    accepted : ndarray of int, shape (n,)
        Moves of each specimen so far.
    """

    phi: FloatArray
    pick: IntArray
    likelihood: FloatArray
    coefficient: FloatArray
    effect: FloatArray
    level_log_sd: FloatArray
    log_sd: FloatArray
    partial: FloatArray
    nu: FloatArray
    weight: FloatArray
    distance2: FloatArray
    step: FloatArray
    accepted: IntArray


@kernel()
def unit_factor(log_sd: FloatArray, low: FloatArray) -> FloatArray:
    """Inverse of the Cholesky factor of D R D from ln D and the factor of R."""
    out = inverse_factor(low)
    for j in range(log_sd.size):
        unit = math.exp(-log_sd[j])
        for i in range(j, log_sd.size):
            out[i, j] *= unit
    return out


@kernel()
def centre_of(cohort: Cohort, state: State, i: int, mean: FloatArray) -> None:
    """Centre of the population for one specimen, into ``mean``."""
    for k in range(mean.size):
        value = 0.0
        for a in range(cohort.design.shape[1]):
            value += cohort.design[i, a] * state.coefficient[a, k]
        for level in range(cohort.group.shape[0]):
            value += state.effect[cohort.group[level, i], k]
        mean[k] = value


@kernel()
def _draw_normal(rng: np.random.Generator, precision: FloatArray, pull: FloatArray) -> FloatArray:
    """Draw from the normal of that precision whose mean solves ``precision @ mean = pull``."""
    low = factor(precision)
    z = solved(low, pull)
    n = z.size
    for i in range(n):
        z[i] += rng.standard_normal()
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            z[i] -= low[k, i] * z[k]
        z[i] /= low[i, i]
    return z


@kernel()
def draw_coefficients(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, inverse: FloatArray
) -> None:
    """Mean and effects of covariates, all at once, given the effects of levels."""
    q, p = state.coefficient.shape
    gram = np.zeros((q, q))
    pulled = np.zeros((q, p))
    for i in range(state.weight.size):
        for a in range(q):
            weighted = state.weight[i] * cohort.design[i, a]
            for b in range(q):
                gram[a, b] += weighted * cohort.design[i, b]
            for k in range(p):
                rest = state.phi[i, k]
                for level in range(cohort.group.shape[0]):
                    rest -= state.effect[cohort.group[level, i], k]
                pulled[a, k] += weighted * rest
    precision = np.zeros((q * p, q * p))
    pull = np.zeros(q * p)
    for a in range(q):
        for k in range(p):
            row = a * p + k
            precision[row, row] = 1.0 / (hyper.coefficient_sd[a] * hyper.coefficient_sd[a])
            for j in range(p):
                pull[row] += inverse[k, j] * pulled[a, j]
    for a in range(q):
        for b in range(q):
            for k in range(p):
                for j in range(p):
                    precision[a * p + k, b * p + j] += gram[a, b] * inverse[k, j]
    drawn = _draw_normal(rng, precision, pull)
    for a in range(q):
        for k in range(p):
            state.coefficient[a, k] = drawn[a * p + k]


@kernel()
def draw_effects(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, inverse: FloatArray
) -> None:
    """Effects of the groups of each level, and how far they spread."""
    groups, p = state.effect.shape
    mean = np.zeros(p)
    for level in range(cohort.group.shape[0]):
        count = np.zeros(groups)
        pulled = np.zeros((groups, p))
        for i in range(state.weight.size):
            g = cohort.group[level, i]
            centre_of(cohort, state, i, mean)
            count[g] += state.weight[i]
            for k in range(p):
                pulled[g, k] += state.weight[i] * (state.phi[i, k] - mean[k] + state.effect[g, k])
        square = np.zeros(p)
        size = 0
        for g in range(groups):
            if cohort.level_of[g] != level:
                continue
            precision = np.zeros((p, p))
            pull = np.zeros(p)
            for k in range(p):
                for j in range(p):
                    precision[k, j] = count[g] * inverse[k, j]
                    pull[k] += inverse[k, j] * pulled[g, j]
                precision[k, k] += math.exp(-2.0 * state.level_log_sd[level, k])
            drawn = _draw_normal(rng, precision, pull)
            for k in range(p):
                state.effect[g, k] = drawn[k]
                square[k] += drawn[k] * drawn[k]
            size += 1
        for k in range(p):
            state.level_log_sd[level, k] = draw_log_sd(
                rng, state.level_log_sd[level, k], square[k], float(size), hyper.level[0], hyper.level[1]
            )


@kernel()
def squares(cohort: Cohort, state: State) -> FloatArray:
    """Weighted sum of squares and products of the specimens' deviations."""
    p = state.log_sd.size
    out = np.zeros((p, p))
    mean = np.zeros(p)
    away = np.zeros(p)
    for i in range(state.weight.size):
        centre_of(cohort, state, i, mean)
        for k in range(p):
            away[k] = state.phi[i, k] - mean[k]
        for k in range(p):
            for j in range(k + 1):
                out[k, j] += state.weight[i] * away[k] * away[j]
    for k in range(p):
        for j in range(k):
            out[j, k] = out[k, j]
    return out
