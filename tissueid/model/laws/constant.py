"""Dynamic stiffness outside the convolution, of degree 0 in depth."""

from __future__ import annotations

from dataclasses import dataclass
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


LAW = Constant
