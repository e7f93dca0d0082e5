"""Adaptive importance sampling of a few coordinates, some of them cut from below.

Proposals are multivariate t, folded at the cuts, so that none is lost there; after each round mean and
covariance follow the weighted draws, and all rounds count together with the density of their mixture
(Cornuet et al. 2012, doi 10.1111/j.1467-9469.2011.00756.x).  Whether the weights can be trusted is told by
the shape of their tail (Vehtari et al. 2024, Pareto-smoothed importance sampling): below 0.7 they can.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.triangular import squared_distances

__all__ = ["MAX_SHAPE", "Weighted", "importance_sample", "pooled", "smoothed"]

FloatArray = NDArray[np.float64]

#: Degrees of freedom of the proposals, and how much wider than the draws so far.
FREEDOM = 5.0
WIDER = 1.15
#: Draws of the first rounds, of the others, and of all at the most.
FIRST, NEXT, MOST = (250, 350), 600, 6_000
#: Rounds after which weights that are worth less than this share of their draws are given up.
HOPELESS_AFTER, HOPELESS = 4, 0.01
#: Shape of the weights' tail above which they can't be trusted.
MAX_SHAPE = 0.7
#: Draws the weights must be worth: fewer leave the end of a 95 % interval uncertain by a fifth of an sd.
FEWEST = 150.0
#: Fewer weights than this are no tail.
SHORTEST_TAIL = 8


@dataclass(frozen=True, slots=True, eq=False)
class Weighted:
    """Weighted draws.

    Attributes
    ----------
    points : ndarray, shape (n, d)
    extra : ndarray, shape (n, p)
        What the density drew beside each point.
    weights : ndarray, shape (n,)
        Smoothed, of sum 1.
    size : float
        Draws they are worth.
    shape : float
        Of the tail of the raw weights.
    propagated : bool
        True where the instrument is as its prior has it, whatever the data say of it.
    """

    points: FloatArray
    extra: FloatArray
    weights: FloatArray
    size: float
    shape: float
    propagated: bool = False

    @property
    def converged(self) -> bool:
        """Whether the weights can be trusted, and leave enough draws for the ends of an interval."""
        return self.shape < MAX_SHAPE and self.size >= FEWEST


def _signs(fold: FloatArray) -> FloatArray:
    """All ways to unfold: 1 or -1 for each coordinate that is cut."""
    choices = [(1.0, -1.0) if np.isfinite(cut) else (1.0,) for cut in fold]
    return np.array(list(product(*choices)))


def _folds(mean: FloatArray, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The nearer cut of every coordinate (infinite: none), and which side of it is inside."""
    at_lower = mean - lower <= upper - mean
    return np.where(at_lower, lower, upper), np.where(at_lower, 1.0, -1.0)


def _log_t(points: FloatArray, mean: FloatArray, factor: FloatArray, fold: FloatArray) -> FloatArray:
    """Ln density of the folded multivariate t with ``factor @ factor.T`` as its scale matrix."""
    d = mean.size
    cut = np.where(np.isfinite(fold), fold, 0.0)
    parts = []
    for sign in _signs(fold):
        distance = squared_distances(cut + sign * (points - cut), mean[None], factor[None])[:, 0]
        parts.append(-0.5 * (FREEDOM + d) * np.log1p(distance / FREEDOM))
    norm = math.lgamma(0.5 * (FREEDOM + d)) - math.lgamma(0.5 * FREEDOM)
    norm -= 0.5 * d * math.log(FREEDOM * math.pi) + float(np.log(np.diag(factor)).sum())
    return np.asarray(np.logaddexp.reduce(parts, axis=0) + norm)


def _draw(
    mean: FloatArray,
    factor: FloatArray,
    fold: FloatArray,
    side: FloatArray,
    count: int,
    rng: np.random.Generator,
) -> FloatArray:
    z = rng.standard_normal((count, mean.size))
    z *= np.sqrt(FREEDOM / rng.chisquare(FREEDOM, count))[:, None]
    points = mean + z @ factor.T
    cut = np.isfinite(fold)
    points[:, cut] = fold[cut] + side[cut] * np.abs(points[:, cut] - fold[cut])
    return points


def _factor(covariance: FloatArray) -> FloatArray:
    """Lower Cholesky factor of a covariance, made positive definite by a little if need be."""
    unit = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    scaled = covariance / unit / unit[:, None] + 1e-9 * np.eye(unit.size)
    return np.asarray(np.linalg.cholesky(scaled) * unit[:, None])


