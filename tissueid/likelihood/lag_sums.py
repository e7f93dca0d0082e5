"""Sums of one log for a likelihood with AR(1) noise, for every correlation at once.

Between neighbouring samples of a chain with correlation rho the innovation z_n - rho z_(n-1) has variance
1 - rho^2.  Its Gram matrix is quadratic in rho, and written with the Gram matrix D of the *differences*
z_n - z_(n-1) it loses no digits where rho is close to one::

    sum (z_n - rho z_(n-1))(.)' / (1 - rho^2) = (A - rho B) / (1 + rho) + rho D / (1 - rho^2)

A and B are the Gram matrices of the later and of the earlier sample of every link.  One triple for each
distinct sampling step h gives rho = phi^(h / reference step); chains are broken at gaps, at samples that
take no part, and at event rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["LagSums"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LagSums:
    """Gram matrices of one log; the columns are those of :class:`tissueid.likelihood.sums.LogSums`.

    Attributes
    ----------
    start : ndarray, shape (m, m)
        Gram matrix of the samples that start a chain.
    later, earlier, difference : ndarray, shape (groups, m, m)
        A, B and D of every distinct step.
    ratio : ndarray, shape (groups,)
        Step over the reference step.
    links : ndarray of int, shape (groups,)
    chains : int
    degree : int
        Highest power of x that multiplies a node state.
    reference_step_s : float
    """

    start: FloatArray
    later: FloatArray
    earlier: FloatArray
    difference: FloatArray
    ratio: FloatArray
    links: NDArray[np.int64]
    chains: int
    degree: int
    reference_step_s: float

    @property
    def count(self) -> int:
        """Samples in the likelihood."""
        return self.chains + int(self.links.sum())

    def whitened(self, phi: float) -> tuple[FloatArray, float]:
        """Gram matrix of the whitened columns and ln det of the correlation matrix.

        Parameters
        ----------
        phi : float
            Correlation over one reference step, in [0, 1).

        Returns
        -------
        gram : ndarray, shape (m, m)
            ``Z' R^-1 Z``.
        log_det : float
            ``ln det R``.
        """
        rho = phi**self.ratio
        gram = self.start.copy()
        for k, r in enumerate(rho):
            gram += (self.later[k] - r * self.earlier[k]) / (1.0 + r)
            gram += r / (1.0 - r * r) * self.difference[k]
        return gram, float(self.links @ np.log1p(-rho * rho))
