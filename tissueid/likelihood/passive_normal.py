"""A normal distribution cut to the passive set: its mass, and exact draws.

In Bernstein coordinates, taken in the order c0, c2, c1, a block of theta is passive where each coordinate
exceeds a bound that depends on earlier ones only (:mod:`tissueid.likelihood.bernstein`).  Given those, each
is a normal cut from below, so the sequential simulator of Geweke, Hajivassiliou and Keane is exact for this
curved set as well.  Its proposals are shifted by the saddle point of Botev (2017, doi 10.1111/rssb.12162):
the logarithm of a weight is concave in the draws, because the bound of c1 is convex in c0 and c2, so that its
value at the saddle bounds all weights.  That keeps the mass accurate far out in the tail, and makes
acceptance-rejection exact.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.bernstein import (
    PARABOLA,
    ZERO,
    brought_inside,
    is_passive,
    ordered,
    to_bernstein,
    to_powers,
)
from tissueid.likelihood.hit_and_run import walk
from tissueid.likelihood.normal_tail import excess, hazard, log_tail, tail_quantile
from tissueid.likelihood.triangular import solved

__all__ = ["draw_passive", "log_passive_mass", "passive"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: A bound this many standard deviations away does not cut (its tail has 6e-16).
FAR = 8.0
#: Logarithm of a mass of which that tail is 1e-10 at most.
SMALL = -10.0
#: Quasi-random points of a mass.
POINTS = 256
#: Square roots of primes: the generator of Richtmyer's points; one a coordinate.
ROOTS = np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0, 37.0]))
#: Newton steps to the saddle, its tolerance, and the step of its differences.
SADDLE_STEPS = 60
SADDLE_TOLERANCE = 1e-9
DIFFERENCE = 1e-6
#: Plain proposals of a draw before shifted ones are tried; those are cheap, these seldom refused.
PLAIN_TRIES = 8
#: Shifted proposals before one of them, taken by its weight, walks on to the draw, and steps of that walk a
#: coefficient.
SHIFTED_TRIES = 400
STEPS = 25


@kernel()
def _factor(s: FloatArray, index: IntArray, count: int) -> FloatArray:
    """Lower Cholesky factor of the first coordinates in their order."""
    low = np.zeros((count, count))
    for i in range(count):
        for j in range(i + 1):
            value = s[index[i], index[j]]
            for k in range(j):
                value -= low[i, k] * low[j, k]
            if i == j:
                low[i, i] = math.sqrt(max(value, 1e-14 * s[index[i], index[i]]))
            else:
                low[i, j] = value / low[j, j]
    return low


@kernel()
def _cut(k: int, kind: int, m: FloatArray, low: FloatArray, z: FloatArray, y: FloatArray) -> float:
    """Where the k-th standard coordinate is cut, given those before; its mean so far goes to ``y[k]``."""
    y[k] = m[k]
    for j in range(k):
        y[k] += low[k, j] * z[j]
    bound = 0.0
    if kind == PARABOLA:
        bound = -math.sqrt(max(y[k - 2], 0.0) * max(y[k - 1], 0.0))
    return float((bound - y[k]) / low[k, k])


@kernel()
def _sweep(
    m: FloatArray, low: FloatArray, kind: IntArray, depth: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Shifts by the depths, how far they are from stationary, and ln of the weight there.

    The depth is that of the cut inside the shifted normal.  Unlike the shift it keeps the distance of a draw
    from its bound to full precision.  The last coordinate is never shifted.
    """
    n = m.size
    z = np.zeros(n)
    y = np.zeros(n)
    shift = np.zeros(n)
    rate = np.zeros(n)
    level = 0.0
    for k in range(n):
        cut = _cut(k, kind[k], m, low, z, y)
        a = depth[k] if k < n - 1 else cut
        shift[k] = cut - a
        tail = log_tail(a)
        rate[k] = hazard(a, tail)
        above = excess(a, tail)
        z[k] = cut + above
        y[k] += low[k, k] * cut
        y[k] = low[k, k] * above if kind[k] == ZERO else y[k] + low[k, k] * above
        level += tail + shift[k] * (0.5 * shift[k] - z[k])
    gap = -shift
    for k in range(1, n):
        a, b = 0.0, 0.0
        if kind[k] == PARABOLA:
            root = math.sqrt(y[k - 1] / y[k - 2])
            a, b = 0.5 * root, 0.5 / root
        for j in range(k):
            slope = low[k, j]
            if kind[k] == PARABOLA:
                slope += a * low[k - 2, j] + b * low[k - 1, j]
            gap[j] += rate[k] * slope / low[k, k]
    return shift, gap, level


