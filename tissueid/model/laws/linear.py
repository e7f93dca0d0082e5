"""Dynamic stiffness outside the convolution, of degree 1 in depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from tissueid.model.law import About


@dataclass(frozen=True, slots=True)
class Linear:
    """K = b0 + b1 x, times the state of the relaxation."""

    about: ClassVar[About] = About(
        key="linear",
        kind="stiffness",
        equation="F_d = K(x) s, K = b0 + b1 x",
        source="10.1109/ROBOT.2009.5152617",
        purpose="tissue whose dynamic stiffness grows or falls with depth",
        refuses="K below 0 anywhere up to the largest depth",
    )
    powers: ClassVar[int] = 2


LAW = Linear
