"""A discrete spectrum: many fixed times, a stiffness each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.law import About, Shape


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Exponentials at fixed times, evenly spaced in ln tau over what the recordings show."""

    nodes: int = 8
    about: ClassVar[About] = About(
        key="spectrum",
        kind="relaxation",
        equation="R_j = exp(-t / tau_j), tau_j fixed from the sampling interval to the longest log",
        source="10.1007/BF01332922",
        purpose="shape of the relaxation without a law of it",
        refuses="a relaxation time: none is a parameter",
    )
    shapes: ClassVar[tuple[Shape, ...]] = ()
    branches: ClassVar[int] = 0

    def __post_init__(self) -> None:
        if not 2 <= self.nodes <= 12:
            msg = f"a spectrum of {self.nodes} times is not offered, 2 to 12 are"
            raise ValueError(msg)

    def value(self, time_s: FloatArray, tau_s: Any) -> FloatArray:
        """One exponential."""
        return np.asarray(np.exp(-time_s / tau_s))


LAW = Spectrum
