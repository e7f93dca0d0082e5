"""State of a chain over a population, and the parts of its sweep that are normal; compiled.

The t distribution is a scale mixture of normals.  Given the weights of the mixture, the mean, the effects of
covariates and of levels are normal; every part is linear in the number of specimens.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import kernel
from tissueid.population.scale_kernels import draw_log_sd


@kernel()
def factor(a: FloatArray) -> FloatArray:
    """Lower factor; NaN on the diagonal where the matrix is not positive definite."""
    n = a.shape[0]
    low = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            value = a[i, j]
            for k in range(j):
                value -= low[i, k] * low[j, k]
            low[i, j] = np.sqrt(value) if i == j else value / low[j, j]
    return low


@kernel()
def inverse_factor(low: FloatArray) -> FloatArray:
    """Inverse of a lower triangular matrix."""
    inverse = np.zeros(low.shape)
    for i in range(low.shape[0]):
        inverse[i, i] = 1.0 / low[i, i]
        for j in range(i):
            for k in range(j, i):
                inverse[i, j] -= low[i, k] * inverse[k, j]
            inverse[i, j] /= low[i, i]
    return inverse


@kernel()
def solved(low: FloatArray, away: FloatArray) -> FloatArray:
    """The z of ``low @ z = away``."""
    z = away.copy()
    for i in range(z.size):
        for k in range(i):
            z[i] -= low[i, k] * z[k]
        z[i] /= low[i, i]
    return z


class Cohort(NamedTuple):
    """Specimens as the chain knows them."""

    phi: NDArray[np.float32]  # (N, p), stage-1 draws of all specimens, one after the other
    #: (N,): ln densities of phi, up to a constant for each specimen.
    log_reference: NDArray[np.float32]
    log_pilot: NDArray[np.float32]  # (N,)
    cumulative: FloatArray  # (N,), running sums, within a specimen, of its frozen weights; they end at 1
    start: IntArray  # (n + 1,), where each specimen's draws begin
    #: (n,): row in the arrays of smooth likelihoods, -1 for a specimen that is among its draws.
    smooth: IntArray
    #: (p,): see :func:`tissueid.population.moves.log_mixture`, as the next four.
    linear: NDArray[np.bool_]
    middle: FloatArray  # (s, p)
    log_weight: FloatArray  # (s, c)
    component: FloatArray  # (s, c, p)
    unit: FloatArray  # (s, c, p, p)
    #: (s, p): of one normal that proposals are made with.
    likely: FloatArray
    precision: FloatArray  # (s, p, p)
    ascending: IntArray  # coordinates that ascend
    design: FloatArray  # (n, q), a column of ones, then covariates
    group: IntArray  # (L, n), row in ``State.effect`` of each specimen's group, for each level
    level_of: IntArray  # (G,), level of each group


class Hyper(NamedTuple):
    """Priors of the population: see :class:`tissueid.priors.PopulationPriors`."""

    coefficient_sd: FloatArray  # (q,)
    scale: FloatArray  # (3,), mean and sd of ln D, shape of LKJ
    level: FloatArray  # (2,), mean and sd of the ln SD of a level
    nu: FloatArray  # (2,), shape and rate of a gamma distribution
    heavy: bool  # false takes a normal instead of a t
    far: float  # squared distance beyond which a specimen is far from the population


class State(NamedTuple):
    """State of a chain; changed in place."""

    phi: FloatArray  # (n, p), where each specimen is
    pick: IntArray  # (n,), row of ``Cohort.phi`` of a specimen that is among its draws
    likelihood: FloatArray  # (n,), ln of the smooth likelihood of the others
    coefficient: FloatArray  # (q, p)
    effect: FloatArray  # (G, p), of the groups of all levels
    level_log_sd: FloatArray  # (L, p)
    log_sd: FloatArray  # (p,)
    partial: FloatArray  # (p, p), partial correlations, strictly lower
    nu: FloatArray  # (1,)
    #: (n,): of the scale mixture, and squared distance from the population.
    weight: FloatArray
    distance2: FloatArray  # (n,)
    #: (3, p): ln of the steps of joint moves of mean and of scale, and, first of its row, of the whole mean.
    step: FloatArray
    accepted: IntArray  # (n,), moves of each specimen so far


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
