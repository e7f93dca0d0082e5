"""A density in one or two coordinates as cells, each log-linear: quadrature, and a proposal to draw from.

The cells lie in whitened coordinates (the Laplace covariance is the unit matrix there), cover the region
within :data:`DEEP` of the maximum, and are halved where the density is not log-linear in them.  A draw picks
a cell by its mass and takes each coordinate by the inverse of its cumulative exponential.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.posterior.target import Target

__all__ = ["MAX_COORDINATES", "Cells", "cells"]

FloatArray = NDArray[np.float64]

#: Cells grow as a power of the coordinates.
MAX_COORDINATES = 2
#: Fall of the log density beyond which nothing is kept (a share of 1e-11).
DEEP = 25.0
#: First half width [Laplace standard deviations], and how often it is doubled where the density goes on.
FIRST, DOUBLINGS = 6.0, 12
#: Points along a coordinate that look for the region, and cells along it to begin with.
LOOK = 25
BEGIN = 12
#: Largest deviation from log-linear in a cell, and the share of the mass below which it doesn't matter.
STRAIGHT = 0.1
NEGLIGIBLE = 1e-6
ROUNDS, MOST_CELLS = 14, 40_000


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """A proposal.

    Attributes
    ----------
    origin : ndarray, shape (d,)
    axes : ndarray, shape (d, d)
        A point is ``origin + axes @ z``.
    low, width, slope : ndarray, shape (m, d)
        Corner and size of every cell in z, and the rise of the log density across it.
    log_share : ndarray, shape (m,)
        ln of the probability of every cell.
    """

    origin: FloatArray
    axes: FloatArray
    low: FloatArray
    width: FloatArray
    slope: FloatArray
    log_share: FloatArray

    def draw(self, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Points (n, d) and the ln of the density that they are drawn from."""
        cumulative = np.cumsum(np.exp(self.log_share))
        cell = np.searchsorted(cumulative, rng.random(n) * cumulative[-1], side="right")
        cell = np.minimum(cell, cumulative.size - 1)
        slope = self.slope[cell]
        share = _exponential(slope, rng.random((n, self.origin.size)))
        points = self.origin + (self.low[cell] + share * self.width[cell]) @ self.axes.T
        inside = (slope * share - _log_mean_exp(slope) - np.log(self.width[cell])).sum(axis=1)
        return points, self.log_share[cell] + inside - float(np.log(np.diag(self.axes)).sum())


def _log_mean_exp(slope: FloatArray) -> FloatArray:
    """Ln of the mean of exp(slope u) over u in (0, 1)."""
    size = np.maximum(np.abs(slope), 1e-9)
    return np.asarray(np.maximum(slope, 0.0) + np.log(-np.expm1(-size) / size))


def _exponential(slope: FloatArray, u: FloatArray) -> FloatArray:
    """Inverse of the cumulative distribution of a density exp(slope x) on (0, 1)."""
    size = np.maximum(np.abs(slope), 1e-9)
    falling = np.clip(-np.log1p(u * np.expm1(-size)) / size, 0.0, 1.0)
    return np.asarray(np.where(slope > 0.0, 1.0 - falling, falling))


def _region(target: Target, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Corners of a box in z outside of which the density is below the maximum by DEEP."""
    d = target.mode.size
    low, high = np.full(d, -FIRST), np.full(d, FIRST)
    for _ in range(DOUBLINGS):
        ticks = [np.linspace(a, b, LOOK) for a, b in zip(low, high, strict=True)]
        z = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, d)
        value = target.log_density(target.mode + z @ axes.T)
        top = max(float(value.max()), float(target.log_density(target.mode[None, :])[0]))
        kept = np.concatenate([z[value > top - DEEP], np.zeros((1, d))])
        step = (high - low) / (LOOK - 1)
        first, last = kept.min(axis=0), kept.max(axis=0)
        short = (first <= low + 0.5 * step, last >= high - 0.5 * step)
        if not (short[0] | short[1]).any():
            return first - step, last + step
        low, high = np.where(short[0], 2.0 * low, low), np.where(short[1], 2.0 * high, high)
    return low, high


def _fitted(
    target: Target, axes: FloatArray, low: FloatArray, width: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Level at the low corner, slopes, and deviation from log-linear of cells; level -inf where empty."""
    m, d = low.shape
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=d)))
    at = np.concatenate([corners, np.full((1, d), 0.5)])
    z = low[:, None, :] + at[None, :, :] * width[:, None, :]
    value = target.log_density(target.mode + z.reshape(-1, d) @ axes.T).reshape(m, -1)
    slope = np.empty((m, d))
    finite = np.asarray(np.isfinite(value).all(axis=1))
    safe = np.where(finite[:, None], value, 0.0)
    for k in range(d):
        upper = corners[:, k] > 0.5
        slope[:, k] = safe[:, :-1][:, upper].mean(axis=1) - safe[:, :-1][:, ~upper].mean(axis=1)
    middle = (2.0 * safe[:, -1] + safe[:, :-1].mean(axis=1)) / 3.0
    level = middle - 0.5 * slope.sum(axis=1)
    deviation = np.abs(safe - level[:, None] - slope @ at.T).max(axis=1)
    # a bound runs through the cell: flat at its highest value, and to be halved
    level = np.where(finite, level, value.max(axis=1))
    return level, slope, np.where(finite, deviation, np.inf)


def cells(target: Target) -> Cells:
    """Cells of a target of one or two coordinates.

    Parameters
    ----------
    target : Target
        Its mode and covariance set the first look only; the region is widened until the density has fallen.
    """
    d = target.mode.size
    axes: FloatArray = np.linalg.cholesky(target.covariance).astype(np.float64)
    first, last = _region(target, axes)
    size = (last - first) / BEGIN
    index = np.stack(np.meshgrid(*[np.arange(BEGIN)] * d, indexing="ij"), axis=-1).reshape(-1, d)
    low, width = first + index * size, np.tile(size, (index.shape[0], 1))
    level, slope, deviation = _fitted(target, axes, low, width)
    for _ in range(ROUNDS):
        log_mass = level + (_log_mean_exp(slope) + np.log(width)).sum(axis=1)
        total = np.logaddexp.reduce(log_mass)
        matters = log_mass > total + np.log(NEGLIGIBLE)
        # no peak may hide between the corners: the cell of the mode counts in any case
        matters |= ((low <= 0.0) & (low + width >= 0.0)).all(axis=1)
        split = matters & (deviation > STRAIGHT)
        if not split.any() or low.shape[0] > MOST_CELLS:
            break
        halves = np.array(list(itertools.product((0.0, 0.5), repeat=d)))
        low_new = (low[split][:, None, :] + halves * width[split][:, None, :]).reshape(-1, d)
        width_new = np.repeat(0.5 * width[split], 2**d, axis=0)
        new = (low_new, width_new, *_fitted(target, axes, low_new, width_new))
        old = (low, width, level, slope, deviation)
        low, width, level, slope, deviation = (
            np.concatenate([a[~split], b]) for a, b in zip(old, new, strict=True)
        )
    log_mass = level + (_log_mean_exp(slope) + np.log(width)).sum(axis=1)
    kept = np.isfinite(log_mass)
    log_share = log_mass[kept] - np.logaddexp.reduce(log_mass[kept])
    return Cells(target.mode, axes, low[kept], width[kept], slope[kept], log_share)
