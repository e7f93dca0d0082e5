"""Numbers behind the figures of a specimen's law, from its output folder alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from tissueid.arrays import FloatArray, evenly
from tissueid.digits import number
from tissueid.documents.identification import Specimen, Trial
from tissueid.documents.inspect import Units
from tissueid.measured.spread import SAME_SPEED, Pushed, clusters, programs
from tissueid.model.channels import ChannelModel, loading_force
from tissueid.model.grammar import rebuilt
from tissueid.report.figures import curves_by_trial
from tissueid.report.wording import S_PER_MIN, program_words, speed_unit, trial_label
from tissueid.result import Curve, ModelChoice, ResidualSummary
from tissueid.store.curves import TrialCurve
from tissueid.store.posteriors import StoredPosterior

#: Draws that a band is taken over: its ends are then good to a tenth of the posterior's sd.
BAND_DRAWS = 500
#: Ends of a 95 % band.
ENDS = (0.025, 0.975)
#: Digits of a number in a figure: a pixel needs four.
DIGITS = 5


def brief(values: Iterable[float]) -> list[float]:
    """Numbers in the digits that a figure can show."""
    return [float(f"{value:.{DIGITS}g}") for value in values]


@dataclass(frozen=True, slots=True, eq=False)
class Tissue:
    """One identified contact model."""

    model: ChannelModel
    theta: FloatArray  # (p,)
    #: (n, p): of the total posterior where there is one, else of the statistical one; ``None``: nothing was
    #: sampled.
    draws: FloatArray | None

    def banded(self, of: Callable[..., FloatArray], *at: Any) -> dict[str, Any]:
        """Numbers of a function of theta and, where there are draws, the ends of their 95 % band."""
        found: dict[str, Any] = {"value": brief(of(self.theta, *at))}
        if self.draws is not None:
            low, high = np.quantile([of(theta, *at) for theta in self.draws], ENDS, axis=0)
            found |= {"low": brief(low), "high": brief(high)}
        return found


def tissue_of(specimen: Specimen, stored: StoredPosterior | None) -> Tissue | None:
    """The tissue of one of ``specimens`` of identification.json; ``None`` where a number is missing."""
    model = rebuilt(ModelChoice.of(specimen.model), specimen.validity.depth_mm)
    known = {entry.name: entry for entry in specimen.parameters}
    values = [
        known[name].detail.get("estimate", known[name].value) if name in known else None
        for name in model.parameter_names
    ]
    if any(value is None for value in values):
        return None
    draws = None
    if stored is not None and set(model.parameter_names) <= set(stored.theta_names):
        table = stored.draws if stored.draws_total is None else stored.draws_total
        order = [stored.theta_names.index(name) for name in model.parameter_names]
        draws = table[evenly(len(table), BAND_DRAWS)][:, order]
    return Tissue(model, np.array(values, dtype=np.float64), draws)


#: Trials of one specimen with their curves.
Trials = Sequence[tuple[Trial, TrialCurve]]

#: The tool has stopped at the first sample with so much of the travel behind it.
STOPPED = 0.999
#: Bins of depth, and of time after the stop.
BINS = 60
#: First bin of time, as a share of the longest hold.
EARLIEST = 1e-3


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


def binned_loading(curve: Curve, edges_mm: FloatArray) -> FloatArray:
    """Mean force [N] of a curve's loading in ascending bins of depth; NaN where it does not cover a bin."""
    stop = _stop(curve) + 1
    depth = np.maximum.accumulate(curve.depth_mm[:stop])
    return _bin_means(depth, curve.force_N[:stop], edges_mm)


