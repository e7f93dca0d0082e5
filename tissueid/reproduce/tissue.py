"""The tissue of paper A as far as its text tells: a branch from Table 2, static curves through Table 1.

Force at constant speed is equation (7), reconstructed; the static cubic is equation (8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.channels import ChannelModel, loading_force
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.reproduce.published import Ledger
from tissueid.reproduce.readings import Readings
from tissueid.synth.recipe import Branch

#: Depths of the relaxation tests and speeds of the indentations, section II.A of the paper.
DEPTHS_MM = (2, 4, 6, 8)
HOLD_SPEED_MM_MIN = 250.0
SPEEDS_MM_MIN = (10.0, 70.0, 100.0, 150.0, 250.0, 500.0)
#: A model claims depths up to here [mm]; the deepest test.
DEPTH_MM = 8.0


@dataclass(frozen=True, slots=True)
class Tissue:
    """A modified Kelvin-Voigt tissue with one branch."""

    static: tuple[float, ...]  # a1, a2, a3 [N/mm, N/mm2, N/mm3]
    branch: Branch

    @property
    def model(self) -> ChannelModel:
        """Its law."""
        return kelvin_voigt(branches=1, stiffness_degree=len(self.branch.stiffness) - 1, depth_mm=DEPTH_MM)

    @property
    def theta(self) -> FloatArray:
        """Its vector."""
        return np.array([*self.static, *self.branch.stiffness, self.branch.tau_s])

    def force(self, depth_mm: FloatArray, speed_mm_min: float) -> FloatArray:
        """Force at depths reached at constant speed from rest [N]."""
        return loading_force(self.model, self.theta, depth_mm, speed_mm_s=speed_mm_min / 60.0)


def read_branch(ledger: Ledger, readings: Readings, tau_key: str = "table-2/tau") -> Branch:
    """The branch of Table 2, with the relaxation time of a row of choice.

    ``tau_key``: the printed relaxation time that is taken.
    """
    ledger.read(readings.words("stiffness"))
    ledger.read(readings.words("relaxation"))
    value = ledger.printed("table-2/stiffness")
    tau = ledger.printed(tau_key)
    stiffness = (value,) if readings.stiffness == "constant" else (0.0, value)
    return Branch(stiffness, tau if readings.relaxation == "time" else 1.0 / tau)


def branch_force(branch: Branch, depth_mm: float, speed_mm_min: float) -> float:
    """Force of the branch alone at the end of a ramp [N]."""
    alone = Tissue((0.0, 0.0, 0.0), branch)
    return float(alone.force(np.array([depth_mm]), speed_mm_min)[0])


def cubic_through_peaks(ledger: Ledger, branch: Branch) -> tuple[float, ...]:
    """Least-squares cubic without a constant through the peaks of Table 1, less what the branch carries [N].

    The four peaks lie on no cubic through the origin (up to 8 N off): they come from different specimens or
    places, and the curve is one for illustration.
    """
    depth = np.array(DEPTHS_MM, dtype=float)
    peaks = np.array([ledger.printed(f"table-1/peak-{d}mm") for d in DEPTHS_MM])
    rest = peaks - np.array([branch_force(branch, d, HOLD_SPEED_MM_MIN) for d in depth])
    columns = depth[:, None] ** np.arange(1.0, 4.0)
    return tuple(float(a) for a in np.linalg.lstsq(columns, rest, rcond=None)[0])
