"""Elastic contact of a sphere: a known power of depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, KnownPower


@dataclass(frozen=True, slots=True)
class Hertz(KnownPower):
    """F_s = c x^1.5."""

    about: ClassVar[About] = About(
        key="hertz",
        kind="static",
        equation="F_s = c x^1.5",
        source="10.1515/crll.1882.92.156",
        purpose="a sphere that touches a thick specimen; with its radius in the study, Young's modulus",
        refuses="contact radii beyond 0.4 of the tip's radius",
    )
    power: ClassVar[float] = 1.5
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("static_N_per_mm1_5", "c", "N/mm^1.5", 0.0, np.inf, "static force at a depth of 1 mm"),
    )


LAW = Hertz
