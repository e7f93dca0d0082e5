"""Damping of an impact in proportion to the static force, after Flores."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape
from tissueid.model.restitution import LEAST_RESTITUTION, Variant, damping_factors


@dataclass(frozen=True, slots=True)
class Impact:
    """F = F_s (1 + chi r), r the speed over that at contact."""

    about: ClassVar[About] = About(
        key="impact",
        kind="damping",
        equation="F = F_s(x) (1 + chi r) >= 0, r = x'/v0 within +-1, chi = 8 (1 - e) / (5 e)",
        source="10.1007/s11044-010-9237-4",
        purpose="hard bodies: the damping follows a restitution e and the speed v0 at which contact began",
        refuses="e below 0.05, a stiffness law; records without samples slower than v0 / 2 leave e open",
    )
    shape: ClassVar[Shape] = Shape(
        ParameterSpec("damping_restitution", "e", "1", LEAST_RESTITUTION, 1.0, "coefficient of restitution"),
        (0.3, 0.6, 0.9),
    )
    variant: ClassVar[Variant] = "flores"
    branches: ClassVar[int] = 0
    shapes: ClassVar[tuple[Shape, ...]] = ()

    def factor(self, restitution: Any) -> FloatArray:
        """The damping factor chi."""
        return damping_factors(restitution, self.variant)


class ImpactExact(Impact):
    """F = F_s (1 + chi r) whose chi returns a free mass with e times its speed."""

    about: ClassVar[About] = replace(
        Impact.about,
        key="impact-exact",
        equation="F = F_s(x) (1 + chi r) >= 0, r = x'/v0, ln(1 - e chi) + e chi = ln(1 + chi) - chi",
        purpose="impact whose e is the share of its speed that a free mass returns with",
    )
    variant: ClassVar[Variant] = "exact"


LAWS = (Impact, ImpactExact)
