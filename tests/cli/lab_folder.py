"""A folder as a lab has it: sound logs, damaged ones, and some in which nothing can be identified."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from tissueid.synth import DIALECTS, Hold, Log, Move, SyntheticLog, bluehill_csv, recipe, simulate

#: Lines above the first row of the writer's dialect: two entries, the rate, a blank one, names, units.
HEADER_LINES = 6


def sound_logs(repeats: int) -> list[SyntheticLog]:
    """Holds at two depths of three specimens."""
    logs = (
        Log("hold-8", (Move(8.0, 250.0), Hold(3.0)), repeats=repeats),
        Log("hold-4", (Move(4.0, 100.0), Hold(1.0)), repeats=repeats),
    )
    small = replace(recipe("paper-a-hold-100Hz"), specimens=3, logs=logs)
    return simulate(small, rng=np.random.default_rng(11))


def text_of(log: SyntheticLog) -> str:
    return bluehill_csv(log, dialect=DIALECTS["bare"], decimals=(3, 5, 4)).decode("ascii")


def edited(text: str, line: int, change: tuple[str, str]) -> str:
    """The text with one line changed; lines count from 1."""
    lines = text.split("\r\n")
    assert change[0] in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(*change, 1)
    return "\r\n".join(lines)


def damaged_files(log: SyntheticLog) -> dict[str, tuple[bytes, int | None, str]]:
    """Name -> bytes, the line that must be named, and a word of the reason."""
    text = text_of(log)
    rows = text.split("\r\n")
    shuffled = "\r\n".join([*rows[:60], rows[90], *rows[60:]])
    return {
        "damaged-mark.csv": (edited(text, 40, (".", ".1.")).encode(), 40, "decimal mark"),
        "damaged-unit.csv": (text.replace("(N)", "(zork)").encode(), HEADER_LINES - 1, "zork"),
        "damaged-order.csv": (shuffled.encode(), 62, "time falls"),
        "damaged-cells.csv": (edited(text, 77, (",", ",7,")).encode(), 77, "4 cells"),
        "damaged-zip.xlsx": (b"PK\x03\x04" + text.encode(), None, "workbook"),
    }


def unidentifiable_files(log: SyntheticLog) -> dict[str, tuple[bytes, str]]:
    """Name -> bytes, and the code or words of the reason: nothing touched, a dead cell, one slow ramp."""
    rng = np.random.default_rng(5)
    air = np.round(rng.normal(0.0, 0.3, log.force_N.size), 4)
    ramp = replace(
        recipe("paper-a-hold-100Hz"), specimen="ramp", rate_Hz=10.0, logs=(Log("ramp", (Move(8.0, 10.0),)),)
    )
    (slow,) = simulate(ramp, rng=rng)
    return {
        "no-contact.csv": (text_of(replace(log, specimen="air", force_N=air)).encode(), "no_contact"),
        "dead-cell.csv": (text_of(replace(log, specimen="dead", force_N=0.0 * air)).encode(), "no_contact"),
        "one-ramp.csv": (text_of(slow).encode(), "not identified"),
    }


def write_lab(folder: Path, *, repeats: int) -> int:
    """Write the folder; returns how many logs are sound."""
    folder.mkdir()
    logs = sound_logs(repeats)
    for log in logs:
        (folder / f"{log.name}.csv").write_text(text_of(log), encoding="ascii", newline="")
    files = {name: one[0] for name, one in (damaged_files(logs[0]) | unidentifiable_files(logs[0])).items()}
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return len(logs)
