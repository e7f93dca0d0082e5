"""A smooth function of a few coordinates, as a cubic about the middle of a posterior."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

__all__ = ["Surface", "cubic_terms"]

FloatArray = NDArray[np.float64]


def cubic_terms(z: FloatArray) -> FloatArray:
    """All products of at most three coordinates of points of shape (n, d)."""
    n, d = z.shape
    parts = [np.ones((n, 1))]
    for degree in (1, 2, 3):
        for picked in combinations_with_replacement(range(d), degree):
            parts += [np.prod(z[:, picked], axis=1, keepdims=True)]
    return np.hstack(parts)


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A cubic in standardised coordinates; constant along rays beyond ``radius``.

    Attributes
    ----------
    centre : ndarray, shape (d,)
    whiten : ndarray, shape (d, d)
        ``z = (point - centre) @ whiten``.
    coefficients : ndarray
        Of :func:`cubic_terms`.
    radius : float
        Distance up to which it was fitted, in standard deviations.
    error : float
        Standard deviation of what it does not describe, at points that it was not fitted to.
    """

    centre: FloatArray
    whiten: FloatArray
    coefficients: FloatArray
    radius: float
    error: float

    def __call__(self, points: FloatArray) -> FloatArray:
        """Values at points of shape (n, d)."""
        z = (points - self.centre) @ self.whiten
        far = np.sqrt((z**2).sum(axis=1)) / self.radius
        return np.asarray(cubic_terms(z / np.maximum(far, 1.0)[:, None]) @ self.coefficients)