def binned_hold(curve: Curve, edges_s: FloatArray) -> FloatArray:
    """Mean force [N] of a curve in bins of time since the tool stopped; NaN where it did not stay."""
    stop = _stop(curve)
    deep = curve.depth_mm[stop]
    left = np.flatnonzero(curve.depth_mm[stop:] < curve.depth_mm[0] + 0.98 * (deep - curve.depth_mm[0]))
    end = stop + int(left[0]) if left.size else curve.time_s.size
    if end - stop < 2:
        return np.full(edges_s.size - 1, np.nan)
    return _bin_means(curve.time_s[stop:end] - curve.time_s[stop], curve.force_N[stop:end], edges_s)


def _summary(x: FloatArray, rows: FloatArray) -> dict[str, Any] | None:
    """Mean and standard deviation by column of rows (curves, bins), as far as all go; of two at least.

    A mean that lost a curve on its way would jump where none of them does.
    """
    rows = rows[np.isfinite(rows).any(axis=1)]
    shared = np.isfinite(rows).all(axis=0)
    if len(rows) < 2 or not shared.any():
        return None
    kept = rows[:, shared]
    return {
        "x": brief(x[shared]),
        "mean": brief(kept.mean(axis=0)),
        "sd": brief(kept.std(axis=0, ddof=1)),
        "n": [len(rows)] * kept.shape[1],
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
        "loading": _summary(middle[0], np.stack([binned_loading(curve, depths) for curve in curves])),
        "hold": _summary(middle[1], np.stack([binned_hold(curve, times) for curve in curves])),
    }


def curve_groups(trials: Sequence[Trials], units: Units) -> list[dict[str, Any]]:
    """Curves by program (speed and depth, or a load), each with mean and standard deviation.

    ``trials``: of every specimen that is to be seen together.  Returns ``label``, ``members`` (specimen,
    trial), ``loading`` and ``hold`` (``x``, ``mean``, ``sd`` and ``n`` of each bin that all curves reach,
    else ``None``); empty where there is one curve.
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
    pushes = [_pushed(trial, curve) for _, trial, curve in every]
    for members in programs(pushes):
        own = [every[i] for i in members]
        label = f"{_of_program([pushes[i] for i in members], units)}, n = {len(own)}"
        found.append(_group([place for place, *_ in own], [curve for *_, curve in own], label))
    return found


def _of_program(pushes: Sequence[Pushed], units: Units) -> str:
    """Speed and depth of a program, or the load that ended its pushes."""
    speed, depth, peak, ramp_time_s = np.median(np.array(pushes), axis=0).tolist()
    if len(programs([push._replace(peak_N=float("nan")) for push in pushes])) > 1:
        return f"to {number(peak, 3)} {units.force} in {number(ramp_time_s, 2)} s"
    return program_words(speed, depth, units)


def _pushed(trial: Trial, curve: Curve) -> Pushed:
    """The push of a trial, by its largest force."""
    top = int(np.argmax(curve.force_N))
    ramp_time_s = float(curve.time_s[top] - curve.time_s[0])
    return Pushed(float(trial.speed_mm_s), float(trial.depth_mm), float(curve.force_N[top]), ramp_time_s)


#: Depths that differ by less than this factor are one setting of a machine.
SAME_DEPTH = 1.04
#: Groups that get a panel of their own.
MOST_GROUPS = 12
#: Speeds at which a law is drawn.
LINE_POINTS = 24


class SpeedGroup(NamedTuple):
    """Trials of one loading speed."""

    speed_mm_s: float  # their median
    label: str
    members: tuple[int, ...]  # places among the trials that have a curve


def speed_groups(specimen: Specimen, trials: Sequence[Trial]) -> list[SpeedGroup]:
    """Groups of trials, of those that have a curve, by loading speed, the slowest first."""
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
        label = f"{number(speed, 3)} {speed_unit(specimen.units)}"
        label += f" ({number(S_PER_MIN * speed, 3)} mm/min)" * (specimen.units.length == "mm")
        groups.append(SpeedGroup(speed, label, tuple(sorted(members))))
    return groups


def _peak(trial: Trial, curve: Curve) -> dict[str, Any]:
    """Largest recorded force of a trial; a thinned curve keeps it."""
    used = curve.force_N[curve.fitted] if curve.fitted.any() else curve.force_N
    place = {"speed": float(trial.speed_mm_s), "depth": float(trial.depth_mm)}
    return {"label": trial_label(trial), **place, "force": float(used.max())}


def _means(peaks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Mean and standard deviation of the peaks at each speed."""
    rows = []
    for members in clusters([peak["speed"] for peak in peaks], SAME_SPEED):
        force = np.array([peaks[i]["force"] for i in members])
        sd = float(force.std(ddof=1)) if force.size > 1 else None
        speed = float(np.median([peaks[i]["speed"] for i in members]))
        rows.append({"speed": speed, "mean": float(force.mean()), "sd": sd, "n": len(members)})
    return rows


