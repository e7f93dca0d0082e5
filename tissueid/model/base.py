"""Contact models in common: parameters by name, and paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray

#: Branches that a servo steps at the most.
MOST_BRANCHES = 12


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """One parameter of a model."""

    name: str  # as in identification.json
    symbol: str  # as in an equation
    unit: str  # as printed
    lower: float  # bounds; the passivity constraint may bind several parameters more tightly
    upper: float
    meaning: str  # one sentence


@dataclass(frozen=True, slots=True)
class ContactPath:
    """Path of a tool: the input of a contact model."""

    time_s: FloatArray  # (n,), non-decreasing
    depth_mm: FloatArray  # (n,), below the contact point; linear in between
    #: (n,): speed over that at which each contact began, for laws that follow it; else told from the path.
    speed_ratio: FloatArray | None = None


def scaled_theta(
    parameters: Sequence[ParameterSpec], theta: FloatArray, force: FloatArray, travel: FloatArray
) -> FloatArray:
    """Theta (n, p) of a tissue whose force and travel were read too large by gains (n,), by units."""
    out, names = theta.copy(), [spec.name for spec in parameters]
    for k, spec in enumerate(parameters):
        top, per, power = spec.unit.partition("/mm")
        if power == "^n":
            out[:, k] *= travel ** theta[:, names.index("static_exponent")]
        elif per:
            out[:, k] *= travel ** float(power[1:] or 1.0)
        out[:, k] /= {"N": force, "mm": travel}.get(top, 1.0)
    return out


def branch_suffix(branch: int) -> str:
    """Ending of the parameter names of a branch: none for the first, then ``_b2``, ``_b3``."""
    return "" if branch == 0 else f"_b{branch + 1}"


def stiffness_spec(power: int, branch: int) -> ParameterSpec:
    """Coefficient of a power of depth in the dynamic stiffness of a branch."""
    return ParameterSpec(
        name=f"stiffness_{power}_N_per_mm{power + 1 if power else ''}{branch_suffix(branch)}",
        symbol=f"b{power}" if branch == 0 else f"b{power},{branch + 1}",
        unit=f"N/mm^{power + 1}" if power else "N/mm",
        lower=-np.inf,
        upper=np.inf,
        meaning=f"coefficient of x^{power} in the dynamic stiffness K of branch {branch + 1}",
    )
