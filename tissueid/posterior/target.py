"""The posterior of a specimen as samplers see it: a density over a few coordinates, and an exact redraw.

Only relaxation times, noise and scales are sampled.  The linear parameters (F_s and K), the gains and the
contact offsets of the logs are integrated, and drawn anew from their exact conditional for each point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Redrawn", "Target"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Redrawn:
    """Full draws, one for each sampled point.

    Attributes
    ----------
    theta : ndarray, shape (n, p)
        Of the contact model, in the order of its ``parameter_names``; each is passive.
    gain : ndarray, shape (n, logs)
        Gain of each log (1 where it has none).
    offset_mm : ndarray, shape (n, logs)
        Contact point of each log against the one it was summed with.
    sigma_N, phi : ndarray, shape (n,)
    linear : ndarray, shape (n, q)
        Coefficients by powers of u as they were drawn, before a common gain was made exact.
    acceptance : float
        Share of proposals of the rejection step that were passive; 1 where no bound is near.
    """

    theta: FloatArray
    gain: FloatArray
    offset_mm: FloatArray
    sigma_N: FloatArray
    phi: FloatArray
    linear: FloatArray
    acceptance: float

    def some(self, rows: NDArray[np.int64]) -> Redrawn:
        """The draws of some rows."""
        kept = {
            name: getattr(self, name)[rows]
            for name in ("theta", "gain", "offset_mm", "sigma_N", "phi", "linear")
        }
        return replace(self, **kept)


class Target(Protocol):
    """What a sampler needs."""

    @property
    def names(self) -> tuple[str, ...]:
        """Sampled coordinates, as ``ln_tau_1``, ``ln_sigma``, ``arctanh_phi``, ``ln_gain_sd``."""
        ...

    @property
    def mode(self) -> FloatArray:
        """Point of highest density, shape (d,)."""
        ...

    @property
    def covariance(self) -> FloatArray:
        """Laplace covariance at the mode, shape (d, d)."""
        ...

    def log_density(self, points: FloatArray) -> FloatArray:
        """Log posterior density (all constants kept) at points of shape (n, d); -inf outside."""
        ...

    def redraw(self, points: FloatArray, rng: np.random.Generator) -> Redrawn:
        """Draw everything that was integrated, for points of shape (n, d)."""
        ...
