"""Fractional Zener element: a springpot beside springs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape

#: Logarithms of rates times tau to the power alpha over which the spectrum is summed, and their number.
REACH, POINTS = 16.0, 401


@dataclass(frozen=True, slots=True)
class Fractional:
    """Mittag-Leffler function E_alpha(-(t / tau)^alpha), by its spectrum of rates."""

    branches: ClassVar[int] = 0
    about: ClassVar[About] = About(
        key="fractional",
        kind="relaxation",
        equation="R = E_alpha(-(t / tau)^alpha)",
        source="10.1142/p614",
        purpose="a springpot (fractional Zener): two parameters for decades of relaxation",
        refuses="orders beyond 0.1 to 0.95",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape(ParameterSpec("relaxation_time_s", "tau", "s", 0.0, np.inf, "time of the springpot")),
        Shape(
            ParameterSpec("relaxation_exponent", "alpha", "1", 0.1, 0.95, "order of the derivative"),
            (0.3, 0.6, 0.9),
        ),
    )

    def value(self, time_s: FloatArray, tau_s: Any, alpha: Any) -> FloatArray:
        """Sum over rates r of sin(alpha pi) / (pi (r^alpha + r^-alpha + 2 cos(alpha pi))) exp(-r t / tau)."""
        time, tau, alpha = np.broadcast_arrays(np.asarray(time_s, dtype=np.float64), tau_s, alpha)
        y = np.linspace(-REACH, REACH, POINTS)
        step = y[1] - y[0]
        angle = np.pi * alpha[..., None]
        spectrum = np.sin(angle) / (2.0 * np.pi * alpha[..., None] * (np.cosh(y) + np.cos(angle)))
        rate = np.exp(np.minimum(y / alpha[..., None], 600.0))
        return np.asarray(step * (spectrum * np.exp(-rate * (time / tau)[..., None])).sum(axis=-1))


LAW = Fractional
