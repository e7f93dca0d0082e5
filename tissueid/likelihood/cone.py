"""Least squares over passive parameters: a compiled active-set solver on normal equations.

Minimise ``theta' H theta - 2 b' theta`` where blocks of theta are polynomials that must not be
negative on [0, 1].  Each block is a non-negative combination of generators (see
:mod:`tissueid.model.polynomial`), so the problem is non-negative least squares (Lawson & Hanson 1974)
in the generators' weights.  A block of degree 2 has infinitely many generators ``(u - r)^2``; the one
whose reduced gradient is most negative, found in closed form, is added until none is, which makes
the result exact and not merely sufficient.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.model.polynomial import MAX_DEGREE, minimum_on_unit

__all__ = ["cone_least_squares", "least_squares_values", "support_directions"]

FloatArray = NDArray[np.float64]

#: Generators added at most, rounds of adding, and the reduced gradient (relative) that counts as none.
MAX_ADDED = 48
ROUNDS = 24
DUAL_TOLERANCE = 1e-11
#: Ridge, relative to the scaled diagonal, that keeps nearly equal generators apart.
RIDGE = 1e-14
QUADRATIC = 3
#: A block below this fraction of theta is zero; a polynomial below this fraction of itself touches zero.
VANISHED = 1e-12
TOUCHES = 1e-7


@kernel()
def _solve_passive(a: FloatArray, b: FloatArray, passive: NDArray[np.bool_]) -> FloatArray:
    """Solution of the normal equations restricted to the passive set; zero elsewhere."""
    index = np.flatnonzero(passive)
    m = index.size
    low = np.zeros((m, m))
    z = np.zeros(m)
    for i in range(m):
        for j in range(i + 1):
            value = a[index[i], index[j]]
            if i == j:
                value += RIDGE
            for k in range(j):
                value -= low[i, k] * low[j, k]
            if i == j:
                low[i, i] = np.sqrt(max(value, RIDGE))
            else:
                low[i, j] = value / low[j, j]
    for i in range(m):
        value = b[index[i]]
        for k in range(i):
            value -= low[i, k] * z[k]
        z[i] = value / low[i, i]
    for i in range(m - 1, -1, -1):
        value = z[i]
        for k in range(i + 1, m):
            value -= low[k, i] * z[k]
        z[i] = value / low[i, i]
    out = np.zeros(b.size)
    for i in range(m):
        out[index[i]] = z[i]
    return out


@kernel()
def _nnls(a: FloatArray, b: FloatArray) -> FloatArray:
    """Minimise x'Ax - 2b'x over x >= 0 for a matrix scaled to unit diagonal."""
    n = b.size
    x = np.zeros(n)
    passive = np.zeros(n, dtype=np.bool_)
    scale = np.abs(b).max() if n else 0.0
    for _ in range(6 * n + 6):
        gradient = b - a @ x
        best = -1
        largest = DUAL_TOLERANCE * scale
        for j in range(n):
            if not passive[j] and gradient[j] > largest:
                largest = gradient[j]
                best = j
        if best < 0:
            break
        passive[best] = True
        for _inner in range(n + 1):
            z = _solve_passive(a, b, passive)
            step = 1.0
            for j in range(n):
                if passive[j] and z[j] <= 0.0:
                    ratio = x[j] / (x[j] - z[j]) if x[j] > z[j] else 0.0
                    step = min(step, ratio)
            if step >= 1.0:
                x = z
                break
            for j in range(n):
                if passive[j]:
                    x[j] += step * (z[j] - x[j])
                    if z[j] <= 0.0 and x[j] <= 1e-15 * scale:
                        x[j] = 0.0
                        passive[j] = False
            if not passive[best] and x[best] == 0.0:
                # the new column left at once: rounding; nothing more is to be gained
                break
    return x


@kernel()
def _add_generators(
    generators: FloatArray,
    count: int,
    weights: FloatArray,
    gradient: FloatArray,
    blocks: NDArray[np.int64],
    tolerance: float,
) -> int:
    """Append, for each quadratic block, the (u - r)^2 of steepest descent, if any; new count."""
    start = 0
    for size in blocks:
        if size == QUADRATIC:
            g0, g1, g2 = gradient[start], gradient[start + 1], gradient[start + 2]
            # g . (u - r)^2 = g2 - 2 r g1 + r^2 g0, smallest at r = g1 / g0 where g0 > 0
            if g0 > 0.0 and 0.0 < g1 < g0 and count < generators.shape[0]:
                r = g1 / g0
                if g2 - 2.0 * r * g1 + r * r * g0 < -tolerance:
                    count = _append(generators, count, start, r)
                    count = _append_mean(generators, count, weights, start)
        start += size
    return count


@kernel()
def _append(generators: FloatArray, count: int, start: int, r: float) -> int:
    """Append ``(u - r)^2`` to the block that starts there, as far as there is room; new count."""
    if count < generators.shape[0]:
        generators[count, :] = 0.0
        generators[count, start] = r * r
        generators[count, start + 1] = -2.0 * r
        generators[count, start + 2] = 1.0
        count += 1
    return count


@kernel()
def _append_mean(generators: FloatArray, count: int, weights: FloatArray, start: int) -> int:
    """Append the weighted mean of the touching points that a block uses, where they are several; new count.

    Two neighbours share the weight of the one between them: their mean is off by the square of their
    distance, so that rounds double the digits, where steepest descent alone halves an interval.
    """
    total, mean, used = 0.0, 0.0, 0
    for i in range(weights.size):
        r = -0.5 * generators[i, start + 1]
        # a parabola that touches inside: r^2, -2 r, 1
        if weights[i] > 0.0 and generators[i, start + 2] == 1.0 and 0.0 < r < 1.0:
            total += weights[i]
            mean += weights[i] * r
            used += 1
    return _append(generators, count, start, mean / total) if used > 1 else count


@kernel()
def cone_least_squares(
    h: FloatArray,
    b: FloatArray,
    blocks: NDArray[np.int64],
    start: FloatArray,
    tolerance: float = DUAL_TOLERANCE,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Minimise ``theta' H theta - 2 b' theta`` over passive theta.

    Parameters
    ----------
    h : ndarray, shape (p, p)
        Positive semi-definite.
    b : ndarray, shape (p,)
    blocks : ndarray of int
        Sizes of the polynomial blocks (1, 2 or 3), summing to p.
    start : ndarray, shape (p, p)
        The generators every solve begins with, one a row.
    tolerance : float
        Reduced gradient of a generator, relative to ``b``, that counts as none.

    Returns
    -------
    theta : ndarray, shape (p,)
    generators : ndarray, shape (g, p)
    weights : ndarray, shape (g,)
        ``theta = weights @ generators``.
    """
    p = b.size
    generators = np.zeros((p + MAX_ADDED, p))
    generators[:p] = start
    count = p
    theta = np.zeros(p)
    weights = np.zeros(count)
    norm = np.zeros(p + MAX_ADDED)
    for _ in range(ROUNDS):
        c = generators[:count]
        a = c @ h @ np.ascontiguousarray(c.T)
        for i in range(count):
            norm[i] = np.sqrt(max(a[i, i], 1e-300))
        for i in range(count):
            for j in range(count):
                a[i, j] /= norm[i] * norm[j]
        rhs = (c @ b) / norm[:count]
        weights = _nnls(a, rhs) / norm[:count]
        theta = weights @ c
        gradient = h @ theta - b
        scale = np.abs(b).max()
        added = _add_generators(generators, count, weights, gradient, blocks, tolerance * scale)
        if added == count:
            break
        count = added
    used = weights.size
    return theta, generators[:used].copy(), weights