def _line(tissue: Tissue, depth: float, speeds: FloatArray) -> dict[str, Any]:
    """Force at a depth by speed, as the model has it, with its 95 % band."""
    model = tissue.model
    x = np.full(speeds.size, min(depth, model.depth_mm))
    band = tissue.banded(lambda theta: loading_force(model, theta, x, speed_mm_s=speeds))
    return {"speed": brief(speeds), "force": band.pop("value"), **band}


def peaks_payload(specimen: Specimen, trials: Trials, tissue: Tissue | None) -> list[dict[str, Any]]:
    """Peak force against loading speed, a group for each depth.

    Returns ``label``, ``points`` (label, speed, depth, force), ``means`` (speed, mean, sd, n), ``line``.
    """
    found = [_peak(trial, own.curve) for trial, own in trials if trial.speed_mm_s > 0.0 < trial.depth_mm]
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


#: Depths at which the parts are drawn.
GRID, COARSE = 61, 25
#: Specimens from which on the coarse grid is taken: nobody compares thirty curves by eye.
MANY = 12
#: Speeds at which the dynamic part is drawn: the slowest, the fastest, and between.
PART_SPEEDS = 4


def _parts(tissue: Tissue, groups: Sequence[SpeedGroup], grid: int) -> dict[str, Any]:
    """Static force, stiffness of the branches and their force in loading, by depth."""
    model = tissue.model
    x = np.linspace(0.0, model.depth_mm, grid)
    moving = [group for group in groups if group.speed_mm_s > 0.0]
    shown = np.unique(np.linspace(0, len(moving) - 1, min(len(moving), PART_SPEEDS)).round().astype(int))
    return {
        "x": brief(x),
        "static": tissue.banded(model.static_force, x),
        "stiffness": tissue.banded(lambda theta, depth: model.stiffness(theta, depth).sum(axis=0), x),
        "dynamic": [
            {"label": moving[i].label, **tissue.banded(model.loading, x, moving[i].speed_mm_s)}
            for i in shown.tolist()
        ],
    }


def _holds(specimen: Specimen, trials: Trials) -> list[dict[str, Any]]:
    """Window of every hold in the time of its trial's curve; none of trials whose clock is not known."""
    clocks = {
        (trial.path, trial.sheet): (place, own.residual)
        for place, (trial, own) in enumerate(trials)
        if own.residual is not None
    }
    found = []
    for row in specimen.relaxation:
        if (row.path, row.sheet) in clocks:
            place, clock = clocks[row.path, row.sheet]
            start, end = (float(value) - clock.start_s for value in row.window_s)
            window = {"start": start, "end": end, "step": clock.step_s}
            found.append({"label": trial_label(row), "trial": place, **window})
    return found