def tail_shape(excess: FloatArray) -> tuple[float, float]:
    """Shape and scale of a generalised Pareto distribution.

    Zhang & Stephens 2009, doi 10.1198/tech.2009.08017.

    Parameters
    ----------
    excess : ndarray, shape (n,)
        Ascending, above the threshold.
    """
    n = excess.size
    grid = 30 + int(math.sqrt(n))
    quartile = excess[int(n / 4 + 0.5) - 1]
    b = 1.0 - np.sqrt(grid / (np.arange(1, grid + 1) - 0.5))
    b = b / (3.0 * quartile) + 1.0 / excess[-1]
    k = np.log1p(-b[:, None] * excess).mean(axis=1)
    likelihood = n * (np.log(-b / k) - k - 1.0)
    weight = np.exp(likelihood - likelihood.max())
    best = float(b @ weight / weight.sum())
    shape = float(np.log1p(-best * excess).mean())
    # a little prior weight for 0.5 steadies small samples
    return (n * shape + 5.0) / (n + 10.0), -shape / best


def smoothed(weights: FloatArray) -> tuple[FloatArray, float]:
    """Weights with their largest replaced by quantiles of a Pareto tail, and its shape.

    Parameters
    ----------
    weights : ndarray, shape (n,)
        Of sum 1.
    """
    n = weights.size
    tail = int(min(0.2 * n, 3.0 * math.sqrt(n)))
    order = np.argsort(weights, kind="stable")
    largest = order[n - tail :]
    threshold = weights[order[n - tail - 1]]
    excess = weights[largest] - threshold
    if tail < SHORTEST_TAIL or not excess[int(tail / 4 + 0.5) - 1] > 0.0:
        return weights, math.inf
    with np.errstate(all="ignore"):
        shape, scale = tail_shape(excess)
    if not (math.isfinite(shape) and math.isfinite(scale)):
        # one weight stands for all
        return weights, math.inf
    away = -np.log1p(-(np.arange(tail) + 0.5) / tail)
    quantiles = scale * (np.expm1(shape * away) / shape if abs(shape) > 1e-9 else away)
    out = weights.copy()
    out[largest] = np.minimum(threshold + quantiles, weights[order[-1]])
    return out / out.sum(), shape


def pooled(sets: Sequence[Weighted]) -> Weighted:
    """Sets of draws from one density, each counted by what it is worth."""
    total = sum(one.size for one in sets)
    weights, shape = smoothed(np.concatenate([one.size / total * one.weights for one in sets]))
    return Weighted(
        points=np.vstack([one.points for one in sets]),
        extra=np.vstack([one.extra for one in sets]),
        weights=weights,
        size=1.0 / float((weights**2).sum()),
        shape=shape,
    )


def importance_sample(
    density: Callable[[FloatArray, np.random.Generator], tuple[FloatArray, FloatArray]],
    mean: FloatArray,
    covariance: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    rng: np.random.Generator,
    *,
    size: float,
) -> Weighted:
    """Draw until the weights are worth ``size`` draws, or :data:`MOST` have been made.

    Parameters
    ----------
    density : callable
        Points of shape (n, d) and a generator -> ln of the density (of what is drawn beside: divided by the
        density it was drawn with), shape (n,), and what was drawn beside, shape (n, p).
    mean, covariance : ndarray, shape (d,) and (d, d)
        Of the first proposal.
    lower, upper : ndarray, shape (d,)
        Cuts, infinite where there are none; proposals are folded at the one nearer to ``mean``.
    rng : numpy.random.Generator
    size : float
    """
    fold, side = _folds(mean, lower, upper)
    proposals: list[tuple[FloatArray, FloatArray]] = [(mean, _factor(covariance))]
    points, extra, target = np.zeros((0, mean.size)), None, np.zeros(0)
    counts: list[int] = []
    while True:
        count = FIRST[len(counts)] if len(counts) < len(FIRST) else NEXT
        fresh = _draw(*proposals[-1], fold, side, count, rng)
        value, beside = density(fresh, rng)
        points = np.vstack([points, fresh])
        extra = beside if extra is None else np.vstack([extra, beside])
        target = np.concatenate([target, value])
        counts.append(count)
        share = np.log(np.array(counts) / points.shape[0])
        mixture = np.logaddexp.reduce(
            [part + _log_t(points, *one, fold) for part, one in zip(share, proposals, strict=True)], axis=0
        )
        raw = np.where(np.isfinite(target), target, -np.inf) - mixture
        weights = np.exp(raw - raw.max())
        weights /= weights.sum()
        worth = 1.0 / float((weights**2).sum())
        if len(counts) > len(FIRST) and (worth >= size or points.shape[0] >= MOST):
            break
        if len(counts) == HOPELESS_AFTER and worth < HOPELESS * points.shape[0]:
            break
        # a few large weights shall not decide where the next round looks
        cut = np.minimum(weights, 1.0 / math.sqrt(weights.size))
        cut /= cut.sum()
        centre = cut @ points
        spread = (points - centre).T @ ((points - centre) * cut[:, None])
        trust = min(1.0, worth / (10.0 * mean.size))
        spread = trust * spread + (1.0 - trust) * covariance
        proposals.append((centre, _factor(WIDER**2 * spread * (FREEDOM - 2.0) / FREEDOM)))
    weights, shape = smoothed(weights)
    return Weighted(points, extra, weights, 1.0 / float((weights**2).sum()), shape)
