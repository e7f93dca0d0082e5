"""The coordinates in which specimens are compared: logarithms of positive numbers of the tissue.

At a depth d that all specimens reached the quantities are::

    F_s(d/m), F_s(2d/m) .. F_s(d),   m coefficients of the static law, then its shapes,
    then for each relaxing part
    eta(x_1) .. eta(x_n), shapes,    eta(x) = K(x) tau,  x_k = k d / n

with n the number of coefficients of K.  phi are the logarithms of F_s(d), of the other F_s and of eta(d) over
it, of the other eta over eta(d), and of the shapes: a tissue that is stiffer by one factor has all forces
larger, and a prior that holds logarithms of forces to be all but independent would call that incredible.
Where a relaxation is no exponential, K stands for eta.  Viscosity stands for stiffness because ramps tell the
product K tau (derived).  Back from phi a tissue may be negative between the depths or leave its bounds: a
draw of it is refused by who asked for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.model.base import branch_suffix
from tissueid.model.channels import ChannelModel

#: Passive draws may vanish at a depth: a number below this share of its median over the specimen's draws is
#: set to it. At e^-14 of the typical value it has no weight in any population.
FLOOR_SHARE = 1e-6
#: Bounds of a shape are kept to within rounding.
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Coordinates:
    """Maps between theta of a contact model, on [0, d], and phi."""

    model: ChannelModel

    @property
    def depth_mm(self) -> float:
        """The common depth d [mm]."""
        return self.model.depth_mm

    @property
    def size(self) -> int:
        """Number of coordinates, that of theta."""
        return len(self.model.parameters)

    @property
    def static_at_depth(self) -> int:
        """Coordinate of the static force at the common depth."""
        return self._static_size - 1

    @property
    def shapes(self) -> NDArray[np.int64]:
        """Coordinates of shapes, times among them."""
        return self.model.shape_places

    @property
    def times(self) -> NDArray[np.int64]:
        """Coordinates of relaxation times, which ascend."""
        return self.model.time_places

    @property
    def logs(self) -> FloatArray:
        """From phi to logarithms of the quantities, (p, p), of determinant 1: a ratio has its base added."""
        force = self.static_at_depth
        base = np.zeros((self.size, self.size))
        base[:force, force] = 1.0
        for at, _ in self._blocks():
            base[at, force] = 1.0
            base[at.start : at.stop - 1, at.stop - 1] = 1.0
        return np.eye(self.size) + base

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the quantities, units at their end."""
        return tuple(name for name, _, _ in self._described())

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each quantity."""
        return tuple(unit for _, unit, _ in self._described())

    @property
    def words(self) -> tuple[str, ...]:
        """Each quantity in words, with its depth."""
        return tuple(words for _, _, words in self._described())

    def _described(self) -> list[tuple[str, str, str]]:
        """Name, unit and words of each quantity."""
        said = [(spec.name, spec.unit, spec.meaning) for spec in self.model.parameters]
        for k, depth in enumerate(self._depths(self._static_size)):
            said[k] = (f"static_force_{k + 1}_N", "N", f"static force at {depth:.3g} mm")
        kind, name, unit = ("stiffness", "stiffness_at_{}_N_per_mm", "N/mm")
        if self.model.viscous:
            kind, name, unit = ("viscosity", "viscosity_{}_N_s_per_mm", "N s/mm")
        blocks = list(self._blocks())
        for branch, (at, time) in enumerate(blocks):
            of = f" of branch {branch + 1}" if len(blocks) > 1 else ""
            for k, depth in enumerate(self._depths(at.stop - at.start)):
                own = name.format(k + 1) + branch_suffix(branch)
                said[at.start + k] = (own, unit, f"{kind}{of} at {depth:.3g} mm")
            if time is not None:
                said[time] = (*said[time][:2], f"relaxation time{of}")
        return said

    def quantities(self, theta: FloatArray) -> FloatArray:
        """The positive numbers of tissues, shape (n, p), from theta, shape (n, p)."""
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        out = theta.copy()
        static = self._static_size
        out[:, :static] = (self._static(theta) @ theta[:, :static, None])[..., 0]
        for at, time in self._blocks():
            scale = 1.0 if time is None else theta[:, time, None]
            out[:, at] = (theta[:, at] @ self._branch(at).T) * scale
        return out

    def to_phi(self, theta: FloatArray) -> tuple[FloatArray, int]:
        """Coordinates (n, p) of tissues (n, p), and how many of them were raised to :data:`FLOOR_SHARE`."""
        values = self.quantities(theta)
        floor = FLOOR_SHARE * np.maximum(np.median(values, axis=0), np.finfo(np.float64).tiny / FLOOR_SHARE)
        low = values < floor
        phi = np.log(np.where(low, floor, values)) @ np.linalg.inv(self.logs).T
        return phi, int(low.any(axis=1).sum())

    def to_theta(self, phi: FloatArray) -> FloatArray:
        """Theta of the tissues at phi, shape (n, p); inverse of :meth:`to_phi` where nothing was floored."""
        phi = np.atleast_2d(np.asarray(phi, dtype=np.float64)) @ self.logs.T
        out = np.exp(phi)
        static = self._static_size
        out[:, :static] = np.linalg.solve(self._static(out), out[:, :static, None])[..., 0]
        for at, time in self._blocks():
            stiffness = np.exp(phi[:, at] - (0.0 if time is None else phi[:, time, None]))
            out[:, at] = np.linalg.solve(self._branch(at), stiffness.T).T
        return out

    def log_jacobian(self, phi: FloatArray) -> FloatArray:
        """Ln of abs det(d theta / d phi), shape (n,): a density of theta times it is one of phi."""
        phi = np.atleast_2d(np.asarray(phi, dtype=np.float64)) @ self.logs.T
        value = phi.sum(axis=1) - np.linalg.slogdet(self._static(np.exp(phi)))[1]
        for at, time in self._blocks():
            value = value - np.linalg.slogdet(self._branch(at))[1]
            if time is not None:
                value = value - (at.stop - at.start) * phi[:, time]
        return np.asarray(value)

    def passive(self, theta: FloatArray) -> NDArray[np.bool_]:
        """True for tissues that are passive on [0, d], shapes in their bounds, times ascending; (n,)."""
        specs = [self.model.parameters[k] for k in self.shapes]
        low = np.array([one.lower for one in specs]) * (1.0 - ROUNDING)
        high = np.array([one.upper for one in specs]) * (1.0 + ROUNDING)
        shapes = theta[:, self.shapes]
        inside = np.asarray(((shapes >= low) & (shapes <= high)).all(axis=1))
        good = inside & (np.diff(theta[:, self.times], axis=1) > 0.0).all(axis=1)
        return np.asarray(good & self.model.passive(theta))

    @property
    def _static_size(self) -> int:
        return len(self.model.static.coefficients)

    def _depths(self, count: int) -> FloatArray:
        """Depths at which so many numbers are taken [mm]."""
        return self.depth_mm * np.arange(1.0, count + 1) / count

    def _blocks(self) -> Iterator[tuple[slice, int | None]]:
        """Coefficients of K of each part, and the place of the time that makes it a viscosity."""
        for part in self.model.parts:
            if part.ratio is None:
                yield part.stiffness, part.shapes.start if self.model.viscous else None

    def _static(self, theta: FloatArray) -> FloatArray:
        """Static forces at the depths by the coefficients, (n, m, m) or (1, m, m), from rows of theta."""
        count, static = self._static_size, self.model.static
        shapes = theta[:, count : count + len(static.shapes)].T
        depths = self._depths(count)
        if not len(shapes):
            return np.asarray(static.basis(depths)).T[None]
        return np.moveaxis(np.asarray(static.basis(depths[:, None], *shapes)), (0, 1, 2), (2, 1, 0))

    def _branch(self, at: slice) -> FloatArray:
        count = at.stop - at.start
        return np.asarray(self._depths(count)[:, None] ** np.arange(float(count)))
