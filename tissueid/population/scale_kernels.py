"""Draws of how much specimens differ: standard deviations, correlations, tails; compiled.

A covariance is D R D with ln D_k normal and R of the LKJ distribution (Lewandowski, Kurowicka & Joe 2009,
J Multivariate Anal 100:1989, doi 10.1016/j.jmva.2009.04.008): its canonical partial correlations w are
independent, beta distributed on (-1, 1), and make the rows of R's Cholesky factor.  Every coordinate is
drawn by slice sampling with stepping out (Neal 2003, Ann Statist 31:705, doi 10.1214/aos/1056562461) from
sufficient statistics, so that a draw costs the same for ten specimens as for ten thousand.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
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
    """One sweep over standard deviations and correlations, in place.

    ``log_sd`` (p,); ``w`` (p, p): partial correlations in the strictly lower part; ``squares`` (p, p): sum of
    the squares and products of the deviations; ``count``: how many; ``prior`` (3,): mean and sd of ln D,
    shape of the LKJ distribution.  Returns (p, p), Cholesky factor of R.
    """
    p = log_sd.size
    low = correlation_factor(w)
    scales = _Scales(log_sd, low, _root(squares), count, np.zeros((p, p)), prior)
    for k in range(p):
        start = log_sd[k]
        level = _at_log_sd(start, k, scales) - rng.standard_exponential()
        left = start - SD_WIDTH * rng.random()
        right = left + SD_WIDTH
        for _ in range(MOST_STEPS):
            if _at_log_sd(left, k, scales) <= level:
                break
            left -= SD_WIDTH
        for _ in range(MOST_STEPS):
            if _at_log_sd(right, k, scales) <= level:
                break
            right += SD_WIDTH
        log_sd[k] = start
        for _ in range(2 * MOST_STEPS):
            value = left + (right - left) * rng.random()
            if _at_log_sd(value, k, scales) > level:
                break
            if value < start:
                left = value
            else:
                right = value
            log_sd[k] = start
    for i in range(1, p):
        for j in range(i):
            _draw_correlation(rng, i, j, w, scales)
    return low


@kernel()
def _draw_correlation(rng: np.random.Generator, i: int, j: int, w: FloatArray, scales: _Scales) -> None:
    start = math.atanh(w[i, j])
    level = _at_correlation(start, i, j, w, scales) - rng.standard_exponential()
    left = start - CORRELATION_WIDTH * rng.random()
    right = left + CORRELATION_WIDTH
    for _ in range(MOST_STEPS):
        if _at_correlation(left, i, j, w, scales) <= level:
            break
        left -= CORRELATION_WIDTH
    for _ in range(MOST_STEPS):
        if _at_correlation(right, i, j, w, scales) <= level:
            break
        right += CORRELATION_WIDTH
    for _ in range(2 * MOST_STEPS):
        value = left + (right - left) * rng.random()
        if _at_correlation(value, i, j, w, scales) > level:
            return
        if value < start:
            left = value
        else:
            right = value
    w[i, j] = math.tanh(start)
    _factor_row(w, i, scales.low)


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
