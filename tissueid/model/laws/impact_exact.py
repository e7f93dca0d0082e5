"""Damping of an impact such that a free mass returns with e times its speed."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from tissueid.model.law import About
from tissueid.model.laws.impact import Impact
from tissueid.model.restitution import Variant


class ImpactExact(Impact):
    """F = F_s (1 + chi r) whose chi gives the restitution e exactly."""

    about: ClassVar[About] = replace(
        Impact.about,
        key="impact-exact",
        equation="F = F_s(x) (1 + chi r) >= 0, r = x'/v0, ln(1 - e chi) + e chi = ln(1 + chi) - chi",
        purpose="impact whose e is the share of its speed that a free mass returns with",
    )
    variant: ClassVar[Variant] = "exact"


LAW = ImpactExact
