"""Dynamic stiffness outside the convolution, of degree 2 in depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from tissueid.model.law import About


@dataclass(frozen=True, slots=True)
class Quadratic:
    """K = b0 + b1 x + b2 x^2, times the state of the relaxation."""

    about: ClassVar[About] = About(
        key="quadratic",
        kind="stiffness",
        equation="F_d = K(x) s, K = b0 + b1 x + b2 x^2",
        source="10.1109/ROBOT.2009.5152617",
        purpose="dynamic stiffness that bends; several speeds and depths are needed",
        refuses="K below 0 anywhere up to the largest depth",
    )
    powers: ClassVar[int] = 3


LAW = Quadratic
