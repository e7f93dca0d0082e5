"""Quasi-linear viscoelasticity: the static law inside the convolution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from tissueid.model.law import About


@dataclass(frozen=True, slots=True)
class Tangent:
    """The relaxing force is g times the convolution of the relaxation with the static law's rate."""

    about: ClassVar[About] = About(
        key="tangent",
        kind="stiffness",
        equation="F_d = g int R(t - s) dF_s(x(s))",
        source="10.1007/978-1-4757-2257-4",
        purpose="quasi-linear viscoelasticity (Fung): stiffness in proportion to the static law's tangent",
        refuses="nothing of its own",
    )
    powers: ClassVar[int] = 0


LAW = Tangent