@kernel()
def least_squares_values(
    gram: FloatArray, picks: NDArray[np.int64], blocks: NDArray[np.int64], start: FloatArray
) -> FloatArray:
    """Least sums of squares for many choices of columns.

    Parameters
    ----------
    gram : ndarray, shape (m, m)
        Of all columns; what is explained stands last.
    picks : ndarray of int, shape (n, p)
        Columns of each choice.
    blocks, start
        As in :func:`cone_least_squares`.

    Returns
    -------
    ndarray, shape (n,)
    """
    n, p = picks.shape
    out = np.empty(n)
    h = np.empty((p, p))
    b = np.empty(p)
    for i in range(n):
        for j in range(p):
            b[j] = gram[picks[i, j], -1]
            for k in range(p):
                h[j, k] = gram[picks[i, j], picks[i, k]]
        theta, _, _ = cone_least_squares(h, b, blocks, start)
        out[i] = gram[-1, -1] - 2.0 * (b @ theta) + theta @ (h @ theta)
    return out


def _active_normals(q: FloatArray, size: float) -> FloatArray:
    """Normals of the passive set at one polynomial, one a row; none where it is positive throughout.

    Judged by the polynomial itself: the generators that sum up to a touching one need not touch.
    """
    degree = q.size - 1
    powers = np.arange(degree + 1)
    if np.abs(q).max() <= VANISHED * size:
        return np.eye(degree + 1)
    limit = TOUCHES * float(np.abs(q).max())
    slope = np.where(powers == 1, 1.0, 0.0)
    rows = []
    if q[0] <= limit:
        rows.append(np.where(powers == 0, 1.0, 0.0))
        if degree == MAX_DEGREE and q[1] <= limit:
            rows.append(slope)
    if q.sum() <= limit and degree > 0:
        rows.append(np.ones(degree + 1))
        if degree == MAX_DEGREE and -(q[1] + 2.0 * q[2]) <= limit:
            rows.append(powers.astype(np.float64))
    if not rows and degree == MAX_DEGREE and minimum_on_unit(q) <= limit:
        rows.append((-q[1] / (2.0 * q[2])) ** powers)
    return np.array(rows).reshape(-1, degree + 1)


def support_directions(
    generators: FloatArray, weights: FloatArray, blocks: NDArray[np.int64]
) -> tuple[FloatArray, bool]:
    """Directions in which theta can move both ways without leaving the passive set, to first order.

    Parameters
    ----------
    generators, weights
        From :func:`cone_least_squares`.
    blocks : ndarray of int

    Returns
    -------
    directions : ndarray, shape (p, d)
        Orthonormal columns.
    bounded : bool
        True where d < p: a passivity bound is active.
    """
    theta = weights @ generators
    size = max(float(np.abs(theta).max(initial=0.0)), 1e-300)
    p = theta.size
    normals = np.zeros((0, p))
    first = 0
    for width in blocks:
        rows = _active_normals(theta[first : first + width], size)
        placed = np.zeros((rows.shape[0], p))
        placed[:, first : first + width] = rows
        normals = np.concatenate([normals, placed])
        first += int(width)
    if normals.shape[0] == 0:
        return np.eye(p), False
    _, singular, right = np.linalg.svd(normals)
    rank = int((singular > 1e-7 * singular[0]).sum())
    return np.ascontiguousarray(right[rank:].T), True
