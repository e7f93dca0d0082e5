"""Measured numbers of two sides beside each other, and which of them may not be compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, product
from typing import Any

from tissueid.documents.measured import Spread
from tissueid.measured.spread import programs, ramp_reason

#: Numbers that say what was done to the tissue, whatever it answered.
_OF_THE_PROGRAM = ("depth", "travel", "speed", "ramp_time")
#: Depths within this share are equal.
SAME_DEPTH = 0.1


def measured_pairs(sides: Sequence[tuple[str, Sequence[Spread]]]) -> list[dict[str, Any]]:
    """All pairs of sides, each with every number that both have.

    ``sides``: what was measured of each, with the spread between its logs.  Returns ``pairs`` of
    ``schemas/measured-contrast.schema.json``.
    """
    return [
        {"one": one[0], "other": other[0], "numbers": _numbers(one[1], other[1])}
        for one, other in combinations(sides, 2)
    ]


def _key(row: Spread) -> tuple[str, int, float | None]:
    return row.name, row.hold, row.time_s


def _numbers(one: Sequence[Spread], other: Sequence[Spread]) -> list[dict[str, Any]]:
    rows = []
    for own, its in _matched(_by_program(one), _by_program(other)):
        found = {_key(row): row for row in its}
        depths = [{row.hold: row.mean for row in every if row.name == "depth"} for every in (own, its)]
        rows += [_number(row, found[_key(row)], depths) for row in own if _key(row) in found]
    return rows


def _by_program(rows: Sequence[Spread]) -> list[list[Spread]]:
    numbers = dict.fromkeys(row.program for row in rows)
    return [[row for row in rows if row.program == number] for number in numbers]


def _matched(
    one: Sequence[list[Spread]], other: Sequence[list[Spread]]
) -> Iterator[tuple[list[Spread], list[Spread]]]:
    """Programs of both sides that ran alike; where each side has one, these, whatever they are."""
    if len(one) == len(other) == 1:
        yield one[0], other[0]
        return
    for own, its in product(one, other):
        pushes = [_push(own), _push(its)]
        if None not in pushes and len(programs([push for push in pushes if push is not None])) == 1:
            yield own, its


def _push(rows: Sequence[Spread]) -> tuple[float, float] | None:
    """Mean speed and depth of a program."""
    means = {row.name: row.mean for row in rows if row.hold <= 1 and row.mean is not None}
    depth = means.get("depth", means.get("travel"))
    return None if depth is None or "speed" not in means else (means["speed"], depth)


def _number(one: Spread, other: Spread, depths: Sequence[Mapping[int, float | None]]) -> dict[str, Any]:
    reason = one.reason or other.reason or _reason(one, other, depths)
    ratio = None
    if not reason and one.mean and other.mean is not None:
        ratio = other.mean / one.mean
    return {
        "name": one.name,
        "unit": one.unit,
        "program": one.program,
        "hold": one.hold,
        "time_s": one.time_s,
        "one": _side(one),
        "other": _side(other),
        "ratio": ratio,
        "reason": reason or None,
    }


def _side(row: Spread) -> dict[str, Any]:
    return {
        "mean": row.mean,
        "sd": row.sd,
        "count": row.count,
        "ramp_time_s": None if row.ramp_time_s is None else list(row.ramp_time_s),
    }


def _reason(one: Spread, other: Spread, depths: Sequence[Mapping[int, float | None]]) -> str:
    """Why two numbers are not compared; empty where they are."""
    if one.name in _OF_THE_PROGRAM or one.name == "loop_area":
        return ""
    times = [*(one.ramp_time_s or ()), *(other.ramp_time_s or ())]
    reason = ramp_reason(one.time_s, times, peak=one.name == "force_over_peak")
    if reason:
        return reason
    deep = [found.get(one.hold) for found in depths]
    if one.unit == "N" and deep[0] and deep[1] and abs(deep[1] - deep[0]) > SAME_DEPTH * abs(deep[0]):
        return f"forces at {deep[0]:.3g} and {deep[1]:.3g} mm of depth"
    return ""
