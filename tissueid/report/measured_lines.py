"""Measured quantities, no model, in a few lines: of one specimen, with the spread between its logs."""

from __future__ import annotations

from collections.abc import Sequence

from tissueid.digits import with_error
from tissueid.documents.measured import Spread

Row = Spread

#: Programs and holds that get lines of their own.
MOST_PLACES = 2

#: Names of forces in a hold, as they are written.
_FORCES = {
    "force": "F({t:g} s)",
    "force_over_10s": "F({t:g} s)/F(10 s)",
    "force_over_peak": "F({t:g} s)/F_peak",
}
#: Numbers of the one line, and times after the stop [s].
_BRIEF = ("peak", "depth")
_BRIEF_TIMES_S = (1.0, 10.0)
_PUSH = {"peak": "peak", "depth": "depth", "speed": "speed", "modulus_loading": "E loading"}


def measured_lines(rows: Sequence[Row]) -> list[str]:
    """Lines of a specimen's ``measured``; the number after the sign is the sd between logs.

    ``rows``: ``specimens[].measured`` of identification.json.
    """
    lines: list[str] = []
    found = {(row.program, row.hold) for row in rows if row.name != "loop_area"}
    places = sorted(found, key=lambda place: (place[0], place[1] == 0, place[1]))
    several = len({program for program, _ in places}) > 1
    for program, hold in places[:MOST_PLACES]:
        own = [row for row in rows if (row.program, row.hold) == (program, hold)]
        held = len({number for known, number in places if known == program and number}) > 1
        words = [f"program {program}"] * several + [f"hold {hold}"] * (held and hold > 0)
        lines += _of_hold(
            [row for row in own if row.name != "loop_area"], " " * bool(words) + ", ".join(words)
        )
    if len(places) > MOST_PLACES:
        lines.append(f"{len(places) - MOST_PLACES} more programs and holds stand in the report")
    areas = [row for row in rows if row.name == "loop_area" and row.mean is not None]
    if areas:
        lines.append(f"loop area {_said(areas[-1])}")
    return lines


def brief_measured_lines(rows: Sequence[Row]) -> list[str]:
    """One line of a specimen among many: its first program's push, and forces in newtons.

    ``rows``: ``specimens[].measured`` of identification.json.
    """
    first = [row for row in rows if row.program == 1 and row.hold <= 1 and row.mean is not None]
    said = [f"{_PUSH[row.name]} {_said(row)}" for row in first if row.name in _BRIEF]
    said += [
        f"{_FORCES['force'].format(t=row.time_s)} {_said(row)}"
        for row in first
        if row.name == "force" and row.time_s in _BRIEF_TIMES_S
    ]
    more = len({row.program for row in rows}) - 1
    told = f", {more} more program{'s' * (more > 1)}" * (more > 0)
    return [f"measured    {', '.join(said)}{told}"] if said else []


def _of_hold(rows: Sequence[Row], number: str) -> list[str]:
    pushed = [f"{_PUSH[row.name]} {_said(row)}" for row in rows if row.name in _PUSH]
    logs = max(row.count for row in rows)
    ramp = rows[0].ramp_time_s
    in_time = "" if ramp is None else f", ramp of {_between(ramp)} s"
    spread = f", ± sd of {logs} logs" if logs > 1 else ", one log: spread between sites unknown"
    lines = [f"measured{number}, no model{spread}{in_time}: {', '.join(pushed)}"]
    for name in ("force", "force_over_10s", "force_over_peak"):
        own = [row for row in rows if row.name == name and row.mean is not None]
        if own:
            parts = [f"{_FORCES[name].format(t=row.time_s)} {_said(row)}" for row in own]
            depends = "; depends on the ramp" if name == "force_over_peak" else ""
            lines.append(f"  {', '.join(parts)}{depends}")
    for reason in dict.fromkeys(row.reason for row in rows if row.reason):
        names = [_name(row) for row in rows if row.reason == reason]
        lines.append(f"  not pooled: {', '.join(names)}: {reason}")
    tau = next((row for row in rows if row.name == "relaxation_time" and row.mean is not None), None)
    if tau is not None:
        lines.append(f"  relaxation time of the hold, for its window only {_said(tau)}")
    return lines


def _name(row: Row) -> str:
    form = _FORCES.get(row.name)
    return row.name.replace("_", " ") if form is None else form.format(t=row.time_s)


def _said(row: Row) -> str:
    if row.mean is None:
        return "not pooled"
    unit = "" if row.unit == "1" else f" {row.unit}"
    return f"{with_error(row.mean, row.sd)}{unit}"


def _between(pair: Sequence[float]) -> str:
    low, high = (f"{value:.3g}" for value in pair)
    return low if low == high else f"{low} to {high}"
