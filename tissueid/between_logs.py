"""Differences between the logs of a specimen: their spread, their order, and sites that were tested again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.result import TrialFit

#: Standard deviation of ln gain and ln time beyond which logs differ much; on one site they stay below 5 %.
MUCH_SPREAD = 0.10
#: An order effect is said from so many logs, this chance of a slope that large without one, and this change.
FEWEST_RUNS, CHANCE, LEAST_CHANGE = 4, 0.01, 0.02
#: Least difference of a first test from the others.
FIRST_CHANGE = 0.05
#: Ratio of a log to its specimen that may differ, its words, and the name of its spread.
_SPREADS = (("gain", "stiffness", "sd_ln_gain"), ("time_ratio", "relaxation time", "sd_ln_time"))


def spread_flags(trials: Sequence[TrialFit]) -> list[Flag]:
    """``gain_spread`` and ``relaxation_spread`` where the logs of a specimen differ much."""
    out: list[Flag] = []
    for name, what, key in _SPREADS:
        ratio = np.array([getattr(trial, name) for trial in trials])
        sd = float(np.log(ratio).std(ddof=1)) if ratio.size > 1 and (ratio > 0.0).all() else 0.0
        if sd > MUCH_SPREAD:
            low, high = int(ratio.argmin()), int(ratio.argmax())
            ends = f"{ratio[low]:.2f} ({_name(trials[low])}) to {ratio[high]:.2f} ({_name(trials[high])})"
            message = f"{what} differs by {100 * sd:.0f} % (sd) between logs, from {ends}"
            values = {"lowest": float(ratio[low]), "highest": float(ratio[high]), key: sd}
            out.append(Flag("gain_spread" if name == "gain" else "relaxation_spread", message, values))
    return out


def order_effect(trials: Sequence[TrialFit], runs: Sequence[int | None]) -> list[Flag]:
    """``order_effect`` where stiffness follows the runs, else the files, or the first test differs."""
    stated = any(run is not None for run in runs)
    places = runs if stated else range(1, len(trials) + 1)
    known = sorted(
        (run, trial.gain)
        for run, trial in zip(places, trials, strict=True)
        if run is not None and trial.gain > 0.0
    )
    order = np.array([float(run) for run, _ in known])
    log_gain = np.log([gain for _, gain in known])
    if order.size < FEWEST_RUNS or np.ptp(order) == 0.0 or np.ptp(log_gain) == 0.0:
        return []
    what = "run" if stated else "file"
    return _first_apart(log_gain, what) or _trend(order, log_gain, what)


def _trend(order: FloatArray, log_gain: FloatArray, what: str) -> list[Flag]:
    """The flag of a slope over the order."""
    line = stats.linregress(order, log_gain)
    change = float(np.expm1(line.slope * np.ptp(order)))
    if line.pvalue >= CHANCE or abs(change) < LEAST_CHANGE:
        return []
    first, last = int(order.min()), int(order.max())
    message = (
        f"stiffness {'falls' if change < 0.0 else 'rises'} by {100 * abs(change):.1f} % from {what} {first} "
        f"to {what} {last} ({order.size} logs, p = {line.pvalue:.1g})"
    )
    slope, p = float(line.slope), float(line.pvalue)
    values = {"change": change, "per_run": slope, "p": p, "runs": int(order.size)}
    return [Flag("order_effect", message, values)]


def _first_apart(log_gain: FloatArray, what: str) -> list[Flag]:
    """The flag of a first test that differs from all others by far more than they do among each other."""
    rest = log_gain[1:]
    # the others may follow a line of their own
    line = np.polynomial.Polynomial.fit(np.arange(1.0, log_gain.size), rest, 1)
    spread = float(np.sqrt(((rest - rest.mean()) ** 2).sum() / max(rest.size - 1, 1)))
    apart = float(log_gain[0] - rest.mean())
    if abs(np.expm1(apart)) < FIRST_CHANGE or abs(log_gain[0] - float(line(0.0))) < np.log1p(FIRST_CHANGE):
        return []
    t = abs(apart) / max(spread * np.sqrt(1.0 + 1.0 / rest.size), 1e-12)
    # a first test softens tissue: of one that is stiffer the chance is that of one side
    p = float((1.0 if apart > 0.0 else 2.0) * stats.t.sf(t, rest.size - 1))
    if p >= CHANCE:
        return []
    change = float(np.expm1(apart))
    message = (
        f"the first {what} is {100 * abs(change):.1f} % {'stiffer' if change > 0.0 else 'softer'} than the "
        f"other {rest.size} (p = {p:.1g})"
    )
    return [Flag("order_effect", message, {"change": change, "first": True, "p": p, "runs": log_gain.size})]


def repeated_sites(trials: Sequence[TrialFit], rows: Sequence[Mapping[str, Any]]) -> list[Flag]:
    """``repeated_site`` where one site of the specimen was tested more than once."""
    tested: dict[str, list[float | None]] = {}
    for _, row in zip(trials, rows, strict=True):
        if row.get("site") is not None:
            tested.setdefault(str(row["site"]), []).append(row.get("rest_s"))
    again = {site: rests for site, rests in tested.items() if len(rests) > 1}
    if not again:
        return []
    first, rests_of_first = next(iter(again.items()))
    said = f"{first} was tested {len(rests_of_first)} times"
    if len(again) > 1:
        said += f", and {len(again) - 1} more site{'s' * (len(again) > 2)} repeatedly"
    stated = [rest for rests in again.values() for rest in rests if rest is not None]
    rest = f"rests from {min(stated):g} s" if stated else "rests not stated"
    values: dict[str, Any] = {"sites": list(again), "times": [len(rests) for rests in again.values()]}
    if stated:
        values["shortest_rest_s"] = min(stated)
    return [Flag("repeated_site", f"{said}; {rest}", values)]


def copies(trials: Sequence[TrialFit], inputs: Sequence[Mapping[str, Any]]) -> list[Flag]:
    """``copied_recording`` where files of the specimen are the same to the byte."""
    bytes_of = {(row["path"], row["sheet"]): row["sha256"] for row in inputs}
    first: dict[tuple[str, str | None], TrialFit] = {}
    pairs = []
    for trial in trials:
        content = bytes_of.get((trial.path, trial.sheet), "")
        original = first.setdefault((content, trial.sheet), trial)
        if content and original is not trial:
            pairs.append((_name(trial), _name(original)))
    if not pairs:
        return []
    said = f"{len(pairs)} of {len(trials)} recordings are copies ({pairs[0][0]} of {pairs[0][1]})"
    message = f"{said}: what is counted twice narrows intervals, and tells nothing"
    again, of = zip(*pairs, strict=True)
    return [Flag("copied_recording", message, {"copies": list(again), "of": list(of)})]


def _name(trial: TrialFit) -> str:
    return trial.path if trial.sheet is None else f"{trial.path} [{trial.sheet}]"
