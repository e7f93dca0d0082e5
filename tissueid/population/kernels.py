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
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import kernel

Given = TypeVar("Given")

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


def _slice_sampler(
    log_density: Callable[[float, Given], float], width: float
) -> Callable[[np.random.Generator, float, Given], float]:
    """Compile a draw by slice sampling; the density was last asked of the place that is drawn."""

    @kernel()
    def draw(rng: np.random.Generator, start: float, given: Given) -> float:
        level = log_density(start, given) - rng.standard_exponential()
        left = start - width * rng.random()
        right = left + width
        for _ in range(MOST_STEPS):
            if log_density(left, given) <= level:
                break
            left -= width
        for _ in range(MOST_STEPS):
            if log_density(right, given) <= level:
                break
            right += width
        for _ in range(2 * MOST_STEPS):
            value = left + (right - left) * rng.random()
            if log_density(value, given) > level:
                return value
            if value < start:
                left = value
            else:
                right = value
        log_density(start, given)
        return start

    return draw


class _Scales(NamedTuple):
    """Data and state of a draw of scales; ``log_sd``, ``partial`` and ``low`` follow where it looks."""

    log_sd: FloatArray
    partial: FloatArray
    low: FloatArray  # factor of the correlations
    root: FloatArray  # factor of the sum of squares
    many: float
    x: FloatArray  # work space
    prior: FloatArray


@kernel()
def _at_log_sd(value: float, given: tuple[int, _Scales]) -> float:
    """Ln density of ln of a standard deviation."""
    k, scales = given
    scales.log_sd[k] = value
    away = (value - scales.prior[0]) / scales.prior[1]
    likelihood = _log_likelihood(scales.log_sd, scales.low, scales.root, scales.many, scales.x)
    return float(likelihood - 0.5 * away * away)


@kernel()
def _at_correlation(value: float, given: tuple[int, int, _Scales]) -> float:
    """Ln density of arctanh of a partial correlation."""
    i, j, scales = given
    if abs(value) > MOST_Z:
        return -np.inf
    scales.partial[i, j] = math.tanh(value)
    _factor_row(scales.partial, i, scales.low)
    # Beta(b, b) on (-1, 1), times d w / d arctanh w
    b = scales.prior[2] + 0.5 * (scales.log_sd.size - 2 - j)
    likelihood = _log_likelihood(scales.log_sd, scales.low, scales.root, scales.many, scales.x)
    return float(likelihood - 2.0 * b * math.log(math.cosh(value)))


_draw_log_sd = _slice_sampler(_at_log_sd, SD_WIDTH)
_draw_correlation = _slice_sampler(_at_correlation, CORRELATION_WIDTH)


@kernel()
def draw_scales(
    rng: np.random.Generator, log_sd: FloatArray, w: FloatArray, squares: FloatArray, count: float,
    prior: FloatArray,
) -> FloatArray:  # fmt: skip
    """Draw ln standard deviations and partial correlations in turn, in place; the Cholesky factor of R."""
    low = correlation_factor(w)
    scales = _Scales(log_sd, w, low, _root(squares), count, np.zeros(w.shape), prior)
    for k in range(log_sd.size):
        _draw_log_sd(rng, log_sd[k], (k, scales))
    for i in range(1, log_sd.size):
        for j in range(i):
            _draw_correlation(rng, math.atanh(w[i, j]), (i, j, scales))
    return low


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
def _at_log_nu(value: float, given: tuple[FloatArray, int, FloatArray]) -> float:
    """Ln density of ln nu, weights integrated, prior Gamma(shape, rate) cut to :data:`NU_RANGE`."""
    distance2, p, prior = given
    nu = math.exp(value)
    if nu < NU_RANGE[0] or nu > NU_RANGE[1]:
        return -np.inf
    half = 0.5 * (nu + p)
    each = math.lgamma(half) - math.lgamma(0.5 * nu) - 0.5 * p * value
    seen = distance2.size * each - half * np.log1p(distance2 / nu).sum()
    return float(seen + prior[0] * value - prior[1] * nu)


