"""Parts of a contact model, a file each kind in ``laws``: linear coefficients, and positive shapes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.restitution import Variant


@dataclass(frozen=True, slots=True)
class About:
    """Description of a part, as ``tissueid models`` prints it."""

    key: str  # word of the grammar
    kind: str  # ``static``, ``stiffness``, ``relaxation`` or ``damping``
    equation: str
    source: str  # DOI, or "reconstructed" with its derivation
    purpose: str
    refuses: str


@dataclass(frozen=True, slots=True)
class Shape:
    """A positive parameter that the force is not linear in."""

    spec: ParameterSpec  # with the bounds of the search; of a time they follow the recordings
    starts: tuple[float, ...] = ()  # of a search; none for a time


class Described(Protocol):
    """A part of a contact model."""

    @property
    def about(self) -> About:
        """Its description."""


class StaticLaw(Described, Protocol):
    """Force once everything has relaxed, by depth."""

    @property
    def coefficients(self) -> tuple[ParameterSpec, ...]:
        """Linear parameters."""

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Parameters that the force is not linear in."""

    @property
    def polynomial(self) -> bool:
        """True where coefficients are those of x, x^2, ... and only their sum has to be positive."""

    def basis(self, depth_mm: FloatArray, *shape: Any) -> FloatArray:
        """Columns of the coefficients at depths of 0 and more, (...) -> (p, ...)."""

    def slope(self, depth_mm: FloatArray, *shape: Any) -> FloatArray:
        """Their derivatives by depth, (...) -> (p, ...)."""


class StiffnessLaw(Described, Protocol):
    """Stiffness that a relaxation acts on: by depth outside the convolution, or the static law inside it."""

    @property
    def powers(self) -> int:
        """Powers of depth in K(x); 0 where the static law itself is convolved."""


class DynamicLaw(Described, Protocol):
    """Force beyond the static one."""

    @property
    def branches(self) -> int:
        """Exponentials with a stiffness of their own; 0 of other relaxations, and of a damping."""

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Parameters of one branch, or of the relaxation; none of a damping."""


class RelaxationLaw(DynamicLaw, Protocol):
    """Relaxation after a step, from 1 down."""

    def value(self, time_s: FloatArray, *shape: Any) -> FloatArray:
        """Relaxation at times [s], (...) -> (...)."""


class DampingLaw(DynamicLaw, Protocol):
    """Damping in proportion to the static force, by the speed over that at which contact began."""

    @property
    def shape(self) -> Shape:
        """Its one parameter."""

    @property
    def variant(self) -> Variant:
        """Equation between chi and its parameter."""

    def factor(self, value: Any) -> FloatArray:
        """Damping factor chi, (...) -> (...)."""
