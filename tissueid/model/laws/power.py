"""A free power of depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape

#: Depth at which the slope of a power below one is taken instead of at the surface.
LEAST_MM = 1e-9


@dataclass(frozen=True, slots=True)
class Power:
    """F_s = c x^n."""

    about: ClassVar[About] = About(
        key="power",
        kind="static",
        equation="F_s = c x^n",
        source="10.1016/0020-7225(65)90019-4",
        purpose="tips of a shape that is not known: n is 1 of a flat punch, 1.5 of a sphere, 2 of a cone",
        refuses="powers below 0.5 and above 4",
    )
    polynomial: ClassVar[bool] = False
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("static_N_per_mm_n", "c", "N/mm^n", 0.0, np.inf, "static force at a depth of 1 mm"),
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape(ParameterSpec("static_exponent", "n", "1", 0.5, 4.0, "power of depth"), (1.0, 1.5, 2.2)),
    )

    def basis(self, depth_mm: FloatArray, n: Any) -> FloatArray:
        """The power of depth."""
        return np.asarray(depth_mm**n)[None]

    def slope(self, depth_mm: FloatArray, n: Any) -> FloatArray:
        """Its derivative; none in air."""
        inside = n * np.maximum(depth_mm, LEAST_MM) ** (n - 1.0)
        return np.asarray(np.where(depth_mm > 0.0, inside, 0.0))[None]


LAW = Power
