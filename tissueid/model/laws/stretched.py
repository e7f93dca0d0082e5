"""Stretched exponential of Kohlrausch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape


@dataclass(frozen=True, slots=True)
class Stretched:
    """exp(-(t / tau)^beta)."""

    branches: ClassVar[int] = 0
    about: ClassVar[About] = About(
        key="stretched",
        kind="relaxation",
        equation="R = exp(-(t / tau)^beta)",
        source="10.1039/TF9706600080",
        purpose="one process with a broad spread of times",
        refuses="beta above 1",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape(ParameterSpec("relaxation_time_s", "tau", "s", 0.0, np.inf, "time of the decay to 1/e")),
        Shape(ParameterSpec("relaxation_exponent", "beta", "1", 0.15, 1.0, "stretching"), (0.4, 0.7)),
    )

    def value(self, time_s: FloatArray, tau_s: Any, beta: Any) -> FloatArray:
        """The stretched exponential."""
        return np.asarray(np.exp(-((time_s / tau_s) ** beta)))


LAW = Stretched
