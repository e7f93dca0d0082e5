"""Elastic contact of a cone: a known power of depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, KnownPower


@dataclass(frozen=True, slots=True)
class Sneddon(KnownPower):
    """F_s = c x^2."""

    about: ClassVar[About] = About(
        key="sneddon",
        kind="static",
        equation="F_s = c x^2",
        source="10.1016/0020-7225(65)90019-4",
        purpose="a cone in a thick specimen; with its angle in the study, Young's modulus",
        refuses="strains beyond 0.1",
    )
    power: ClassVar[float] = 2.0
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("static_N_per_mm2", "c", "N/mm^2", 0.0, np.inf, "static force at a depth of 1 mm"),
    )


LAW = Sneddon
