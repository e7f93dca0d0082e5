"""The coordinates in which specimens are compared: logarithms of positive numbers of the tissue.

At a depth d that all specimens reached::

    phi = ( ln F_s(d/3), ln F_s(2d/3), ln F_s(d),   then for each branch
            ln eta(x_1) .. ln eta(x_m),  ln tau ),        eta(x) = K(x) tau,  x_k = k d / m

with m the number of coefficients of K.  One to one with theta where the static force and every K are
positive at these depths.  Back from phi the polynomials may be negative between them: such a tissue is not
passive, and a draw of it is refused by who asked for it.  Viscosity stands for stiffness because the two
factors of K tau are nearly dependent and their product is what ramps tell (model.md 2, derived).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.model.base import branch_suffix
from tissueid.model.channels import ChannelModel
from tissueid.model.kelvin_voigt import STATIC_DEGREE, kelvin_voigt

#: Passive draws may vanish at a depth: a number below this share of its median over the specimen's draws is
#: set to it. At e^-14 of the typical value it has no weight in any population.
FLOOR_SHARE = 1e-6


@dataclass(frozen=True, slots=True)
class Coordinates:
    """Maps between theta of a contact model and phi."""

    branches: int
    stiffness_degree: int
    depth_mm: float  # the common depth d

    @property
    def model(self) -> ChannelModel:
        """The contact model on [0, d]."""
        return kelvin_voigt(self.branches, self.stiffness_degree, self.depth_mm)

    @property
    def size(self) -> int:
        """Number of coordinates, that of theta."""
        return STATIC_DEGREE + self.branches * (self.stiffness_degree + 2)

    @property
    def static_depths_mm(self) -> FloatArray:
        """Depths of the three static forces [mm]."""
        return self.depth_mm * np.arange(1.0, STATIC_DEGREE + 1) / STATIC_DEGREE

    @property
    def branch_depths_mm(self) -> FloatArray:
        """Depths of the viscosities of a branch [mm]."""
        count = self.stiffness_degree + 1
        return self.depth_mm * np.arange(1.0, count + 1) / count

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the quantities whose logarithms are the coordinates; units at their end."""
        names = [f"static_force_{k}_N" for k in range(1, STATIC_DEGREE + 1)]
        for branch in range(self.branches):
            suffix = branch_suffix(branch)
            names += [f"viscosity_{k}_N_s_per_mm{suffix}" for k in range(1, self.stiffness_degree + 2)]
            names.append(f"relaxation_time_s{suffix}")
        return tuple(names)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each quantity."""
        branch = ["N s/mm"] * (self.stiffness_degree + 1) + ["s"]
        return tuple(["N"] * STATIC_DEGREE + branch * self.branches)

    @property
    def words(self) -> tuple[str, ...]:
        """Each quantity in words, with its depth."""
        words = [f"static force at {depth:.3g} mm" for depth in self.static_depths_mm]
        for branch in range(self.branches):
            of = f" of branch {branch + 1}" if self.branches > 1 else ""
            words += [f"viscosity{of} at {depth:.3g} mm" for depth in self.branch_depths_mm]
            words.append(f"relaxation time{of}")
        return tuple(words)

    def quantities(self, theta: FloatArray) -> FloatArray:
        """The positive numbers of tissues, shape (n, p), from theta, shape (n, p)."""
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        out = np.empty_like(theta)
        out[:, :STATIC_DEGREE] = theta[:, :STATIC_DEGREE] @ self._static().T
        for first, last in self._blocks():
            tau = theta[:, last]
            out[:, first:last] = (theta[:, first:last] @ self._branch().T) * tau[:, None]
            out[:, last] = tau
        return out

    def to_phi(self, theta: FloatArray) -> tuple[FloatArray, int]:
        """Coordinates of tissues.

        ``theta`` (n, p): in the order of the contact model.  Returns ``phi`` (n, p); ``floored``: rows of
        which a number was raised to :data:`FLOOR_SHARE` of its median.
        """
        values = self.quantities(theta)
        floor = FLOOR_SHARE * np.maximum(np.median(values, axis=0), np.finfo(np.float64).tiny / FLOOR_SHARE)
        low = values < floor
        return np.log(np.where(low, floor, values)), int(low.any(axis=1).sum())

    def to_theta(self, phi: FloatArray) -> FloatArray:
        """Theta of the tissues at phi, shape (n, p); inverse of :meth:`to_phi` where nothing was floored."""
        phi = np.atleast_2d(np.asarray(phi, dtype=np.float64))
        values = np.exp(phi)
        out = np.empty_like(values)
        out[:, :STATIC_DEGREE] = np.linalg.solve(self._static(), values[:, :STATIC_DEGREE].T).T
        for first, last in self._blocks():
            stiffness = np.exp(phi[:, first:last] - phi[:, last, None])
            out[:, first:last] = np.linalg.solve(self._branch(), stiffness.T).T
            out[:, last] = values[:, last]
        return out

    def log_jacobian(self, phi: FloatArray) -> FloatArray:
        """Ln of abs det(d theta / d phi), shape (n,): a density of theta times it is one of phi."""
        phi = np.atleast_2d(phi)
        value = phi[:, :STATIC_DEGREE].sum(axis=1) - _log_det(self._static())
        for first, last in self._blocks():
            log_tau = phi[:, last]
            value += (phi[:, first:last] - log_tau[:, None]).sum(axis=1) + log_tau - _log_det(self._branch())
        return np.asarray(value)

    def passive(self, theta: FloatArray) -> NDArray[np.bool_]:
        """True for tissues that are passive on [0, d], with their relaxation times ascending; shape (n,)."""
        model, ends = self.model, [last for _, last in self._blocks()]
        ascending = np.asarray((np.diff(theta[:, ends], axis=1) > 0.0).all(axis=1))
        return np.array([bool(ascending[i]) and model.is_passive(row) for i, row in enumerate(theta)])

    def _blocks(self) -> list[tuple[int, int]]:
        """First coefficient of K, and the relaxation time, of each branch."""
        block = self.stiffness_degree + 2
        starts = [STATIC_DEGREE + branch * block for branch in range(self.branches)]
        return [(first, first + block - 1) for first in starts]

    def _static(self) -> FloatArray:
        return np.asarray(self.static_depths_mm[:, None] ** np.arange(1.0, STATIC_DEGREE + 1))

    def _branch(self) -> FloatArray:
        return np.asarray(self.branch_depths_mm[:, None] ** np.arange(self.stiffness_degree + 1.0))


def _log_det(matrix: FloatArray) -> float:
    sign, value = np.linalg.slogdet(matrix)
    return float(value) if sign != 0.0 else -math.inf
