"""Measured quantities, no model, for the first screen: mean and spread between the logs of one program."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tissueid.digits import with_error
from tissueid.documents.identification import Specimen
from tissueid.documents.inspect import Units
from tissueid.documents.measured import Spread
from tissueid.report.wording import program_words, reach, unit_words

#: Names of the first screen in its order; the others stand in the workbook.
_WORDS: Mapping[str, str] = {
    "peak": "Peak force",
    "depth": "Depth",
    "travel": "Travel",
    "speed": "Speed",
    "ramp_time": "Ramp time",
    "force": "F({})",
    "force_at_depth": "F({})",
    "force_over_10s": "F({})/F(10 s)",
    "modulus_loading": "Modulus, loading",
    "modulus_held": "Modulus, held",
    "force_over_peak": "F({})/F_peak (depends on the ramp)",
    "relaxation_time": "One τ of the hold",
    "loop_area": "Loop area",
}
#: What knows the ramp stands in the workbook alone.
_ASIDE = {"force_over_peak", "force_at_depth"}
#: Columns that are shown, of holds or of programs.
MOST_COLUMNS = 2
#: A smaller standard deviation, as a share of the mean, is one of rounding.
_NO_SPREAD = 1e-9
NONE = "–"

#: Name of a number, and its time after the stop [s].
Key = tuple[str, float | None]


def measured_name(row: Spread) -> str:
    """Name of a measured number; of a force with its time after the stop."""
    words = _WORDS.get(row.name, str(row.name).replace("_", " "))
    return words if row.at is None else words.format(f"{row.at:g} {'mm' if row.time_s is None else 's'}")


@dataclass(frozen=True, slots=True)
class _Column:
    """Numbers of one hold of a program: mean, spread and reason by name and time."""

    head: str
    count: int
    found: Mapping[Key, Spread]


def _cell(row: Spread | None) -> tuple[str, bool]:
    """A cell, and whether it is a number."""
    if row is None or (row.mean is None and not row.reason):
        return NONE, True
    if row.mean is None:
        return str(row.reason), False
    spread = None if row.sd is None or row.sd <= _NO_SPREAD * abs(row.mean) else row.sd
    return with_error(row.mean, spread), True


def _ramps(rows: Iterable[Spread]) -> str:
    ends = [end for row in rows for end in row.ramp_time_s or ()]
    said = reach((min(ends), max(ends))) if ends else ""
    return said and f"ramp{'s' * (' to ' in said)} {said} s"


def _columns(rows: Sequence[Spread], units: Units) -> list[_Column]:
    """A column for each program and each of its holds."""
    places = list(dict.fromkeys((row.program, row.hold) for row in rows))
    several = len({program for program, _ in places}) > 1
    columns = []
    for place in places:
        own = [row for row in rows if (row.program, row.hold) == place]
        found: dict[Key, Spread] = {(row.name, row.time_s): row for row in own}
        count = max(row.count for row in own)
        held = len({hold for program, hold in places if program == place[0] and hold}) > 1
        name = f"Hold {place[1]}" if held and place[1] else "" if several else "Value"
        program = _program_words(found, units, count) if several else _ramps(own)
        columns.append(_Column(", ".join(filter(None, (name, program))), count, found))
    return columns


def _program_words(found: Mapping[Key, Spread], units: Units, count: int) -> str:
    speed, depth, travel = (found.get((name, None)) for name in ("speed", "depth", "travel"))
    depth = depth or travel
    if speed is None or depth is None or speed.mean is None or depth.mean is None:
        return f"n = {count}"
    return f"{program_words(speed.mean, depth.mean, units)}, n = {count}"


def measured_view(specimen: Specimen) -> dict[str, Any] | None:
    """The measured block: ``head``, ``rows`` (name, unit, cells) and ``said``; ``None`` without any."""
    told = [row for row in specimen.measured or () if row.name in _WORDS.keys() - _ASIDE]
    columns = _columns(told, specimen.units)
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
        unit = "" if first.unit == "1" else unit_words(first.unit)
        rows.append({"name": measured_name(first), "unit": unit, "cells": [_cell(row) for row in own]})
    return {"head": [column.head for column in shown], "rows": rows, "said": _said(columns)}


def _said(columns: Sequence[_Column]) -> str:
    """Sentence on the origin of times, the spread, and what is left out."""
    spread = any(row.sd is not None for column in columns for row in column.found.values())
    between = "Mean ± SD between logs." if spread else "The spread between logs is unknown."
    if max(column.count for column in columns) == 1:
        between = "One log: the spread between sites is unknown."
    left = len(columns) - MOST_COLUMNS
    more = f" {left} more stand in the workbook." if left > 0 else ""
    return f"F(t): t after the stop. {between}{more}"
