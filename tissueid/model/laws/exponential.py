"""Exponential of depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape

#: Exponent beyond which a law is none.
LARGEST = 200.0


@dataclass(frozen=True, slots=True)
class Exponential:
    """F_s = (k / b) (exp(b x) - 1)."""

    about: ClassVar[About] = About(
        key="exponential",
        kind="static",
        equation="F_s = (k / b) (exp(b x) - 1)",
        source="10.1152/ajplegacy.1967.213.6.1532",
        purpose="soft tissue that stiffens with strain as Fung's does",
        refuses="tissue that softens with depth",
    )
    polynomial: ClassVar[bool] = False
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec(
            "static_stiffness_N_per_mm", "k", "N/mm", 0.0, np.inf, "static stiffness at the surface"
        ),
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape(
            ParameterSpec("static_rate_per_mm", "b", "1/mm", 1e-4, 10.0, "relative stiffening by depth"),
            (0.02, 0.1, 0.4),
        ),
    )

    def basis(self, depth_mm: FloatArray, b: Any) -> FloatArray:
        """The exponential less one, of slope 1 at the surface."""
        return np.asarray(np.expm1(np.minimum(b * depth_mm, LARGEST)) / b)[None]

    def slope(self, depth_mm: FloatArray, b: Any) -> FloatArray:
        """The exponential."""
        return np.asarray(np.exp(np.minimum(b * depth_mm, LARGEST)))[None]


LAW = Exponential