_draw_log_nu = _slice_sampler(_at_log_nu, NU_WIDTH)


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
    weight: FloatArray  # (n,), of the scale mixture
    #: (3, p): ln of the steps of joint moves of mean and of scale, and, first of its row, of the whole mean.
    step: FloatArray
    accepted: IntArray  # (n,), moves of each specimen so far


@kernel()
def unit_factor(log_sd: FloatArray, low: FloatArray) -> FloatArray:
    """Inverse of the Cholesky factor of D R D from ln D and the factor of R."""
    return inverse_factor(low) * np.exp(-log_sd)


@kernel()
def centres(cohort: Cohort, state: State) -> FloatArray:
    """Centre of the population for each specimen, shape (n, p)."""
    centre = cohort.design @ state.coefficient
    for i in range(centre.shape[0]):
        for level in range(cohort.group.shape[0]):
            centre[i] += state.effect[cohort.group[level, i]]
    return centre


@kernel()
def distance2(phi, mean: FloatArray, unit: FloatArray) -> float:  # type: ignore[no-untyped-def]
    """Squared distance of a point from a centre, in units of an inverse Cholesky factor."""
    total = 0.0
    for i in range(mean.size):
        z = 0.0
        for j in range(i + 1):
            z += unit[i, j] * (phi[j] - mean[j])
        total += z * z
    return total


@kernel()
def draw_weights(
    rng: np.random.Generator, hyper: Hyper, state: State, unit: FloatArray, centre: FloatArray
) -> None:
    """Degrees of freedom with the weights integrated, then the weights."""
    n, p = state.phi.shape
    square = np.array([distance2(state.phi[i], centre[i], unit) for i in range(n)])
    state.nu[0] = math.exp(_draw_log_nu(rng, math.log(state.nu[0]), (square, p, hyper.nu)))
    half = 0.5 * state.nu[0]
    for i in range(n):
        drawn = rng.standard_gamma(half + 0.5 * p) / (half + 0.5 * square[i])
        # a weight that is zero by rounding would never come back
        state.weight[i] = max(drawn, 1e-12)


@kernel()
def _draw_normal(rng: np.random.Generator, precision: FloatArray, pull: FloatArray) -> FloatArray:
    """Draw from the normal with that precision, and ``pull`` its product with the mean."""
    unit = inverse_factor(factor(precision))
    return unit.T @ (unit @ pull + rng.standard_normal(pull.size))


@kernel()
def draw_coefficients(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, inverse: FloatArray
) -> None:
    """Draw mean and effects of covariates, all at once, given the effects of levels."""
    q, p = state.coefficient.shape
    weighted = cohort.design * state.weight[:, None]
    own = state.phi - centres(cohort, state) + cohort.design @ state.coefficient
    pulled = weighted.T @ own
    gram, precision = weighted.T @ cohort.design, np.zeros((q * p, q * p))
    for a in range(q):
        for b in range(q):
            precision[a * p : (a + 1) * p, b * p : (b + 1) * p] = gram[a, b] * inverse
    for row in range(q * p):
        precision[row, row] += hyper.coefficient_sd[row // p] ** -2.0
    state.coefficient[:] = _draw_normal(rng, precision, (pulled @ inverse).ravel()).reshape((q, p))


@kernel()
def draw_effects(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, inverse: FloatArray
) -> None:
    """Draw effects of the groups of each level, and how far they spread."""
    groups, p = state.effect.shape
    for level in range(cohort.group.shape[0]):
        centre = centres(cohort, state)
        count, pulled = np.zeros(groups), np.zeros((groups, p))
        for i, g in enumerate(cohort.group[level]):
            count[g] += state.weight[i]
            pulled[g] += state.weight[i] * (state.phi[i] - centre[i] + state.effect[g])
        own = np.flatnonzero(cohort.level_of == level)
        prior = np.diag(np.exp(-2.0 * state.level_log_sd[level]))
        for g in own:
            state.effect[g] = _draw_normal(rng, count[g] * inverse + prior, inverse @ pulled[g])
        square = (state.effect[own] ** 2).sum(axis=0)
        for k in range(p):
            # one number alone: no correlation
            alone, sums = np.zeros((1, 1)), np.full((1, 1), square[k])
            draw_scales(rng, state.level_log_sd[level, k : k + 1], alone, sums, float(own.size), hyper.level)
