"""Relaxation by a power of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape


@dataclass(frozen=True, slots=True)
class PowerLaw:
    """(1 + t / tau)^-alpha."""

    branches: ClassVar[int] = 0
    about: ClassVar[About] = About(
        key="power-law",
        kind="relaxation",
        equation="R = (1 + t / tau)^-alpha",
        source="10.1103/PhysRevLett.87.148102",
        purpose="tissue that relaxes over decades without a time of its own",
        refuses="holds without any decade of relaxation: tau and alpha are then one number",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape(ParameterSpec("relaxation_time_s", "tau", "s", 0.0, np.inf, "time at which the power sets in")),
        Shape(
            ParameterSpec("relaxation_exponent", "alpha", "1", 0.01, 3.0, "power of time"), (0.1, 0.4, 1.0)
        ),
    )

    def value(self, time_s: FloatArray, tau_s: Any, alpha: Any) -> FloatArray:
        """The power."""
        return np.asarray(np.exp(-alpha * np.log1p(time_s / tau_s)))


LAW = PowerLaw
