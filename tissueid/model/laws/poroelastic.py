"""Drainage of fluid from under a sphere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape


@dataclass(frozen=True, slots=True)
class Poroelastic:
    """Hu, Zhao, Vlassak & Suo's function of D t / a^2 = t / tau for a sphere."""

    branches: ClassVar[int] = 0
    about: ClassVar[About] = About(
        key="poroelastic",
        kind="relaxation",
        equation="R = 0.491 exp(-0.908 (t / tau)^0.5) + 0.509 exp(-1.679 t / tau), tau = a^2 / D",
        source="10.1063/1.3370354",
        purpose="soaked tissue held at one depth: fluid drains from a contact of radius a with diffusivity D",
        refuses="several depths at once: tau grows with the square of the contact radius",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape(ParameterSpec("relaxation_time_s", "tau", "s", 0.0, np.inf, "time of drainage, a^2 / D")),
    )

    def value(self, time_s: FloatArray, tau_s: Any) -> FloatArray:
        """The function of drainage."""
        share = time_s / tau_s
        return np.asarray(0.491 * np.exp(-0.908 * np.sqrt(share)) + 0.509 * np.exp(-1.679 * share))


LAW = Poroelastic
