"""Curves of one program together: mean and standard deviation of the force, by depth and after the stop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.digits import number
from tissueid.documents.identification import Trial
from tissueid.documents.inspect import Units
from tissueid.measured.spread import programs
from tissueid.report.tissue import brief, speed_unit
from tissueid.result import Curve
from tissueid.store.curves import TrialCurve

#: Trials with their curves, a list a specimen.
Trials = Sequence[Sequence[tuple[Trial, TrialCurve]]]

#: The tool has stopped at the first sample with so much of the travel behind it.
STOPPED = 0.999
#: Bins of depth, and of time after the stop.
BINS = 60
#: First bin of time, as a share of the longest hold.
EARLIEST = 1e-3


def program_words(speed_mm_s: float, depth_mm: float, units: Units) -> str:
    """Speed and depth of a program: ``4.15 mm/s to 8.01 mm``."""
    length = f" {units.length}" if units.length == "mm" else ""
    return f"{number(speed_mm_s, 3)} {speed_unit(units)} to {number(depth_mm, 3)}{length}"


def _stop(curve: Curve) -> int:
    """First sample at which the tool has stopped."""
    start = float(curve.depth_mm[0])
    travel = float(curve.depth_mm.max()) - start
    return int(np.argmax(curve.depth_mm - start >= STOPPED * travel))


def _bin_means(x: FloatArray, y: FloatArray, edges: FloatArray) -> FloatArray:
    """Mean of y, straight between samples, over each bin of an ascending x; NaN where x does not reach."""
    every = np.sort(np.concatenate([x, edges]), kind="stable")
    between = np.interp(every, x, y)
    area = np.concatenate([[0.0], np.cumsum(0.5 * (between[1:] + between[:-1]) * np.diff(every))])
    means = np.diff(np.interp(edges, every, area)) / np.diff(edges)
    within = (edges[:-1] >= x[0]) & (edges[1:] <= x[-1])
    return np.where(within, means, np.nan)


def loading_force(curve: Curve, edges_mm: FloatArray) -> FloatArray:
    """Mean force of a curve's loading in bins of depth.

    ``edges_mm`` (n + 1,): ascending.  Returns (n,), [N]; NaN where the loading does not cover the bin.
    """
    stop = _stop(curve) + 1
    depth = np.maximum.accumulate(curve.depth_mm[:stop])
    return _bin_means(depth, curve.force_N[:stop], edges_mm)


def hold_force(curve: Curve, edges_s: FloatArray) -> FloatArray:
    """Mean force of a curve in bins of time since the tool stopped.

    ``edges_s`` (n + 1,): ascending, from zero.  Returns (n,), [N]; NaN where the tool did not stay.
    """
    stop = _stop(curve)
    deep = curve.depth_mm[stop]
    left = np.flatnonzero(curve.depth_mm[stop:] < curve.depth_mm[0] + 0.98 * (deep - curve.depth_mm[0]))
    end = stop + int(left[0]) if left.size else curve.time_s.size
    if end - stop < 2:
        return np.full(edges_s.size - 1, np.nan)
    return _bin_means(curve.time_s[stop:end] - curve.time_s[stop], curve.force_N[stop:end], edges_s)


def _summary(x: FloatArray, rows: FloatArray) -> dict[str, Any] | None:
    """Mean and standard deviation by column of rows (curves, bins); none where no two curves meet."""
    count = np.isfinite(rows).sum(axis=0)
    several = count >= 2
    if not several.any():
        return None
    kept = rows[:, several]
    return {
        "x": brief(x[several]),
        "mean": brief(np.nanmean(kept, axis=0)),
        "sd": brief(np.nanstd(kept, axis=0, ddof=1)),
        "n": count[several].tolist(),
    }


def _group(members: Sequence[tuple[int, int]], curves: Sequence[Curve], label: str) -> dict[str, Any]:
    deepest = max(float(curve.depth_mm.max()) for curve in curves)
    shallow = min(float(curve.depth_mm[0]) for curve in curves)
    depths = np.linspace(shallow, deepest, BINS + 1)
    longest = max(float(curve.time_s[-1] - curve.time_s[_stop(curve)]) for curve in curves)
    times = np.concatenate([[0.0], np.geomspace(EARLIEST, 1.0, BINS)]) * max(longest, 1e-9)
    middle = [0.5 * (edges[1:] + edges[:-1]) for edges in (depths, times)]
    return {
        "label": label,
        "members": [list(place) for place in members],
        "loading": _summary(middle[0], np.stack([loading_force(curve, depths) for curve in curves])),
        "hold": _summary(middle[1], np.stack([hold_force(curve, times) for curve in curves])),
    }


def curve_groups(trials: Trials, units: Units) -> list[dict[str, Any]]:
    """Curves by program (loading speed and depth), each with mean and standard deviation.

    ``trials``: of every specimen that is to be seen together; ``units``: ``length`` and ``force``.  Returns
    ``label``, ``members`` (specimen, trial), ``loading`` and ``hold`` (``x``, ``mean``, ``sd`` and ``n`` of
    each bin in which two curves meet, else ``None``); empty where there is one curve.
    """
    every = [
        ((place, i), trial, own.curve)
        for place, one in enumerate(trials)
        for i, (trial, own) in enumerate(one)
        if own.curve.time_s.size > 1
    ]
    if len(every) < 2:
        return []
    found = []
    pushes = [(float(trial.speed_mm_s), float(trial.depth_mm)) for _, trial, _ in every]
    for members in programs(pushes):
        own = [every[i] for i in members]
        speed, depth = (float(np.median([pushes[i][k] for i in members])) for k in (0, 1))
        label = f"{program_words(speed, depth, units)}, n = {len(own)}"
        found.append(_group([place for place, *_ in own], [curve for *_, curve in own], label))
    return found