def _residuals(specimen: Specimen, trials: Trials) -> dict[str, Any] | None:
    """Histogram of all logs together; autocorrelation and means in the holds of each."""
    known = [(trial_label(trial), own.residual) for trial, own in trials if own.residual is not None]
    if not known:
        return None
    summaries = [one for _, one in known]
    edges = summaries[0].edges_N
    same = all(np.array_equal(one.edges_N, edges) for one in summaries)
    return {
        "sigma": specimen.sigma_N,
        "edges": brief(edges),
        "counts": np.sum([one.counts for one in summaries], axis=0).tolist() if same else [],
        "correlation": [
            {"label": label, "lag": brief(one.lags * one.step_s), "value": brief(one.correlation)}
            for label, one in known
        ],
        "together": _together(summaries),
        "holds": [
            {"label": label, "since": brief(one.hold_since_s), "mean": brief(one.hold_mean_N)}
            for label, one in known
            if one.hold_count.size
        ],
        "pooled": _pooled_holds(summaries, specimen.sigma_N),
    }


def _pooled_holds(summaries: Sequence[ResidualSummary], sigma_N: float) -> dict[str, Any]:
    """Mean of all holds in each block of time, and 1.96 of its standard errors under white noise."""
    since = np.concatenate([one.hold_since_s for one in summaries])
    mean = np.concatenate([one.hold_mean_N for one in summaries])
    count = np.concatenate([one.hold_count for one in summaries])
    found, place = np.unique(np.round(np.log10(since), 6), return_inverse=True)
    weight, total = np.bincount(place, count), np.bincount(place, count * mean)
    return {
        "since": brief(10.0**found),
        "mean": brief(total / weight),
        "error": brief(1.96 * sigma_N / np.sqrt(weight)),
    }


def _together(summaries: Sequence[ResidualSummary]) -> dict[str, Any]:
    """Autocorrelation of all logs, each by its samples, and within what it stays for white noise in 95 %."""
    every = np.concatenate([one.lags * one.step_s for one in summaries])
    lags, place = np.unique([float(f"{lag:.3g}") for lag in every], return_inverse=True)
    size = np.concatenate([np.full(one.lags.size, one.counts.sum()) for one in summaries])
    total = np.bincount(place, size)
    sums = np.bincount(place, size * np.concatenate([one.correlation for one in summaries]))
    return {"lag": brief(lags), "value": brief(sums / total), "bound": brief(1.96 / np.sqrt(total))}


def _profiles(specimen: Specimen) -> list[dict[str, Any]]:
    """Profile likelihood of every relaxation time that carries one."""
    found = []
    for entry in specimen.parameters:
        curve = entry.detail.get("profile")
        if curve and curve["tau_s"]:
            said = {"suffix": entry.name.removeprefix("relaxation_time_s"), "symbol": entry.symbol}
            numbers = {"tau": curve["tau_s"], "stiffness": curve["stiffness_N_per_mm"]}
            found.append({**said, **numbers, "rise": curve["rise"]})
    return found


def law_payload(
    specimens: Sequence[Specimen], curves: Sequence[TrialCurve], posteriors: Sequence[StoredPosterior] = ()
) -> list[dict[str, Any]]:
    """Points of the figures of every specimen's law, in their order.

    Returns ``deepest`` (a trial of each speed), ``groups``, ``parts``, ``peaks``, ``holds``, ``residuals``,
    ``profiles``; ``parts`` and ``residuals`` are ``None`` where they are not known.
    """
    sampled = {one.specimen: one for one in posteriors}
    grid = COARSE if len(specimens) >= MANY else GRID
    payload = []
    for specimen, trials in zip(specimens, curves_by_trial(specimens, curves), strict=True):
        tissue = tissue_of(specimen, sampled.get(specimen.specimen))
        groups = speed_groups(specimen, [trial for trial, _ in trials])
        reached = [float(own.curve.depth_mm.max()) for _, own in trials]
        payload.append(
            {
                "deepest": [max(group.members, key=reached.__getitem__) for group in groups],
                "groups": curve_groups([trials], specimen.units),
                "parts": None if tissue is None else _parts(tissue, groups, grid),
                "peaks": peaks_payload(specimen, trials, tissue),
                "holds": _holds(specimen, trials),
                "residuals": _residuals(specimen, trials),
                "profiles": _profiles(specimen),
            }
        )
    return payload
