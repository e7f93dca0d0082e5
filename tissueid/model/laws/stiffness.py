"""Stiffness that a relaxation acts on: by depth outside the convolution, or the static law inside it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from tissueid.model.law import About


@dataclass(frozen=True, slots=True)
class Constant:
    """K = b0, times the state of the relaxation."""

    about: ClassVar[About] = About(
        key="constant",
        kind="stiffness",
        equation="F_d = K(x) s, K = b0",
        source="10.1109/ROBOT.2009.5152617",
        purpose="tissue whose dynamic stiffness is the same at all depths",
        refuses="K below 0 anywhere up to the largest depth",
    )
    powers: ClassVar[int] = 1


@dataclass(frozen=True, slots=True)
class Linear:
    """K = b0 + b1 x, times the state of the relaxation."""

    about: ClassVar[About] = replace(
        Constant.about,
        key="linear",
        equation="F_d = K(x) s, K = b0 + b1 x",
        purpose="tissue whose dynamic stiffness grows or falls with depth",
    )
    powers: ClassVar[int] = 2


@dataclass(frozen=True, slots=True)
class Quadratic:
    """K = b0 + b1 x + b2 x^2, times the state of the relaxation."""

    about: ClassVar[About] = replace(
        Constant.about,
        key="quadratic",
        equation="F_d = K(x) s, K = b0 + b1 x + b2 x^2",
        purpose="dynamic stiffness that bends; several speeds and depths are needed",
    )
    powers: ClassVar[int] = 3


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


LAWS = (Constant, Linear, Quadratic, Tangent)
