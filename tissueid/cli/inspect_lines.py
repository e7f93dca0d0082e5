"""One line a recording, and one at the end, of ``tissueid inspect``."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

__all__ = ["COLOURS", "recording_line", "shared_folder", "summary_line"]

#: What a level asks for, and its colour.
WORDS = {"good": "keep", "look": "look", "repeat": "push again"}
COLOURS = {"good": None, "look": "yellow", "repeat": "red"}
#: Times after the stop that stand in the line [s].
TIMES_S = (1.0, 10.0)
DIGITS = 4


def shared_folder(described: Sequence[Mapping[str, Any]]) -> str:
    """The folder of all recordings, which need not stand in every line; empty for a single one."""
    folders = {os.path.dirname(one["path"]) for one in described}  # noqa: PTH120 -- paths as they were typed
    if len(described) < 2 or "" in folders or len({Path(one).is_absolute() for one in folders}) > 1:
        return ""
    return os.path.join(os.path.commonpath(folders), "")  # noqa: PTH118


def recording_line(one: Mapping[str, Any], folder: str = "") -> str:
    """Name, peak, depth, speed, ramp time, forces in the hold, verdict with its reason, flags.

    Parameters
    ----------
    one : mapping
        A recording of ``inspect --json``.
    folder : str
        Left off the path.
    """
    path = one["path"].removeprefix(folder)
    name = path if one["sheet"] is None else f"{path} [{one['sheet']}]"
    verdict, flags = one["verdict"], len(one["flags"])
    word = WORDS[verdict["level"]]
    if one["excluded"] is not None:
        word = f"excluded ({one['excluded']})"
    elif verdict["reason"] is not None:
        word += f": {verdict['reason']}"
    counted = f"{flags} flag{'s' * (flags > 1)}" if flags else ""
    return "  ".join(part for part in (name, _numbers(one), word, counted) if part)


def _numbers(one: Mapping[str, Any]) -> str:
    measured = one["measured"]
    length, force = (one["units"][key] for key in ("length", "force"))
    holds = [hold for hold in measured["holds"] if hold["push"] is not None]
    hold = max(holds, key=lambda each: each["push"]["peak"]["force_N"], default=None)
    push = measured["push"] if hold is None else hold["push"]
    if push is None:
        return _looped(measured["loops"], f"{force} {length}") if measured["loops"] else "nothing was loaded"
    parts = [_pushed(push, length, force)]
    if hold is None:
        parts.append("no hold")
    elif hold["control"] == "force":
        parts.append(f"creeps {hold['creep_mm']:.3g} {length} in {hold['end_s'] - hold['start_s']:.3g} s")
    else:
        at = {row["time_s"]: row["after_stop_N"] for row in hold["forces"]}
        known = [f"F({t:g} s) {at[t]:.{DIGITS}g} {force}" for t in TIMES_S if at.get(t) is not None]
        parts.append(", ".join(known) or f"hold of {hold['end_s'] - hold['start_s']:.3g} s")
    if len(measured["holds"]) > 1:
        parts.append(f"{len(measured['holds'])} holds")
    return "; ".join(parts)


def _pushed(push: Mapping[str, Any], length: str, force: str) -> str:
    deep = push["travel_mm"] if push["depth_mm"] is None else push["depth_mm"]
    speed = f"{push['speed_mm_s']:.3g} {length}/s in {push['ramp_time_s']:.3g} s"
    return f"{push['peak']['force_N']:.{DIGITS}g} {force} at {deep:.3g} {length}, {speed}"


def _looped(loops: Sequence[Mapping[str, Any]], unit: str) -> str:
    last = loops[-1]
    area = "" if last["area_mJ"] is None else f", area {last['area_mJ']:.{DIGITS}g} {unit}"
    return f"{len(loops)} loops, the last to {last['depth_mm']:.3g}{area}"


def summary_line(described: Sequence[Mapping[str, Any]], refused: int) -> str:
    """``49 read, 3 to look at, 1 to push again, 2 refused``."""
    counts = Counter(one["verdict"]["level"] for one in described)
    parts = [f"{len(described)} read"]
    for level, words in (("look", "to look at"), ("repeat", "to push again")):
        if counts[level]:
            parts.append(f"{counts[level]} {words}")
    if refused:
        parts.append(f"{refused} refused")
    return ", ".join(parts)
