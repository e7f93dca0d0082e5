"""Force once everything has relaxed, by depth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape

_about = partial(About, kind="static")
#: Exponent beyond which a law is none.
LARGEST = 200.0
#: Depth [mm] at which the slope of a power below one is taken instead of at the surface.
LEAST_MM = 1e-9


def _at_1_mm(name: str, unit: str) -> tuple[ParameterSpec, ...]:
    """The one coefficient of a power of depth."""
    return (ParameterSpec(name, "c", unit, 0.0, np.inf, "static force at a depth of 1 mm"),)


@dataclass(frozen=True, slots=True)
class Exponential:
    """F_s = (k / b) (exp(b x) - 1)."""

    about: ClassVar[About] = _about(
        key="exponential",
        equation="F_s = (k / b) (exp(b x) - 1)",
        source="10.1152/ajplegacy.1967.213.6.1532",
        purpose="soft tissue that stiffens with strain as Fung's does",
        refuses="tissue that softens with depth",
    )
    polynomial: ClassVar[bool] = False
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec(
            "static_stiffness_N_per_mm", "k", "N/mm", 0.0, np.inf, "static stiffness at the surface"
        ),
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape(
            ParameterSpec("static_rate_per_mm", "b", "1/mm", 1e-4, 10.0, "relative stiffening by depth"),
            (0.02, 0.1, 0.4),
        ),
    )

    def basis(self, depth_mm: FloatArray, b: Any) -> FloatArray:
        """The exponential less one, of slope 1 at the surface."""
        return np.asarray(np.expm1(np.minimum(b * depth_mm, LARGEST)) / b)[None]

    def slope(self, depth_mm: FloatArray, b: Any) -> FloatArray:
        """The exponential."""
        return np.asarray(np.exp(np.minimum(b * depth_mm, LARGEST)))[None]


@dataclass(frozen=True, slots=True)
class KnownPower:
    """Static law of a tip whose shape is known: c times a power of depth."""

    power: ClassVar[float]
    polynomial: ClassVar[bool] = False
    shapes: ClassVar[tuple[Shape, ...]] = ()

    def basis(self, depth_mm: FloatArray) -> FloatArray:
        """The power of depth."""
        return np.asarray(depth_mm**self.power)[None]

    def slope(self, depth_mm: FloatArray) -> FloatArray:
        """Its derivative."""
        return np.asarray(self.power * depth_mm ** (self.power - 1.0))[None]


class Flat(KnownPower):
    """F_s = c x of a flat punch."""

    about: ClassVar[About] = _about(
        key="flat",
        equation="F_s = c x",
        source="10.1016/0020-7225(65)90019-4",
        purpose="a flat punch on a thick specimen; with its radius in the study, Young's modulus",
        refuses="depths beyond half of the punch's radius",
    )
    power: ClassVar[float] = 1.0
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = _at_1_mm("static_N_per_mm", "N/mm")


class Hertz(KnownPower):
    """F_s = c x^1.5 of a sphere."""

    about: ClassVar[About] = _about(
        key="hertz",
        equation="F_s = c x^1.5",
        source="10.1515/crll.1882.92.156",
        purpose="a sphere that touches a thick specimen; with its radius in the study, Young's modulus",
        refuses="contact radii beyond 0.4 of the tip's radius",
    )
    power: ClassVar[float] = 1.5
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = _at_1_mm("static_N_per_mm1_5", "N/mm^1.5")


#: Coefficients of a polynomial of the largest degree.
_COEFFICIENTS = tuple(
    ParameterSpec(
        f"static_{k}_N_per_mm{k if k > 1 else ''}", f"a{k}", f"N/mm^{k}" if k > 1 else "N/mm",
        -np.inf, np.inf, f"coefficient of x^{k} in the static force F_s",
    )
    for k in (1, 2, 3)
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Polynomial:
    """F_s = a1 x + a2 x^2 + ..., of degree 1 to 3."""

    degree: int = 3
    about: ClassVar[About] = _about(
        key="polynomial",
        equation="F_s = a1 x + a2 x^2 + a3 x^3",
        source="10.1109/ROBOT.2009.5152617",
        purpose="structural stiffness of any tool, within the depth it was pushed to",
        refuses="degrees beyond 3; depths beyond the largest of the recordings",
    )
    shapes: ClassVar[tuple[Shape, ...]] = ()
    polynomial: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.degree not in {1, 2, 3}:
            raise ValueError(f"a polynomial of degree {self.degree} is not offered, 1 to 3 are")

    @property
    def coefficients(self) -> tuple[ParameterSpec, ...]:
        """a1, a2, ..."""
        return _COEFFICIENTS[: self.degree]

    def basis(self, depth_mm: FloatArray) -> FloatArray:
        """Powers of depth."""
        return np.stack([depth_mm**k for k in range(1, self.degree + 1)])

    def slope(self, depth_mm: FloatArray) -> FloatArray:
        """Derivatives of the powers."""
        return np.stack([k * depth_mm ** (k - 1) for k in range(1, self.degree + 1)])


@dataclass(frozen=True, slots=True)
class Power:
    """F_s = c x^n."""

    about: ClassVar[About] = _about(
        key="power",
        equation="F_s = c x^n",
        source="10.1016/0020-7225(65)90019-4",
        purpose="tips of a shape that is not known: n is 1 of a flat punch, 1.5 of a sphere, 2 of a cone",
        refuses="powers below 0.5 and above 4",
    )
    polynomial: ClassVar[bool] = False
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = _at_1_mm("static_N_per_mm_n", "N/mm^n")
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape(ParameterSpec("static_exponent", "n", "1", 0.5, 4.0, "power of depth"), (1.0, 1.5, 2.2)),
    )

    def basis(self, depth_mm: FloatArray, n: Any) -> FloatArray:
        """The power of depth."""
        return np.asarray(depth_mm**n)[None]

    def slope(self, depth_mm: FloatArray, n: Any) -> FloatArray:
        """Its derivative; none in air."""
        inside = n * np.maximum(depth_mm, LEAST_MM) ** (n - 1.0)
        return np.asarray(np.where(depth_mm > 0.0, inside, 0.0))[None]


class Sneddon(KnownPower):
    """F_s = c x^2 of a cone."""

    about: ClassVar[About] = replace(
        Flat.about,
        key="sneddon",
        equation="F_s = c x^2",
        purpose="a cone in a thick specimen; with its angle in the study, Young's modulus",
        refuses="strains beyond 0.1",
    )
    power: ClassVar[float] = 2.0
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = _at_1_mm("static_N_per_mm2", "N/mm^2")


LAWS = (Exponential, Flat, Hertz, Polynomial, Power, Sneddon)
