"""The numbers behind the figures of a specimen's law: groups of curves, parts, holds, residuals, profiles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.identification import Specimen, Trial
from tissueid.report.figures import curves_by_trial
from tissueid.report.groups import curve_groups
from tissueid.report.remarks import trial_label
from tissueid.report.speeds import SpeedGroup, peaks_payload, speed_groups
from tissueid.report.tissue import ENDS, Tissue, brief, tissue_of
from tissueid.result import ResidualSummary
from tissueid.store.curves import TrialCurve
from tissueid.store.posteriors import StoredPosterior

Trials = Sequence[tuple[Trial, TrialCurve]]

#: Depths at which the parts are drawn.
GRID, COARSE = 61, 25
#: Specimens from which on the coarse grid is taken: nobody compares thirty curves by eye.
MANY = 12
#: Speeds at which the dynamic part is drawn: the slowest, the fastest, and between.
PART_SPEEDS = 4


def _with_band(values: FloatArray, thetas: FloatArray | None) -> dict[str, Any]:
    """Values and, from those of the draws (n, grid), the ends of their 95 % band."""
    found: dict[str, Any] = {"value": brief(values)}
    if thetas is not None:
        low, high = np.quantile(thetas, ENDS, axis=0)
        found |= {"low": brief(low), "high": brief(high)}
    return found


def _parts(tissue: Tissue, groups: Sequence[SpeedGroup], grid: int) -> dict[str, Any]:
    """Static force, stiffness of the branches and their force in loading, by depth."""
    x = np.linspace(0.0, tissue.model.depth_mm, grid)
    theta, draws = tissue.theta[None], tissue.draws
    moving = [group for group in groups if group.speed_mm_s > 0.0]
    shown = np.unique(np.linspace(0, len(moving) - 1, min(len(moving), PART_SPEEDS)).round().astype(int))
    dynamic = [
        {
            "label": moving[i].label,
            **_with_band(
                tissue.dynamic(theta, x, moving[i].speed_mm_s)[0],
                None if draws is None else tissue.dynamic(draws, x, moving[i].speed_mm_s),
            ),
        }
        for i in shown.tolist()
    ]
    return {
        "x": brief(x),
        "static": _with_band(tissue.static(theta, x)[0], None if draws is None else tissue.static(draws, x)),
        "stiffness": _with_band(
            tissue.stiffness(theta, x)[0], None if draws is None else tissue.stiffness(draws, x)
        ),
        "dynamic": dynamic,
    }


def _holds(specimen: Specimen, trials: Trials) -> list[dict[str, Any]]:
    """Window of every hold in the time of its trial's curve; none of trials whose clock is not known."""
    clocks = {
        (trial.path, trial.sheet): (place, own.residual.start_s)
        for place, (trial, own) in enumerate(trials)
        if own.residual is not None
    }
    found = []
    for row in specimen.relaxation:
        known = clocks.get((row.path, row.sheet))
        if known is not None:
            place, zero = known
            start, end = (float(value) - zero for value in row.window_s)
            step = trials[place][1].residual
            found.append(
                {
                    "label": trial_label(row),
                    "trial": place,
                    "start": start,
                    "end": end,
                    "step": 0.0 if step is None else step.step_s,
                }
            )
    return found


def _residuals(specimen: Specimen, trials: Trials) -> dict[str, Any] | None:
    """Histogram of all logs together; autocorrelation and means in the holds of each."""
    known = [(trial, own.residual) for trial, own in trials if own.residual is not None]
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
            {
                "label": trial_label(trial),
                "lag": brief(one.lags * one.step_s),
                "value": brief(one.correlation),
            }
            for trial, one in known
        ],
        "together": _together(summaries),
        "holds": [
            {
                "label": trial_label(trial),
                "since": brief(one.hold_since_s),
                "mean": brief(one.hold_mean_N),
                "count": one.hold_count.tolist(),
            }
            for trial, one in known
            if one.hold_count.size
        ],
        "pooled": _pooled_holds([one.hold_since_s for one in summaries], summaries, specimen.sigma_N),
    }


def _pooled_holds(
    places: Sequence[FloatArray], summaries: Sequence[ResidualSummary], sigma_N: float
) -> dict[str, Any]:
    """Mean of all holds in each block of time, and 1.96 of its standard errors under white noise."""
    since = np.concatenate(places)
    mean = np.concatenate([one.hold_mean_N for one in summaries])
    count = np.concatenate([one.hold_count for one in summaries]).astype(float)
    key = np.round(np.log10(since), 6)
    found = np.unique(key)
    weight = np.array([count[key == one].sum() for one in found])
    total = np.array([(count * mean)[key == one].sum() for one in found])
    return {
        "since": brief(10.0**found),
        "mean": brief(total / weight),
        "error": brief(1.96 * sigma_N / np.sqrt(weight)),
    }


def _together(summaries: Sequence[ResidualSummary]) -> dict[str, Any]:
    """Autocorrelation of all logs, each by its samples, and within what it stays for white noise in 95 %."""
    rows: dict[float, list[tuple[float, float]]] = {}
    for one in summaries:
        size = float(one.counts.sum())
        for lag, value in zip(one.lags * one.step_s, one.correlation, strict=True):
            rows.setdefault(float(f"{lag:.3g}"), []).append((size, float(value)))
    lags = sorted(rows)
    sizes = [sum(size for size, _ in rows[lag]) for lag in lags]
    return {
        "lag": brief(lags),
        "value": brief(
            sum(size * value for size, value in rows[lag]) / total
            for lag, total in zip(lags, sizes, strict=True)
        ),
        "bound": brief(1.96 / total**0.5 for total in sizes),
    }


def _profiles(specimen: Specimen) -> list[dict[str, Any]]:
    """Profile likelihood of every relaxation time that carries one."""
    found = []
    for entry in specimen.parameters:
        curve = entry.detail.get("profile")
        if curve and curve["tau_s"]:
            suffix = entry.name.removeprefix("relaxation_time_s")
            found.append(
                {
                    "suffix": suffix,
                    "symbol": entry.symbol,
                    "tau": curve["tau_s"],
                    "rise": curve["rise"],
                    "stiffness": curve["stiffness_N_per_mm"],
                    "estimate": entry.detail.get("estimate"),
                    "identified": entry.identified,
                }
            )
    return found


def law_payload(
    specimens: Sequence[Specimen],
    curves: Sequence[TrialCurve],
    posteriors: Sequence[StoredPosterior] = (),
) -> list[dict[str, Any]]:
    """Points of the figures of every specimen's law, in their order.

    ``specimens``: ``specimens`` of identification.json.  Returns ``speeds`` (label, trials), ``groups``,
    ``parts``, ``peaks``, ``holds``, ``residuals``, ``profiles``; ``parts`` and ``residuals`` are ``None``
    where they are not known.
    """
    sampled = {one.specimen: one for one in posteriors}
    payload = []
    for specimen, trials in zip(specimens, curves_by_trial(specimens, curves), strict=True):
        tissue = tissue_of(specimen, sampled.get(specimen.specimen))
        groups = speed_groups(specimen, [trial for trial, _ in trials])
        payload.append(
            {
                "speeds": [{"label": group.label, "trials": list(group.members)} for group in groups],
                "groups": curve_groups([trials], specimen.units),
                "parts": None
                if tissue is None
                else _parts(tissue, groups, COARSE if len(specimens) >= MANY else GRID),
                "peaks": peaks_payload(specimen, trials, tissue),
                "holds": _holds(specimen, trials),
                "residuals": _residuals(specimen, trials),
                "profiles": _profiles(specimen),
            }
        )
    return payload
