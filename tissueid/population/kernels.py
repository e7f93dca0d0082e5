"""State of a chain over a population, and draws of its mean, effects and scales; compiled.

The t distribution is a scale mixture of normals: given its weights, mean and effects are normal.  A
covariance is D R D with ln D_k normal and R of the LKJ distribution (Lewandowski, Kurowicka & Joe 2009, J
Multivariate Anal 100:1989, doi 10.1016/j.jmva.2009.04.008): its canonical partial correlations w are
independent, beta distributed on (-1, 1), and make the rows of R's Cholesky factor.  Every coordinate is drawn
by slice sampling with stepping out (Neal 2003, Ann Statist 31:705, doi 10.1214/aos/1056562461) from
sufficient statistics.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import kernel

#: Steps out and shrinkings of a slice at the most; a slice is found long before.
MOST_STEPS = 40
#: Widths of the first interval: of ln SD, of arctanh of a partial correlation, and of ln nu.
SD_WIDTH = 0.6
CORRELATION_WIDTH = 0.8
NU_WIDTH = 1.0
#: arctanh of the largest partial correlation.
MOST_Z = 8.0
#: Degrees of freedom: tails heavier than Cauchy's are no population, and 1e4 is a normal.
NU_RANGE = (1.0, 1e4)


@kernel()
def _factor_row(w: FloatArray, i: int, low: FloatArray) -> None:
    """Row i of the Cholesky factor of R from its partial correlations."""
    left = 1.0
    for j in range(i):
        low[i, j] = w[i, j] * math.sqrt(left)
        left *= 1.0 - w[i, j] * w[i, j]
    low[i, i] = math.sqrt(left)


@kernel()
def correlation_factor(w: FloatArray) -> FloatArray:
    """Cholesky factor of R from partial correlations (strictly lower part of ``w``)."""
    low = np.zeros(w.shape)
    for i in range(w.shape[0]):
        _factor_row(w, i, low)
    return low


@kernel()
def _log_likelihood(
    log_sd: FloatArray, low: FloatArray, root: FloatArray, count: float, x: FloatArray
) -> float:
    """Of ``count`` normal deviations with ``root @ root.T`` as their sum of squares; ``x`` is work space."""
    p = log_sd.size
    value = 0.0
    square = 0.0
    for i in range(p):
        value -= count * (log_sd[i] + math.log(low[i, i]))
        unit = math.exp(-log_sd[i])
        for j in range(i + 1):
            rest = root[i, j] * unit
            for k in range(j, i):
                rest -= low[i, k] * x[k, j]
            x[i, j] = rest / low[i, i]
            square += x[i, j] * x[i, j]
    return value - 0.5 * square


class _Scales(NamedTuple):
    """Standard deviations, factor of the correlations, what was seen of how many, work space, prior."""

    log_sd: FloatArray
    low: FloatArray
    root: FloatArray
    many: float
    x: FloatArray
    prior: FloatArray


@kernel()
def _at_log_sd(value: float, k: int, scales: _Scales) -> float:
    scales.log_sd[k] = value
    away = (value - scales.prior[0]) / scales.prior[1]
    likelihood = _log_likelihood(scales.log_sd, scales.low, scales.root, scales.many, scales.x)
    return float(likelihood - 0.5 * away * away)


@kernel()
def _at_correlation(value: float, i: int, j: int, w: FloatArray, scales: _Scales) -> float:
    if abs(value) > MOST_Z:
        return -np.inf
    w[i, j] = math.tanh(value)
    _factor_row(w, i, scales.low)
    # Beta(b, b) on (-1, 1), times d w / d arctanh w
    b = scales.prior[2] + 0.5 * (w.shape[0] - 2 - j)
    likelihood = _log_likelihood(scales.log_sd, scales.low, scales.root, scales.many, scales.x)
    return float(likelihood - 2.0 * b * math.log(math.cosh(value)))


@kernel()
def draw_scales(
    rng: np.random.Generator, log_sd: FloatArray, w: FloatArray, squares: FloatArray, count: float,
    prior: FloatArray,
) -> FloatArray:  # fmt: skip
    """One sweep over ln standard deviations and partial correlations, in place; the Cholesky factor of R."""
    p = log_sd.size
    low = correlation_factor(w)
    scales = _Scales(log_sd, low, _root(squares), count, np.zeros((p, p)), prior)
    for k in range(p):
        _draw_scale(rng, k, k, log_sd[k], SD_WIDTH, w, scales)
    for i in range(1, p):
        for j in range(i):
            _draw_scale(rng, i, j, math.atanh(w[i, j]), CORRELATION_WIDTH, w, scales)
    return low


@kernel()
def _at_scale(value: float, i: int, j: int, w: FloatArray, scales: _Scales) -> float:
    if i == j:
        return _at_log_sd(value, i, scales)
    return _at_correlation(value, i, j, w, scales)


@kernel()
def _draw_scale(
    rng: np.random.Generator, i: int, j: int, start: float, width: float, w: FloatArray, scales: _Scales
) -> None:
    """Slice-sample ln of standard deviation i where j is i, else the partial correlation of i and j."""
    level = _at_scale(start, i, j, w, scales) - rng.standard_exponential()
    left = start - width * rng.random()
    right = left + width
    for _ in range(MOST_STEPS):
        if _at_scale(left, i, j, w, scales) <= level:
            break
        left -= width
    for _ in range(MOST_STEPS):
        if _at_scale(right, i, j, w, scales) <= level:
            break
        right += width
    for _ in range(2 * MOST_STEPS):
        value = left + (right - left) * rng.random()
        if _at_scale(value, i, j, w, scales) > level:
            return
        if value < start:
            left = value
        else:
            right = value
    _at_scale(start, i, j, w, scales)


@kernel()
def _root(squares: FloatArray) -> FloatArray:
    """Lower factor of a sum of squares that may be singular: fewer deviations than coordinates."""
    p = squares.shape[0]
    low = np.zeros((p, p))
    for i in range(p):
        for j in range(i + 1):
            value = squares[i, j]
            for k in range(j):
                value -= low[i, k] * low[j, k]
            if i == j:
                low[i, i] = math.sqrt(max(value, 1e-14 * squares[i, i]))
            elif low[j, j] > 0.0:
                low[i, j] = value / low[j, j]
    return low


@kernel()
def _log_sd_density(value: float, square: float, count: float, mean: float, sd: float) -> float:
    away = (value - mean) / sd
    return -count * value - 0.5 * square * math.exp(-2.0 * value) - 0.5 * away * away


@kernel()
def draw_log_sd(
    rng: np.random.Generator, start: float, square: float, count: float, mean: float, sd: float
) -> float:
    """Draw ln of the standard deviation of ``count`` normal deviations with that sum of squares."""
    level = _log_sd_density(start, square, count, mean, sd) - rng.standard_exponential()
    left = start - SD_WIDTH * rng.random()
    right = left + SD_WIDTH
    for _ in range(MOST_STEPS):
        if _log_sd_density(left, square, count, mean, sd) <= level:
            break
        left -= SD_WIDTH
    for _ in range(MOST_STEPS):
        if _log_sd_density(right, square, count, mean, sd) <= level:
            break
        right += SD_WIDTH
    for _ in range(2 * MOST_STEPS):
        value = left + (right - left) * rng.random()
        if _log_sd_density(value, square, count, mean, sd) > level:
            return value
        if value < start:
            left = value
        else:
            right = value
    return start


@kernel()
def _nu_density(log_nu: float, distance2: FloatArray, p: int, shape: float, rate: float) -> float:
    """Of ln nu, the weights of the specimens integrated: multivariate t of every squared distance."""
    nu = math.exp(log_nu)
    if nu < NU_RANGE[0] or nu > NU_RANGE[1]:
        return -np.inf
    n = distance2.size
    value = n * (math.lgamma(0.5 * (nu + p)) - math.lgamma(0.5 * nu) - 0.5 * p * math.log(nu))
    half = 0.5 * (nu + p)
    for i in range(n):
        value -= half * math.log1p(distance2[i] / nu)
    return value + shape * log_nu - rate * nu


@kernel()
def draw_nu(
    rng: np.random.Generator, nu: float, distance2: FloatArray, p: int, shape: float, rate: float
) -> float:
    """Draw the degrees of freedom, prior Gamma(shape, rate) cut to :data:`NU_RANGE`."""
    start = math.log(nu)
    level = _nu_density(start, distance2, p, shape, rate) - rng.standard_exponential()
    left = start - NU_WIDTH * rng.random()
    right = left + NU_WIDTH
    for _ in range(MOST_STEPS):
        if _nu_density(left, distance2, p, shape, rate) <= level:
            break
        left -= NU_WIDTH
    for _ in range(MOST_STEPS):
        if _nu_density(right, distance2, p, shape, rate) <= level:
            break
        right += NU_WIDTH
    for _ in range(2 * MOST_STEPS):
        value = left + (right - left) * rng.random()
        if _nu_density(value, distance2, p, shape, rate) > level:
            return math.exp(value)
        if value < start:
            left = value
        else:
            right = value
    return nu


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
    #: (p,): see :func:`tissueid.population.chain.log_mixture`, as the next four.
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