@kernel()
def _solve(a: FloatArray, b: FloatArray) -> FloatArray:
    """Solution of a small linear system by elimination with pivots; both arguments are used up."""
    n = b.size
    for i in range(n):
        pivot = i
        for r in range(i + 1, n):
            if abs(a[r, i]) > abs(a[pivot, i]):
                pivot = r
        if pivot != i:
            for j in range(n):
                a[i, j], a[pivot, j] = a[pivot, j], a[i, j]
            b[i], b[pivot] = b[pivot], b[i]
        for r in range(i + 1, n):
            factor = a[r, i] / a[i, i]
            for j in range(i, n):
                a[r, j] -= factor * a[i, j]
            b[r] -= factor * b[i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            b[i] -= a[i, j] * b[j]
        b[i] /= a[i, i]
    return b


@kernel()
def _saddle(m: FloatArray, low: FloatArray, kind: IntArray) -> tuple[FloatArray, float, bool]:
    """Shifts at the saddle point, ln of the largest weight, and whether Newton's method got there."""
    n = m.size
    size = n - 1  # the last one is never shifted
    z = np.zeros(n)
    y = np.zeros(n)
    depth = np.zeros(n)
    for k in range(size):
        depth[k] = _cut(k, kind[k], m, low, z, y)
        z[k] = depth[k] + excess(depth[k], log_tail(depth[k]))
        y[k] += low[k, k] * z[k]
    shift, gap, level = _sweep(m, low, kind, depth)
    norm = math.sqrt((gap[:size] ** 2).sum())
    for _ in range(SADDLE_STEPS):
        if norm <= SADDLE_TOLERANCE * (1.0 + math.sqrt((shift * shift).sum())):
            return shift, level, True
        jacobian = np.empty((size, size))
        for j in range(size):
            moved = depth.copy()
            h = DIFFERENCE * (1.0 + abs(depth[j]))
            moved[j] += h
            there = _sweep(m, low, kind, moved)[1]
            for i in range(size):
                jacobian[i, j] = (gap[i] - there[i]) / h
        step = _solve(jacobian, gap[:size].copy())
        fraction = 1.0
        while True:
            trial = depth.copy()
            trial[:size] += fraction * step
            there_shift, there_gap, there_level = _sweep(m, low, kind, trial)
            there_norm = math.sqrt((there_gap[:size] ** 2).sum())
            if there_norm < norm:
                break
            fraction *= 0.5
            if fraction < 1e-6:
                return shift, level, False
        depth, shift, gap, level, norm = trial, there_shift, there_gap, there_level, there_norm
    return shift, level, False


@kernel()
def _point(i: int, k: int, dimensions: int) -> float:
    """Coordinate k of the i-th quasi-random point, inside (0, 1)."""
    if dimensions == 1:
        return (i + 0.5) / POINTS
    part = (i + 0.5) * float(ROOTS[k])
    # the tent makes the integrand periodic, for which these points converge faster
    return max(abs(2.0 * (part - math.floor(part)) - 1.0), 1e-15)


@kernel()
def _log_mass(m: FloatArray, low: FloatArray, kind: IntArray) -> float:
    """Logarithm of the mass that the bounds leave, by a quasi-random sum."""
    n = m.size
    if n == 1:
        return float(log_tail(-m[0] / low[0, 0]))
    shift, _, _ = _saddle(m, low, kind)
    z = np.zeros(n)
    y = np.zeros(n)
    largest = -np.inf
    total = 0.0
    for i in range(POINTS):
        weight = 0.0
        for k in range(n):
            cut = _cut(k, kind[k], m, low, z, y)
            tail = log_tail(cut - shift[k])
            weight += tail
            if k < n - 1:
                u = _point(i, k, n - 1)
                z[k] = shift[k] + tail_quantile(tail + math.log(u))
                y[k] += low[k, k] * z[k]
                weight += shift[k] * (0.5 * shift[k] - z[k])
        if weight > largest:
            total = total * math.exp(largest - weight) + 1.0
            largest = weight
        else:
            total += math.exp(weight - largest)
    return min(float(largest + math.log(total / POINTS)), 0.0)


@kernel()
def log_passive_mass(mean: FloatArray, cov: FloatArray, blocks: IntArray) -> float:
    """Logarithm of the probability that a normal theta is passive.

    Parameters
    ----------
    mean : ndarray, shape (p,)
        Coefficients by powers of u, block by block.
    cov : ndarray, shape (p, p)
        Positive definite.
    blocks : ndarray of int
        Sizes of the polynomial blocks (1, 2 or 3), summing to p.

    Returns
    -------
    float
        0 exactly where no bound is within :data:`FAR` standard deviations.
    """
    c, s = to_bernstein(mean, cov, blocks)
    index, kind, n = ordered(c, s, blocks, FAR)
    if n == 0:
        return 0.0
    mass = _log_mass(c[index[:n]], _factor(s, index, n), kind)
    if mass < SMALL and n < c.size:
        # what is left of the normal lies far from its mean, where other bounds may cut
        index, kind, n = ordered(c, s, blocks, np.inf)
        mass = _log_mass(c[index], _factor(s, index, n), kind)
    return mass


@kernel()
def _propose(
    m: FloatArray,
    low: FloatArray,
    kind: IntArray,
    shift: FloatArray,
    y: FloatArray,
    rng: np.random.Generator,
) -> float:
    """Fill y with a proposal for the ordered coordinates; ln of its weight. Without shifts it is not cut."""
    z = np.empty(m.size)
    weight = 0.0
    for k in range(m.size):
        cut = _cut(k, kind[k], m, low, z, y)
        if shift.size:
            tail = log_tail(cut - shift[k])
            z[k] = max(cut, shift[k] + tail_quantile(tail + math.log1p(-rng.random())))
            weight += tail + shift[k] * (0.5 * shift[k] - z[k])
        else:
            z[k] = rng.standard_normal()
        y[k] += low[k, k] * z[k]
    return weight


@kernel()
def _draw(
    mean: FloatArray, cov: FloatArray, blocks: IntArray, theta: FloatArray, rng: np.random.Generator
) -> int:
    """Fill theta with one passive draw; how many proposals that took."""
    p = mean.size
    c, s = to_bernstein(mean, cov, blocks)
    index, kind, _ = ordered(c, s, blocks, np.inf)
    low = _factor(s, index, p)
    m = c[index]
    y = np.empty(p)
    bernstein = np.empty(p)
    unshifted = np.empty(0)
    for tries in range(1, PLAIN_TRIES + 1):
        _propose(m, low, kind, unshifted, y, rng)
        bernstein[index] = y
        theta[:] = to_powers(bernstein, blocks)
        if is_passive(theta, blocks):
            return tries
    shift, level, found = _saddle(m, low, kind)
    total = -np.inf
    held = np.zeros(p)
    for tries in range(1, SHIFTED_TRIES + 1):
        weight = _propose(m, low, kind, shift, y, rng)
        bernstein[index] = y
        theta[:] = to_powers(bernstein, blocks)
        if not (weight > -np.inf and is_passive(theta, blocks)):
            continue
        if found and math.log1p(-rng.random()) < weight - level:
            return PLAIN_TRIES + tries
        larger = max(total, weight)
        total = larger + math.log(math.exp(total - larger) + math.exp(weight - larger))
        if math.log1p(-rng.random()) < weight - total:
            held[:] = y
    if total == -np.inf:  # lost to rounding: the nearest thing that is passive
        theta[:] = brought_inside(bernstein, blocks)
        return PLAIN_TRIES + SHIFTED_TRIES
    root = np.empty_like(low)
    root[index] = low
    bernstein = walk(solved(low, held - m), c, root, blocks, STEPS * p, rng)
    theta[:] = to_powers(bernstein, blocks)
    if not is_passive(theta, blocks):  # by rounding
        theta[:] = brought_inside(bernstein, blocks)
    return PLAIN_TRIES + SHIFTED_TRIES


@kernel()
def _draw_each(
    mean: FloatArray, cov: FloatArray, blocks: IntArray, theta: FloatArray, rng: np.random.Generator
) -> int:
    """Fill the rows of theta; how many proposals that took."""
    total = 0
    for i in range(mean.shape[0]):
        total += _draw(mean[i], cov[i], blocks, theta[i], rng)
    return total


def draw_passive(
    mean: FloatArray, cov: FloatArray, blocks: IntArray, rng: np.random.Generator
) -> tuple[FloatArray, float]:
    """One exact draw from each of n normals cut to the passive set.

    Parameters
    ----------
    mean : ndarray, shape (n, p)
    cov : ndarray, shape (n, p, p)
    blocks : ndarray of int
        Sizes of the polynomial blocks (1, 2 or 3), summing to p.
    rng : numpy.random.Generator
        Draws follow from its state alone.

    Returns
    -------
    theta : ndarray, shape (n, p)
        Each is passive in the sense of :func:`passive`.
    acceptance : float
        Draws over proposals.

    Notes
    -----
    Plain draws first, then acceptance-rejection with shifted proposals; both are exact.  Where all
    :data:`SHIFTED_TRIES` are refused, one of them, taken by its weight, walks on
    (:mod:`tissueid.likelihood.hit_and_run`): that draw is exact but for what the walk forgets of its start.
    """
    mean = np.ascontiguousarray(mean, dtype=np.float64)
    theta = np.empty_like(mean)
    proposals = _draw_each(mean, np.ascontiguousarray(cov, dtype=np.float64), blocks, theta, rng)
    return theta, mean.shape[0] / max(proposals, 1)


def passive(theta: FloatArray, blocks: IntArray) -> NDArray[np.bool_]:
    """Whether each row of theta is passive.

    Parameters
    ----------
    theta : ndarray, shape (n, p)
    blocks : ndarray of int

    Returns
    -------
    ndarray of bool, shape (n,)
        Where no block's :func:`tissueid.model.polynomial.minimum_on_unit` is negative.
    """
    return np.array([is_passive(row, blocks) for row in np.ascontiguousarray(theta, dtype=np.float64)])
