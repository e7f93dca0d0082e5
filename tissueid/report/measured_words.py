"""What was measured, no model, for the first screen: mean and spread between the logs of one programme."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev
from typing import Any

from tissueid.digits import number, with_error
from tissueid.report.groups import programme_words, programmes
from tissueid.report.wording import unit_words

__all__ = ["measured_name", "measured_view"]

#: Names of the first screen in its order; the others stand in the workbook.
_WORDS: Mapping[str, str] = {
    "peak": "Peak force",
    "depth": "Depth",
    "travel": "Travel",
    "speed": "Speed",
    "ramp_time": "Ramp time",
    "force": "F({})",
    "force_over_10s": "F({})/F(10 s)",
    "modulus_loading": "Modulus, loading",
    "modulus_held": "Modulus, held",
    "force_over_peak": "F({})/F_peak (depends on the ramp)",
    "relaxation_time": "One τ of the hold",
    "loop_area": "Loop area",
}
#: What knows the ramp stands in the workbook alone.
_ASIDE = {"force_over_peak"}
#: Columns that are shown, of holds or of programmes.
MOST_COLUMNS = 2
_REFERENCE_S = 10.0
#: A smaller standard deviation, as a share of the mean, is one of rounding.
_NO_SPREAD = 1e-9
NONE = "–"

#: Name of a number, and its time after the stop [s].
Key = tuple[str, float | None]


def measured_name(row: Mapping[str, Any]) -> str:
    """Name of a measured number; of a force with its time after the stop."""
    words = _WORDS.get(row["name"], str(row["name"]).replace("_", " "))
    return words if row["time_s"] is None else words.format(f"{row['time_s']:g} s")


@dataclass(frozen=True, slots=True)
class _Column:
    """Numbers of one hold, or of one programme: mean, spread and reason by name and time."""

    head: str
    count: int
    found: Mapping[Key, Mapping[str, Any]]


def _cell(row: Mapping[str, Any] | None) -> tuple[str, bool]:
    """A cell, and whether it is a number."""
    if row is None or (row["mean"] is None and not row["reason"]):
        return NONE, True
    if row["mean"] is None:
        return str(row["reason"]), False
    spread = None if row["sd"] is None or row["sd"] <= _NO_SPREAD * abs(row["mean"]) else row["sd"]
    return with_error(row["mean"], spread), True


def _ramps(rows: Iterable[Mapping[str, Any]]) -> str:
    known = [row["ramp_time_s"] for row in rows if row["ramp_time_s"] is not None]
    if not known:
        return ""
    short, long = (number(end, 3) for end in (min(one[0] for one in known), max(one[1] for one in known)))
    return f"ramp {short} s" if short == long else f"ramps {short} to {long} s"


def _of_holds(rows: Sequence[Mapping[str, Any]]) -> list[_Column]:
    """A column for each hold of the one programme."""
    numbers = sorted({row["hold"] for row in rows})
    columns = []
    for hold in numbers:
        own = [row for row in rows if row["hold"] == hold]
        name = f"Hold {hold}" if len(numbers) > 1 and hold else "Value"
        head = ", ".join(part for part in (name, _ramps(own)) if part)
        found = {(row["name"], row["time_s"]): row for row in own}
        columns.append(_Column(head, max(row["count"] for row in own), found))
    return columns


def _numbers(measured: Mapping[str, Any]) -> dict[Key, tuple[str, float | None]]:
    """Units and values of the hold with the largest peak, or of the push where nothing was held."""
    held = [hold for hold in measured["holds"] if hold["push"] is not None]
    hold = max(held, key=lambda one: float(one["push"]["peak"]["force_N"]), default=None)
    push = measured["push"] if hold is None else hold["push"]
    if push is None:
        return {}
    found: dict[Key, tuple[str, float | None]] = {
        ("peak", None): ("N", push["peak"]["force_N"]),
        ("depth", None): ("mm", push["depth_mm"]),
        ("speed", None): ("mm/s", push["speed_mm_s"]),
        ("ramp_time", None): ("s", push["ramp_time_s"]),
    }
    for one in () if hold is None else hold["forces"]:
        found["force", one["time_s"]] = ("N", one["after_stop_N"])
        if one["time_s"] != _REFERENCE_S:
            found["force_over_10s", one["time_s"]] = ("1", one["over_10s"])
    if hold is not None and hold["tau"] is not None:
        found["relaxation_time", None] = ("s", hold["tau"]["single_s"])
    return found


def _of_programmes(specimen: Mapping[str, Any], groups: Sequence[Sequence[int]]) -> list[_Column]:
    """A column for each programme, those with holds first and the deepest of them first."""
    columns = []
    for members in groups:
        trials = [specimen["trials"][i] for i in members]
        known = [_numbers(trial["measured"]) for trial in trials if trial.get("measured") is not None]
        found = {}
        for key, (unit, _) in ((key, one) for log in known for key, one in log.items()):
            values = [log[key][1] for log in known if key in log]
            there = [value for value in values if value is not None]
            if there:
                sd = stdev(there) if len(there) > 1 else None
                found[key] = {"name": key[0], "time_s": key[1], "unit": unit, "reason": None}
                found[key] |= {"mean": fmean(there), "sd": sd}
        head = f"{programme_words(trials, specimen['units'])}, n = {len(members)}"
        columns.append(_Column(head, len(members), found))
    held = ("force", 1.0)

    def rank(column: _Column) -> tuple[bool, float]:
        depth = column.found.get(("depth", None))
        return held in column.found, 0.0 if depth is None else depth["mean"]

    return sorted((one for one in columns if one.found), key=rank, reverse=True)


def measured_view(specimen: Mapping[str, Any]) -> dict[str, Any] | None:
    """The measured block: ``head``, ``rows`` (name, unit, cells) and ``said``; ``None`` without any.

    Parameters
    ----------
    specimen : mapping
        One of ``specimens`` of identification.json.
    """
    told = [row for row in specimen.get("measured", ()) if row["name"] in _WORDS.keys() - _ASIDE]
    if any(row["name"] == "depth" for row in told):
        told = [row for row in told if row["name"] != "travel"]
    groups = programmes(specimen["trials"])
    columns = _of_holds(told) if len(groups) < 2 else _of_programmes(specimen, groups)
    if not columns:
        return None
    shown, order = columns[:MOST_COLUMNS], list(_WORDS)
    keys = sorted(
        {key for column in shown for key in column.found},
        key=lambda key: (order.index(key[0]), key[1] or 0.0),
    )
    rows = []
    for key in keys:
        own = [column.found.get(key) for column in shown]
        first = next(row for row in own if row is not None)
        unit = "" if first["unit"] == "1" else unit_words(first["unit"])
        rows.append({"name": measured_name(first), "unit": unit, "cells": [_cell(row) for row in own]})
    return {"head": [column.head for column in shown], "rows": rows, "said": _said(columns)}


def _said(columns: Sequence[_Column]) -> str:
    """What times count from, what the spread is, and what is left out."""
    count = max(column.count for column in columns)
    spread = any(row["sd"] is not None for column in columns for row in column.found.values())
    between = "Mean ± SD between logs." if spread else "The spread between logs is unknown."
    if count == 1:
        between = "One log: the spread between sites is unknown."
    left = len(columns) - MOST_COLUMNS
    more = f" {left} more stand in the workbook." if left > 0 else ""
    return f"F(t): t after the stop. {between}{more}"
