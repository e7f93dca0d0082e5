"""Fung's box spectrum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape

#: Gauss-Legendre points over the logarithm of the box.
POINTS = 48


@dataclass(frozen=True, slots=True)
class Fung:
    """Equal weight of all times between two ends, by the logarithm."""

    branches: ClassVar[int] = 0
    about: ClassVar[About] = About(
        key="fung",
        kind="relaxation",
        equation="R = [E1(t / tau_2) - E1(t / tau_1)] / ln(tau_2 / tau_1)",
        source="10.1007/978-1-4757-2257-4",
        purpose="quasi-linear viscoelasticity: loss that hardly depends on frequency",
        refuses="ends that the hold doesn't show are not identified",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape(ParameterSpec("relaxation_time_s", "tau_1", "s", 0.0, np.inf, "shortest time of the box")),
        Shape(
            ParameterSpec("relaxation_span", "tau_2/tau_1", "1", 1.05, 1e8, "longest over shortest time"),
            (10.0, 1e3),
        ),
    )

    def value(self, time_s: FloatArray, tau_s: Any, span: Any) -> FloatArray:
        """Mean of exp(-t / tau) over ln tau."""
        time, tau, span = np.broadcast_arrays(np.asarray(time_s, dtype=np.float64), tau_s, span)
        at, weight = np.polynomial.legendre.leggauss(POINTS)
        times = tau[..., None] * np.exp(0.5 * (at + 1.0) * np.log(span)[..., None])
        return np.asarray((0.5 * weight * np.exp(-time[..., None] / times)).sum(axis=-1))


LAW = Fung
