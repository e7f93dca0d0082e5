"""What `measured` says of real recordings, against hand-made labels and against the physics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tissueid.errors import InputError
from tissueid.ingest import ReadOptions, read_each
from tissueid.inspection import describe_trial

MUSCLE = ReadOptions(columns={"time": "Time", "displacement": "L", "force": "F"})
TIMES = ("1", "10")


def inspected(path: Path) -> dict[str, dict[str, Any]]:
    """What is said of every recording of a file, by its sheet."""
    options = MUSCLE if "muscle" in path.parent.name else ReadOptions()
    found = {}
    for trial in read_each(path, options):
        document = None if isinstance(trial, InputError) else describe_trial(trial)
        if isinstance(document, dict):
            found[document["sheet"] or ""] = document
    return found


def held(document: dict[str, Any] | None, label: dict[str, Any]) -> dict[str, Any] | None:
    """The measured hold that covers most of a label's."""
    low, high = label["t_start"][0], label["t_end"][1]
    holds = [] if document is None else document["measured"]["holds"]
    covered = [
        one for one in holds if min(one["end_s"], high) - max(one["start_s"], low) > 0.5 * (high - low)
    ]
    return covered[0] if covered else None


def agrees(hold: dict[str, Any] | None, label: dict[str, Any]) -> bool:
    """Whether 1 - F/F_peak at 1 s and 10 s after the peak is within the labels' tolerance."""
    wanted = label.get("relaxed_minus_base") or label["relaxed"]
    if hold is None or hold["push"] is None:
        return False
    forces = {f"{one['time_s']:g}": one["after_peak_N"] for one in hold["forces"]}
    peak = hold["push"]["peak"]["force_N"]
    return all(
        forces[time] is not None and abs(1.0 - forces[time] / peak - wanted[time][0]) <= wanted[time][1]
        for time in TIMES
        if time in wanted
    )


def test_forces_in_the_hold_agree_with_hand_labels(shared_data: Path) -> None:
    labels = json.loads((shared_data / "bench.json").read_text(encoding="utf-8"))
    files: dict[str, dict[str, dict[str, Any]]] = {}
    wrong, count = [], 0
    for key, label in labels.items():
        name, _, sheet = key.partition("#")
        for hold in label.get("holds") or ():
            if hold["control"] != "position":
                continue
            if name not in files:
                files[name] = inspected(shared_data / name)
            count += 1
            if not agrees(held(files[name].get(sheet), hold), hold):
                wrong.append(key)
    assert count >= 30
    assert len(wrong) <= 0.03 * count, wrong


@pytest.mark.parametrize("group", ["AvgRelaxed", "AvgpCa4.4"])
def test_force_ten_seconds_after_one_stretch_does_not_know_the_ramp(shared_data: Path, group: str) -> None:
    forces, shares = [], []
    for seconds in ("0.1", "1", "10", "100"):
        (document,) = inspected(shared_data / "muscle-ramp-hold-mit" / f"{group}_{seconds}s.csv").values()
        (hold,) = document["measured"]["holds"]
        at = {one["time_s"]: one for one in hold["forces"]}
        forces.append(at[10.0]["after_stop_N"])
        shares.append(at[1.0]["over_peak"])
        assert not at[1.0]["beyond_ramp"] or seconds == "0.1"
        assert at[10.0]["beyond_ramp"] == (seconds in {"0.1", "1"})
    middle = 0.5 * (max(forces) + min(forces))
    assert max(forces) - min(forces) <= 0.2 * middle
    # the same stretch, and yet the share of the peak says four different things
    assert max(shares) > 1.6 * min(shares)
