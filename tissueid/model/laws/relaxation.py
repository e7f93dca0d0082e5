"""Relaxation after a step, from 1 down."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape
from tissueid.model.moduli import drained_share

_about = partial(About, kind="relaxation")
#: Logarithms of rates times tau to the power alpha that a fractional spectrum sums, and their number.
REACH, RATES = 16.0, 401
#: Gauss-Legendre points over the logarithm of Fung's box.
POINTS = 48


def _time(meaning: str, symbol: str = "tau") -> Shape:
    """The relaxation time, first shape of a law that has one."""
    return Shape(ParameterSpec("relaxation_time_s", symbol, "s", 0.0, np.inf, meaning))


@dataclass(frozen=True, slots=True)
class Fractional:
    """Mittag-Leffler function E_alpha(-(t / tau)^alpha), by its spectrum of rates."""

    branches: ClassVar[int] = 0
    about: ClassVar[About] = _about(
        key="fractional",
        equation="R = E_alpha(-(t / tau)^alpha)",
        source="10.1142/p614",
        purpose="a springpot (fractional Zener): two parameters for decades of relaxation",
        refuses="orders beyond 0.1 to 0.95",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        _time("time of the springpot"),
        Shape(
            ParameterSpec("relaxation_exponent", "alpha", "1", 0.1, 0.95, "order of the derivative"),
            (0.3, 0.6, 0.9),
        ),
    )

    def value(self, time_s: FloatArray, tau_s: Any, alpha: Any) -> FloatArray:
        """Sum over rates r of sin(alpha pi) / (pi (r^alpha + r^-alpha + 2 cos(alpha pi))) exp(-r t / tau)."""
        time, tau, alpha = np.broadcast_arrays(np.asarray(time_s, dtype=np.float64), tau_s, alpha)
        y = np.linspace(-REACH, REACH, RATES)
        step = y[1] - y[0]
        angle = np.pi * alpha[..., None]
        spectrum = np.sin(angle) / (2.0 * np.pi * alpha[..., None] * (np.cosh(y) + np.cos(angle)))
        rate = np.exp(np.minimum(y / alpha[..., None], 600.0))
        return np.asarray(step * (spectrum * np.exp(-rate * (time / tau)[..., None])).sum(axis=-1))


@dataclass(frozen=True, slots=True)
class Fung:
    """Equal weight of all times between two ends, by the logarithm: Fung's box spectrum."""

    branches: ClassVar[int] = 0
    about: ClassVar[About] = _about(
        key="fung",
        equation="R = [E1(t / tau_2) - E1(t / tau_1)] / ln(tau_2 / tau_1)",
        source="10.1007/978-1-4757-2257-4",
        purpose="quasi-linear viscoelasticity: loss that hardly depends on frequency",
        refuses="ends that the hold doesn't show are not identified",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        _time("shortest time of the box", "tau_1"),
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


@dataclass(frozen=True, slots=True)
class Poroelastic:
    """Hu, Zhao, Vlassak & Suo's function of D t / a^2 = t / tau: fluid drains from under a sphere."""

    branches: ClassVar[int] = 0
    about: ClassVar[About] = _about(
        key="poroelastic",
        equation="R = 0.491 exp(-0.908 (t / tau)^0.5) + 0.509 exp(-1.679 t / tau), tau = a^2 / D",
        source="10.1063/1.3370354",
        purpose="soaked tissue held at one depth: fluid drains from a contact of radius a with diffusivity D",
        refuses="several depths at once: tau grows with the square of the contact radius",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (_time("time of drainage, a^2 / D"),)

    def value(self, time_s: FloatArray, tau_s: Any) -> FloatArray:
        """The function of drainage."""
        return drained_share(time_s / tau_s)


@dataclass(frozen=True, slots=True)
class PowerLaw:
    """(1 + t / tau)^-alpha."""

    branches: ClassVar[int] = 0
    about: ClassVar[About] = _about(
        key="power-law",
        equation="R = (1 + t / tau)^-alpha",
        source="10.1103/PhysRevLett.87.148102",
        purpose="tissue that relaxes over decades without a time of its own",
        refuses="holds without any decade of relaxation: tau and alpha are then one number",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        _time("time at which the power sets in"),
        Shape(
            ParameterSpec("relaxation_exponent", "alpha", "1", 0.01, 3.0, "power of time"), (0.1, 0.4, 1.0)
        ),
    )

    def value(self, time_s: FloatArray, tau_s: Any, alpha: Any) -> FloatArray:
        """The power."""
        return np.asarray(np.exp(-alpha * np.log1p(time_s / tau_s)))


@dataclass(frozen=True, slots=True)
class Prony:
    """exp(-t / tau), one to three of them, each with a stiffness of its own."""

    branches: int = 1
    about: ClassVar[About] = _about(
        key="prony",
        equation="R_j = exp(-t / tau_j)",
        source="10.1109/ROBOT.2009.5152617",
        purpose="one to three relaxation times, each with its stiffness",
        refuses="more than 3 branches",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (_time("relaxation time"),)

    def __post_init__(self) -> None:
        if self.branches not in {1, 2, 3}:
            raise ValueError(f"{self.branches} branches are not offered, 1 to 3 are")

    def value(self, time_s: FloatArray, tau_s: Any) -> FloatArray:
        """One exponential."""
        return np.asarray(np.exp(-time_s / tau_s))


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Exponentials at fixed times, evenly spaced in ln tau over what the recordings show."""

    nodes: int = 8
    about: ClassVar[About] = _about(
        key="spectrum",
        equation="R_j = exp(-t / tau_j), tau_j fixed from the sampling interval to the longest log",
        source="10.1007/BF01332922",
        purpose="shape of the relaxation without a law of it",
        refuses="a relaxation time: none is a parameter",
    )
    shapes: ClassVar[tuple[Shape, ...]] = ()
    branches: ClassVar[int] = 0

    def __post_init__(self) -> None:
        if not 2 <= self.nodes <= 12:
            raise ValueError(f"a spectrum of {self.nodes} times is not offered, 2 to 12 are")

    def value(self, time_s: FloatArray, tau_s: Any) -> FloatArray:
        """One exponential."""
        return np.asarray(np.exp(-time_s / tau_s))


@dataclass(frozen=True, slots=True)
class Stretched:
    """exp(-(t / tau)^beta) of Kohlrausch."""

    branches: ClassVar[int] = 0
    about: ClassVar[About] = _about(
        key="stretched",
        equation="R = exp(-(t / tau)^beta)",
        source="10.1039/TF9706600080",
        purpose="one process with a broad spread of times",
        refuses="beta above 1",
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        _time("time of the decay to 1/e"),
        Shape(ParameterSpec("relaxation_exponent", "beta", "1", 0.15, 1.0, "stretching"), (0.4, 0.7)),
    )

    def value(self, time_s: FloatArray, tau_s: Any, beta: Any) -> FloatArray:
        """The stretched exponential."""
        return np.asarray(np.exp(-((time_s / tau_s) ** beta)))


LAWS = (Fractional, Fung, Poroelastic, PowerLaw, Prony, Spectrum, Stretched)
