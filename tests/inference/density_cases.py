"""Densities with known moments, as the sampler sees a specimen's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


class Density:
    """A density with a wall far away; the normal beside it is the standard one."""

    is_normal = False

    def __init__(self, size: int, log_density: Callable[[np.ndarray], np.ndarray]) -> None:
        self.size, self._log = size, log_density
        self.centre = np.zeros(size)
        self.rows, self.walls = np.eye(size)[:1], np.array([-50.0])
        self.likely = np.empty(0, dtype=np.int64)
        self.calls = 0

    def densities(self, z: np.ndarray) -> np.ndarray:
        self.calls += 1
        return self._log(z)

    def bent(self, z: np.ndarray) -> np.ndarray:
        return z


MEAN = np.array([0.5, -0.3, 0.2, 0.0])
_ROOT = np.linalg.cholesky(
    np.array([[1.0, 0.8, 0.0, 0.1], [0.8, 1.5, 0.3, 0.0], [0.0, 0.3, 0.7, -0.4], [0.1, 0.0, -0.4, 1.2]])
)
COVARIANCE = _ROOT @ _ROOT.T


def correlated() -> Density:
    """A normal of :data:`MEAN` and :data:`COVARIANCE`."""
    inverse = np.linalg.inv(_ROOT)
    return Density(4, lambda z: -0.5 * (((z - MEAN) @ inverse.T) ** 2).sum(axis=1))


def banana() -> Density:
    """Standard normal first coordinate; the second about its square less one, within 0.4."""

    def log_density(z):
        return -0.5 * z[:, 0] ** 2 - 0.5 * ((z[:, 1] - z[:, 0] ** 2 + 1.0) / 0.4) ** 2

    return Density(2, log_density)
