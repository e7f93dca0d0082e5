"""Elastic contact of a sphere: a known power of depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape

POWER = 1.5


@dataclass(frozen=True, slots=True)
class Hertz:
    """F_s = c x^1.5."""

    about: ClassVar[About] = About(
        key="hertz",
        kind="static",
        equation="F_s = c x^1.5",
        source="10.1515/crll.1882.92.156",
        purpose="a sphere that touches a thick specimen; with its radius in the study, Young's modulus",
        refuses="contact radii beyond 0.4 of the tip's radius",
    )
    polynomial: ClassVar[bool] = False
    shapes: ClassVar[tuple[Shape, ...]] = ()
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("static_N_per_mm1_5", "c", "N/mm^1.5", 0.0, np.inf, "static force at a depth of 1 mm"),
    )

    def basis(self, depth_mm: FloatArray) -> FloatArray:
        """The power of depth."""
        return np.asarray(depth_mm**POWER)[None]

    def slope(self, depth_mm: FloatArray) -> FloatArray:
        """Its derivative."""
        return np.asarray(POWER * depth_mm ** (POWER - 1.0))[None]


LAW = Hertz
