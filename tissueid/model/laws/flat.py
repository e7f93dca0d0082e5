"""Elastic contact of a flat punch: a known power of depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, KnownPower


@dataclass(frozen=True, slots=True)
class Flat(KnownPower):
    """F_s = c x."""

    about: ClassVar[About] = About(
        key="flat",
        kind="static",
        equation="F_s = c x",
        source="10.1016/0020-7225(65)90019-4",
        purpose="a flat punch on a thick specimen; with its radius in the study, Young's modulus",
        refuses="depths beyond half of the punch's radius",
    )
    power: ClassVar[float] = 1.0
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("static_N_per_mm", "c", "N/mm", 0.0, np.inf, "static force at a depth of 1 mm"),
    )


LAW = Flat
