"""Trials of one speed belong together: groups of them, and what their peaks say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.digits import number
from tissueid.documents.identification import Specimen, Trial
from tissueid.documents.inspect import Units
from tissueid.measured.spread import SAME_SPEED, clusters
from tissueid.report.remarks import trial_label
from tissueid.report.tissue import Tissue, brief, speed_unit
from tissueid.result import Curve
from tissueid.store.curves import TrialCurve

#: Depths that differ by less than this factor are one setting of a machine.
SAME_DEPTH = 1.04
#: Groups that get a panel of their own.
MOST_GROUPS = 12
#: Speeds at which a law is drawn, and how far beyond the trials.
LINE_POINTS = 24
S_PER_MIN = 60.0


@dataclass(frozen=True, slots=True)
class SpeedGroup:
    """Trials of one loading speed."""

    speed_mm_s: float  # their median
    label: str
    members: tuple[int, ...]  # places among the trials that have a curve


def _label(speed: float, units: Units) -> str:
    text = f"{number(speed, 3)} {speed_unit(units)}"
    return text if units.length != "mm" else f"{text} ({number(S_PER_MIN * speed, 3)} mm/min)"


def speed_groups(specimen: Specimen, trials: Sequence[Trial]) -> list[SpeedGroup]:
    """Groups of trials by loading speed, the slowest first.

    ``specimen``: one of ``specimens`` of identification.json; ``trials``: those of its trials that have a
    curve.
    """
    speeds = [float(trial.speed_mm_s) for trial in trials]
    alike = clusters(speeds, SAME_SPEED)
    while len(alike) > MOST_GROUPS:
        # neighbours that are nearest to each other share a panel
        centres = [float(np.median([speeds[i] for i in one])) for one in alike]
        ratios = [later / max(sooner, 1e-12) for sooner, later in pairwise(centres)]
        at = int(np.argmin(ratios))
        alike[at : at + 2] = [alike[at] + alike[at + 1]]
    groups = []
    for members in alike:
        speed = float(np.median([speeds[i] for i in members]))
        groups.append(SpeedGroup(speed, _label(speed, specimen.units), tuple(sorted(members))))
    return groups


def _peak(trial: Trial, curve: Curve) -> dict[str, float]:
    """Largest recorded force of a trial; a thinned curve keeps it."""
    used = curve.force_N[curve.fitted] if curve.fitted.any() else curve.force_N
    return {
        "speed": float(trial.speed_mm_s),
        "depth": float(trial.depth_mm),
        "force": float(used.max()),
    }


def _means(peaks: Sequence[Mapping[str, float]]) -> list[dict[str, Any]]:
    """Mean and standard deviation of the peaks at each speed."""
    rows = []
    for members in clusters([peak["speed"] for peak in peaks], SAME_SPEED):
        force = np.array([peaks[i]["force"] for i in members])
        sd = float(force.std(ddof=1)) if force.size > 1 else None
        rows.append(
            {
                "speed": float(np.median([peaks[i]["speed"] for i in members])),
                "mean": float(force.mean()),
                "sd": sd,
                "n": len(members),
            }
        )
    return rows


def _line(tissue: Tissue, depth: float, speeds: FloatArray) -> dict[str, Any]:
    """Force at a depth by speed, as the model has it, with its 95 % band."""
    x = np.array([min(depth, tissue.model.depth_mm)])

    def at(thetas: FloatArray) -> FloatArray:
        return np.column_stack([tissue.force(thetas, x, float(speed))[:, 0] for speed in speeds])

    line: dict[str, Any] = {"speed": brief(speeds), "force": brief(at(tissue.theta[None])[0])}
    if tissue.draws is not None:
        low, high = np.quantile(at(tissue.draws), (0.025, 0.975), axis=0)
        line |= {"low": brief(low), "high": brief(high)}
    return line


def peaks_payload(
    specimen: Specimen,
    trials: Sequence[tuple[Trial, TrialCurve]],
    tissue: Tissue | None,
) -> list[dict[str, Any]]:
    """Peak force against loading speed, a group for each depth.

    ``specimen``: one of ``specimens`` of identification.json; ``trials``: its trials with their curves.
    Returns ``label``, ``points`` (label, speed, depth, force), ``means`` (speed, mean, sd, n), ``line``.
    """
    found: list[dict[str, Any]] = [
        {"label": trial_label(trial), **_peak(trial, own.curve)} for trial, own in trials
    ]
    found = [one for one in found if one["speed"] > 0.0 and one["depth"] > 0.0]
    every = [one["speed"] for one in found]
    groups = []
    for members in clusters([one["depth"] for one in found], SAME_DEPTH):
        points = [found[i] for i in members]
        depth = float(np.median([one["depth"] for one in points]))
        speeds = np.geomspace(min(every), max(every), LINE_POINTS if max(every) > min(every) else 1)
        words = "a strain of {}" if specimen.units.length == "1" else "{} mm"
        groups.append(
            {
                "label": words.format(number(depth, 3)),
                "points": points,
                "means": _means(points),
                "line": None if tissue is None else _line(tissue, depth, speeds),
            }
        )
    return groups
