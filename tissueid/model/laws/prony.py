"""Prony series: exponentials with a stiffness each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape


@dataclass(frozen=True, slots=True)
class Prony:
    """exp(-t / tau), one to three of them."""

    branches: int = 1
    about: ClassVar[About] = About(
        key="prony",
        kind="relaxation",
        equation="R_j = exp(-t / tau_j)",
        source="10.1109/ROBOT.2009.5152617",
        purpose="one to three relaxation times, each with its stiffness",
        refuses="more than 3 branches",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape(ParameterSpec("relaxation_time_s", "tau", "s", 0.0, np.inf, "relaxation time")),
    )

    def __post_init__(self) -> None:
        if self.branches not in {1, 2, 3}:
            msg = f"{self.branches} branches are not offered, 1 to 3 are"
            raise ValueError(msg)

    def value(self, time_s: FloatArray, tau_s: Any) -> FloatArray:
        """One exponential."""
        return np.asarray(np.exp(-time_s / tau_s))


LAW = Prony
