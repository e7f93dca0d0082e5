"""One line a recording, and a summary at the end, of ``tissueid inspect``."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap

from tissueid.documents.inspect import Trial, Watch
from tissueid.documents.measured import MeasuredLoop, MeasuredPush
from tissueid.flags import FLAGS, harm_rank

#: What a level asks for, and its colour.
WORDS = {"good": "keep", "look": "look", "repeat": "push again"}
COLOURS = {"good": None, "look": "yellow", "repeat": "red"}
#: Times after the stop that stand in the line [s].
TIMES_S = (1.0, 10.0)
DIGITS = 4
#: Columns of a line, and what goes before its second one.
WIDTH, INDENT = 100, "    "
#: Flags of a batch that are counted.
MOST_SHARED = 5


def names_of(described: Sequence[Trial]) -> list[tuple[str, str]]:
    """Heading, empty but before the first of several sheets of a file, and name of every recording.

    The folder of all need not stand in every line, nor the file of its sheets.

    ``described``: recordings of ``inspect --json``.
    """
    folder = _shared_folder(described)
    sheets = Counter(one.path for one in described)
    found = []
    before = None
    for one in described:
        path = one.path.removeprefix(folder)
        if one.sheet is None or sheets[one.path] == 1:
            found.append(("", recording_name(one, folder)))
        else:
            found.append((path if one.path != before else "", f"  {one.sheet}"))
        before = one.path
    return found


def recording_name(one: Trial | Watch, folder: str = "") -> str:
    """Path, without a folder in front, and sheet."""
    path = one.path.removeprefix(folder)
    return path if one.sheet is None else f"{path} [{one.sheet}]"


def _shared_folder(described: Sequence[Trial]) -> str:
    """The folder of all recordings; empty for a single one."""
    folders = {os.path.dirname(one.path) for one in described}  # noqa: PTH120 -- paths as they were typed
    if len(described) < 2 or "" in folders or len({Path(one).is_absolute() for one in folders}) > 1:
        return ""
    return os.path.join(os.path.commonpath(folders), "")  # noqa: PTH118


def recording_lines(one: Trial | Watch, name: str, *, alone: bool = True) -> list[str]:
    """Name, peak, depth, speed, ramp time, forces in the hold, verdict with its reason, in 100 columns.

    ``one``: a recording of ``inspect --json``; ``alone``: whether no summary follows that counts flags, and
    says what was kept all the same.
    """
    verdict, flags = one.verdict, len(one.flags)
    word = WORDS[verdict.level]
    if one.excluded is not None:
        word = f"excluded ({one.excluded})"
    elif verdict.reason is not None and (alone or verdict.level != "good"):
        word += f": {verdict.reason}"
    if flags and alone:
        word += f"  {flags} flag{'s' * (flags > 1)}"
    return _broken([name, _numbers(one), word])


def _broken(parts: Sequence[str]) -> list[str]:
    """Parts of a line, those that pass its width on lines of their own."""
    lines = [parts[0]]
    for part in parts[1:]:
        if len(lines[-1]) + 2 + len(part) <= WIDTH:
            lines[-1] += f"  {part}"
        else:
            lines += wrap(part, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT)
    return lines


def _numbers(one: Trial | Watch) -> str:
    measured = one.measured
    assert measured is not None  # noqa: S101  (what is refused has no such line)
    assert one.units is not None  # noqa: S101
    length, force = one.units.length, one.units.force
    holds = [(hold.push.peak.force_N, hold) for hold in measured.holds if hold.push is not None]
    hold = max(holds, key=lambda each: each[0])[1] if holds else None
    push = measured.push if hold is None else hold.push
    if push is None:
        return _looped(measured.loops, f"{force} {length}") if measured.loops else "nothing was loaded"
    parts = [_pushed(push, length, force)]
    if hold is None:
        parts.append("no hold")
    elif hold.control == "force":
        parts.append(f"creeps {hold.creep_mm:.3g} {length} in {hold.end_s - hold.start_s:.3g} s")
    else:
        at = {row.time_s: row.after_stop_N for row in hold.forces}
        known = [f"F({t:g} s) {at[t]:.{DIGITS}g}" for t in TIMES_S if at.get(t) is not None]
        parts.append(f"{', '.join(known)} {force}" if known else f"hold of {hold.end_s - hold.start_s:.3g} s")
    if len(measured.holds) > 1:
        parts.append(f"{len(measured.holds)} holds")
    return "; ".join(parts)


def _pushed(push: MeasuredPush, length: str, force: str) -> str:
    deep = push.travel_mm if push.depth_mm is None else push.depth_mm
    speed = f"{push.speed_mm_s:.3g} {length}/s in {push.ramp_time_s:.3g} s"
    return f"{push.peak.force_N:.{DIGITS}g} {force} at {deep:.3g} {length}, {speed}"


def _looped(loops: Sequence[MeasuredLoop], unit: str) -> str:
    last = loops[-1]
    area = "" if last.area_mJ is None else f", area {last.area_mJ:.{DIGITS}g} {unit}"
    return f"{len(loops)} loops, the last to {last.depth_mm:.3g}{area}"


def summary_lines(described: Sequence[Trial], refused: int) -> list[str]:
    """``49 read, 3 to look at, 1 to push again, 2 refused``, and how many share a flag, the worst first."""
    counts: Counter[str] = Counter(one.verdict.level for one in described)
    parts = [f"{len(described)} read"]
    for level, words in (("look", "to look at"), ("repeat", "to push again")):
        if counts[level]:
            parts.append(f"{counts[level]} {words}")
    if refused:
        parts.append(f"{refused} refused")
    shared = Counter(code for one in described for code in {flag.code for flag in one.flags})
    said = [code for code in sorted(shared, key=harm_rank) if shared[code] > 1 and code in FLAGS]
    several = [f"{shared[code]} {FLAGS[code].many}" for code in said[:MOST_SHARED]]
    counted = "; ".join([*several, "-v lists flags"]) if several else ""
    return [", ".join(parts), *wrap(counted, WIDTH, subsequent_indent=INDENT)]
