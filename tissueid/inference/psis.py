"""Pareto-smoothed importance sampling.

Vehtari et al. 2024, JMLR 25: 72; the tail by Zhang & Stephens 2009, doi 10.1198/tech.2009.08017.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray

#: Points of positive weight that are too few to weigh, and to fit a tail to.
FEWEST, FEWEST_TAIL = 50, 8
#: Prior of the Pareto shape: a mean, worth so many points.
SHAPE_PRIOR, PRIOR_WORTH = 0.5, 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """Smoothed importance weights, the independent draws they are worth, and the shape of their tail."""

    weights: FloatArray
    worth: float
    pareto: float


def _pareto(tail: FloatArray) -> tuple[float, float]:
    """Shape and scale of a generalised Pareto distribution of ascending exceedances."""
    n = tail.size
    grid = 30 + int(np.sqrt(n))
    quartile = max(float(tail[int(n / 4 + 0.5) - 1]), 1e-300)
    b = 1.0 - np.sqrt(grid / (np.arange(1.0, grid + 1) - 0.5))
    b = b / (3.0 * quartile) + 1.0 / tail[-1]
    k = np.log1p(-b[:, None] * tail).mean(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        profile = n * (np.log(-b / k) - k - 1.0)
    profile = np.where(np.isfinite(profile), profile, -np.inf)
    weight = np.exp(profile - profile.max())
    best = float((b * weight).sum() / weight.sum())
    shape = float(np.log1p(-best * tail).mean())
    scale = -shape / best
    shape = (n * shape + PRIOR_WORTH * SHAPE_PRIOR) / (n + PRIOR_WORTH)
    return shape, float(scale)


def smoothed(log_weight: FloatArray) -> Weighed:
    """Smooth the largest weights by the Pareto distribution that they follow.

    ``log_weight`` (n,): log density over log proposal; minus infinity where the density is none.
    """
    inside = np.flatnonzero(np.isfinite(log_weight))
    weights = np.zeros(log_weight.size)
    if inside.size < FEWEST:
        return Weighed(weights, 0.0, np.inf)
    part = np.exp(log_weight[inside] - log_weight[inside].max())
    size = int(min(0.2 * part.size, 3.0 * np.sqrt(part.size)))
    shape = -np.inf
    order = np.argsort(part)
    cut = part[order[-size - 1]]
    tail = part[order[-size:]] - cut
    if size >= FEWEST_TAIL and tail[-1] > 1e-12 and tail[0] >= 0.0 and np.ptp(tail) > 0.0:
        tail = np.maximum(tail, 1e-300)
        shape, scale = _pareto(tail)
        far = -np.log1p(-(np.arange(size) + 0.5) / size)
        quantiles = scale * (np.expm1(np.minimum(shape * far, 600.0)) / shape if abs(shape) > 1e-9 else far)
        part[order[-size:]] = np.minimum(cut + quantiles, part.max())
    weights[inside] = part / part.sum()
    return Weighed(weights, float(1.0 / (weights**2).sum()), float(shape))
