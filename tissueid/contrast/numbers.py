"""Comparable numbers of tissues whose models may differ: forces on the same paths, and what both have.

Parameters of different models mean different things.  Forces at the depths and speeds that all tissues were
identified at do not; they carry the comparison, and parameters stand beside them where the models agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import UsageError
from tissueid.model.channels import TissueModel, viscous
from tissueid.model.functionals import force_after_ramp

#: Shares of the common depth at which forces are compared.
DEPTH_SHARES = (0.25, 0.5, 1.0)
#: Draws that are evaluated; more say nothing more about a 2 % level.
MOST_DRAWS = 2000
#: Fewer draws than these have no covariance worth the name.
LEAST_DRAWS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """One tissue of a comparison."""

    name: str
    model: TissueModel
    draws: FloatArray  # (n, p), of its posterior
    speeds_mm_s: tuple[float, float]  # slowest and fastest identified speed
    total: bool  # whether the draws know the machine's calibration

    def __post_init__(self) -> None:
        if len(self.draws) < LEAST_DRAWS:
            msg = (
                f"{self.name}: {len(self.draws)} draws are too few to compare; fit it with a sampler "
                "(`tissueid fit` does by default)"
            )
            raise UsageError(msg)


@dataclass(frozen=True, slots=True)
class Common:
    """Depths and speeds at which all tissues of a comparison were identified."""

    depth_mm: float
    speeds_mm_s: tuple[float, float]  # slowest and fastest; equal where only one speed is common


def common_range(tissues: Sequence[Compared]) -> Common:
    """Depths and speeds at which every tissue was identified.

    Raises UsageError: there is no common speed: what speed does and what the tissue does can't be told apart.
    """
    slow = max(tissue.speeds_mm_s[0] for tissue in tissues)
    fast = min(tissue.speeds_mm_s[1] for tissue in tissues)
    if slow > fast * (1.0 + 1e-9):
        told = "; ".join(
            f"{tissue.name} at {tissue.speeds_mm_s[0]:.3g} to {tissue.speeds_mm_s[1]:.3g} mm/s"
            for tissue in tissues
        )
        msg = f"no speed is common to them ({told}): what the speed does and the tissue can't be told apart"
        raise UsageError(msg)
    return Common(min(tissue.model.depth_mm for tissue in tissues), (slow, max(slow, fast)))


def draws_of_numbers(tissue: Compared, common: Common) -> dict[str, FloatArray]:
    """Draws of every number that is compared, by its name with unit.

    Returns (n,), forces first, all positive [N]; then stiffnesses at half depth, viscosity and relaxation
    times.
    """
    keep = np.linspace(0, len(tissue.draws) - 1, min(len(tissue.draws), MOST_DRAWS)).astype(int)
    draws = tissue.draws[keep]
    found: dict[str, FloatArray] = {}
    for share in DEPTH_SHARES:
        depth = share * common.depth_mm
        for speed in dict.fromkeys(common.speeds_mm_s):
            found[f"force at {depth:.3g} mm, {speed:.3g} mm/s [N]"] = np.array(
                [force_after_ramp(tissue.model, theta, depth, speed, 0.0) for theta in draws]
            )
    half = np.array([0.5 * common.depth_mm])
    found[f"static stiffness to {half[0]:.3g} mm [N/mm]"] = np.array(
        [float(tissue.model.static_force(theta, half)[0]) / half[0] for theta in draws]
    )
    if tissue.model.branches:
        tau = np.array([tissue.model.times(theta) for theta in draws])
        if viscous(tissue.model):
            stiffness = np.array([tissue.model.stiffness(theta, half)[:, 0] for theta in draws])
            found[f"viscosity at {half[0]:.3g} mm [N s/mm]"] = (stiffness * tau).sum(axis=1)
        found["relaxation time, longest [s]"] = tau.max(axis=1)
    return found
