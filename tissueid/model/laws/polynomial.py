"""Polynomial of depth without a constant term."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec, static_spec
from tissueid.model.law import About, Shape


@dataclass(frozen=True, slots=True)
class Polynomial:
    """F_s = a1 x + a2 x^2 + ..., of degree 1 to 3."""

    degree: int = 3
    about: ClassVar[About] = About(
        key="polynomial",
        kind="static",
        equation="F_s = a1 x + a2 x^2 + a3 x^3",
        source="10.1109/ROBOT.2009.5152617",
        purpose="structural stiffness of any tool, within the depth it was pushed to",
        refuses="degrees beyond 3; depths beyond the largest of the recordings",
    )
    shapes: ClassVar[tuple[Shape, ...]] = ()
    polynomial: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.degree not in {1, 2, 3}:
            msg = f"a polynomial of degree {self.degree} is not offered, 1 to 3 are"
            raise ValueError(msg)

    @property
    def coefficients(self) -> tuple[ParameterSpec, ...]:
        """a1, a2, ..."""
        return tuple(static_spec(power) for power in range(1, self.degree + 1))

    def basis(self, depth_mm: FloatArray) -> FloatArray:
        """Powers of depth."""
        return np.stack([depth_mm**k for k in range(1, self.degree + 1)])

    def slope(self, depth_mm: FloatArray) -> FloatArray:
        """Derivatives of the powers."""
        return np.stack([k * depth_mm ** (k - 1) for k in range(1, self.degree + 1)])


LAW = Polynomial
