"""All pairs of tissues as one document: numbers and curves they have in common.

Comparable numbers of tissues whose models may differ: forces on the same paths, and what both have.
Parameters of different models mean different things.  Forces at the depths and speeds that all tissues were
identified at do not; they carry the comparison, and parameters stand beside them where the models agree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from tissueid import __version__
from tissueid.arrays import FloatArray
from tissueid.contrast.decision import LEVEL, difference, noticed, rows
from tissueid.errors import UsageError
from tissueid.model.channels import ChannelModel, loading_force
from tissueid.model.functionals import force_after_ramp
from tissueid.model.passivity import scaling_for

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
    model: ChannelModel
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
        if tissue.model.viscous:
            stiffness = np.array([tissue.model.stiffness(theta, half)[:, 0] for theta in draws])
            found[f"viscosity at {half[0]:.3g} mm [N s/mm]"] = (stiffness * tau).sum(axis=1)
        found["relaxation time, longest [s]"] = tau.max(axis=1)
    return found


#: Points of a drawn curve.
POINTS = 61
#: A hold is drawn for so many of the longest median relaxation time of all, and from so small a part of it.
HOLD_TAUS = 5.0
HOLD_FROM = 1e-3
CENTRAL = (0.025, 0.5, 0.975)
_NAMES = ("low", "median", "high")


def force_curves(tissues: list[Compared], common: Common) -> list[dict[str, Any]]:
    """Curves of every tissue on the same depths, speeds and times.

    Returns ``loading``, one a speed: ``speed_mm_s``, ``depth_mm`` and the 2.5, 50 and 97.5 % quantiles of the
    force [N] as ``low``, ``median``, ``high``; ``hold``: the same over ``time_s`` after the end of the
    fastest common ramp to the common depth.
    """
    depth = np.linspace(0.0, common.depth_mm, POINTS)
    speeds = list(dict.fromkeys(common.speeds_mm_s))
    longest = max((_longest(tissue) for tissue in tissues), default=0.0)
    time = np.concatenate([[0.0], np.geomspace(HOLD_FROM, 1.0, POINTS - 1)]) * HOLD_TAUS * (longest or 1.0)
    return [_of_tissue(tissue, depth, speeds, time) for tissue in tissues]


def _longest(tissue: Compared) -> float:
    """Median of the longest relaxation time [s]; 0 without a branch."""
    if not tissue.model.branches:
        return 0.0
    return float(np.median([tissue.model.times(theta).max() for theta in tissue.draws[:MOST_DRAWS]]))


def _of_tissue(tissue: Compared, depth: FloatArray, speeds: list[float], time: FloatArray) -> dict[str, Any]:
    keep = np.linspace(0, len(tissue.draws) - 1, min(len(tissue.draws), MOST_DRAWS)).astype(int)
    ramps = np.empty((len(speeds), keep.size, depth.size))
    holds = np.empty((keep.size, time.size))
    for row, theta in enumerate(tissue.draws[keep]):
        for place, speed in enumerate(speeds):
            ramps[place, row] = loading_force(tissue.model, theta, depth, speed_mm_s=speed)
        still = float(tissue.model.static_force(theta, depth[-1:])[0])
        holds[row] = still + tissue.model.relaxing(theta, float(depth[-1]), time, speeds[-1])
    return {
        "name": tissue.name,
        "loading": [
            {"speed_mm_s": speed, "depth_mm": depth.tolist(), **_band(ramps[place])}
            for place, speed in enumerate(speeds)
        ],
        "hold": {"time_s": time.tolist(), **_band(holds)},
    }


def _band(forces: FloatArray) -> dict[str, list[float]]:
    return {
        name: row.tolist() for name, row in zip(_NAMES, np.quantile(forces, CENTRAL, axis=0), strict=True)
    }


def contrast_document(
    tissues: Sequence[Compared],
    *,
    clamp_N: float,
    progress: Callable[[str, int, int], None] = lambda _message, _done, _total: None,
) -> dict[str, Any]:
    """Compare tissues pair by pair over what all of them have in common.

    ``tissues``: two or more; ``clamp_N``: force clamp of the device [N]; the stiffest tissue sets the scale
    of all; ``progress``: ``progress(message, done, total)``, a tissue at a time.  Returns the document of
    ``schemas/contrast.schema.json``.
    """
    common = common_range(tissues)
    draws = []
    for done, tissue in enumerate(tissues):
        progress(tissue.name, done, len(tissues))
        draws.append(draws_of_numbers(tissue, common))
    progress("comparing", len(tissues), len(tissues))
    scales = [
        scaling_for(
            tissue.model,
            np.median(tissue.draws, axis=0),
            clamp_N=clamp_N,
            fastest_mm_s=tissue.speeds_mm_s[1],
        ).force
        for tissue in tissues
    ]
    scale = min(scales)
    pairs = []
    for i, j in combinations(range(len(tissues)), 2):
        pairs.append(
            {
                "one": tissues[i].name,
                "other": tissues[j].name,
                "difference": asdict(difference(draws[i], draws[j])),
                "numbers": [asdict(row) for row in rows(draws[i], draws[j])],
                "noticed": [asdict(one) for one in noticed(draws[i], draws[j], force_scale=scale)],
            }
        )
    return {
        "schema": "tissueid/contrast/1",
        "tissueid": __version__,
        "level": LEVEL,
        "common": {"depth_mm": common.depth_mm, "speeds_mm_s": list(common.speeds_mm_s)},
        "device": {"clamp_N": clamp_N, "force_scale": scale},
        "tissues": [
            {
                "name": tissue.name,
                "branches": tissue.model.branches,
                "stiffness_degree": tissue.model.stiffness_degree,
                "draws": len(tissue.draws),
                "interval": "total" if tissue.total else "statistical",
            }
            for tissue in tissues
        ],
        "curves": force_curves(list(tissues), common),
        "pairs": pairs,
    }
