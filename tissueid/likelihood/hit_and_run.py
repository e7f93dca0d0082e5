"""A walk through a normal that is cut to the passive set, along lines: hit-and-run (Smith 1984).

The set is convex, so that every line cuts it in one stretch, and a normal cut to a stretch is drawn exactly:
nothing is ever refused.  Directions are drawn in the units of the normal, in which only the bounds make it
other than round (Lovász & Vempala 2006, doi 10.1137/S009753970544727X: quick for log-concave densities from
a start that is likely).  It is for normals of which the set leaves so little that independent proposals are
refused by the ten thousand.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.cone import QUADRATIC
from tissueid.likelihood.normal_tail import log_tail, tail_quantile

__all__ = ["cut_normal", "stretch", "walk"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: A stretch shorter than this, in standard deviations, is a point.
SHORTEST = 1e-12


@kernel()
def cut_normal(low: float, high: float, u: float) -> float:
    """Quantile ``u`` of a standard normal between two bounds; accurate in either tail."""
    if low + high < 0.0:
        return -cut_normal(-high, -low, 1.0 - u)
    above_low = log_tail(low)
    above_high = log_tail(high) if high < np.inf else -np.inf
    inside = -math.expm1(above_high - above_low)
    x = tail_quantile(min(above_low + math.log1p(-u * inside), -1e-300))
    return min(max(x, low), high)


@kernel()
def _roots(a: float, b: float, c: float) -> tuple[float, float]:
    """Roots of ``a t^2 + 2 b t + c``, NaN where there is none."""
    square = b * b - a * c
    if square < 0.0:
        return math.nan, math.nan
    q = -(b + math.copysign(math.sqrt(square), b))
    return (q / a if a != 0.0 else math.nan), (c / q if q != 0.0 else math.nan)


@kernel()
def stretch(c: FloatArray, e: FloatArray, blocks: IntArray) -> tuple[float, float]:
    """From where to where ``c + t e`` is passive.

    Parameters
    ----------
    c : ndarray, shape (p,)
        Bernstein coefficients, block by block; passive up to rounding.
    e : ndarray, shape (p,)
        Direction.
    blocks : ndarray of int
        Sizes of the polynomial blocks (1, 2 or 3), summing to p.

    Returns
    -------
    low, high : float
        Not above, and not below 0; infinite where nothing cuts.
    """
    low, high = -np.inf, np.inf
    start = 0
    for size in blocks:
        for k in range(min(size, 2)):
            i = start + k * (size - 1)
            if e[i] > 0.0:
                low = max(low, -c[i] / e[i])
            elif e[i] < 0.0:
                high = min(high, -c[i] / e[i])
        start += size
    start = 0
    for size in blocks:
        if size == QUADRATIC:
            c0, c1, c2 = c[start], c[start + 1], c[start + 2]
            e0, e1, e2 = e[start], e[start + 1], e[start + 2]
            roots = _roots(e1 * e1 - e0 * e2, c1 * e1 - 0.5 * (c0 * e2 + c2 * e0), c1 * c1 - c0 * c2)
            for t in roots:
                # the parabola bounds where c1 is negative; where it is not, the root is of its other half
                if not math.isnan(t) and c1 + t * e1 <= 0.0:
                    if t > 0.0:
                        high = min(high, t)
                    else:
                        low = max(low, t)
        start += size
    return min(low, 0.0), max(high, 0.0)


@kernel()
def walk(
    z: FloatArray, mean: FloatArray, low: FloatArray, blocks: IntArray, steps: int, rng: np.random.Generator
) -> FloatArray:
    """Bernstein coefficients after a number of steps.

    Parameters
    ----------
    z : ndarray, shape (p,)
        Start, in the units of the normal: ``mean + low @ z`` is passive.
    mean : ndarray, shape (p,)
        Of the Bernstein coefficients.
    low : ndarray, shape (p, p)
        A root of their covariance, ``low @ low.T``.
    blocks : ndarray of int
    steps : int
    rng : numpy.random.Generator
    """
    z = z.copy()
    c = mean + low @ z
    for _ in range(steps):
        g = rng.standard_normal(z.size)
        norm = math.sqrt(float(g @ g))
        e = low @ g
        a, b = stretch(c, e, blocks)
        if (b - a) * norm < SHORTEST:
            continue
        centre = -float(z @ g) / (norm * norm)
        t = centre + cut_normal((a - centre) * norm, (b - centre) * norm, rng.random()) / norm
        t = min(max(t, a), b)
        z += t * g
        c += t * e
    return c
