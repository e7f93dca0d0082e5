"""Words on real recordings, held against hand-made labels and against the physics."""

import contextlib
import importlib.util
import io
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from tissueid.cli.main import main
from tissueid.errors import InputError
from tissueid.ingest import ReadOptions, read_each
from tissueid.inspection import describe_segmented, segmented
from tissueid.trial import Segmentation

KINDS = ("right", "near", "wrong", "absent")


def inspected(path: Path) -> str:
    """The document that the command prints of one file; a refusal is a document as well."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
        main(["inspect", str(path), "--json"])
    return said.getvalue()


def told(shared_data: Path, out: Path) -> str:
    """The script's table and its list of what is wrong, of every labelled file."""
    labels = shared_data / "bench.json"
    keys = json.loads(labels.read_text(encoding="utf-8"))
    for number, name in enumerate(sorted({key.partition("#")[0] for key in keys})):
        (out / f"{number}.json").write_text(inspected(shared_data / name), encoding="utf-8")
    spec = importlib.util.spec_from_file_location("bench_check", shared_data / "bench_check.py")
    script = importlib.util.module_from_spec(spec)
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        # nothing is written beside the recordings
        patch.setattr(sys, "dont_write_bytecode", True)
        spec.loader.exec_module(script)
        patch.setattr(sys, "argv", ["bench_check", str(labels), str(out)])
        script.main()
    return said.getvalue()


def table(text: str) -> dict[str, Counter[str]]:
    """Rows of the table: how many labels of a kind were met, and how."""
    found = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and len(cells) == 2 + len(KINDS) and cells[1].isdigit():
            found[cells[0].strip("*")] = Counter(dict(zip(KINDS, map(int, cells[2:]), strict=True)))
    return found


def share(counts: Counter[str], kind: str = "right") -> float:
    return counts[kind] / counts.total()


# the script leaves its files to be closed by the collector
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_recordings_are_read_and_divided_as_their_labels_say(shared_data: Path, tmp_path: Path) -> None:
    text = told(shared_data, tmp_path)
    rows = table(text)
    assert rows["all"].total() >= 500, text
    assert share(rows["all"], "wrong") <= 0.01, text
    for kind in ("load ramp end", "load speed", "hold start"):
        assert share(rows[kind]) >= 0.95, text
    contact = sum((counts for kind, counts in rows.items() if kind.startswith("contact ")), Counter())
    assert share(contact) >= 0.95, text
    assert rows["no rupture claimed"]["wrong"] == 0, text
    assert share(rows["read without help"]) >= 0.93, text


MUSCLE = ReadOptions(columns={"time": "Time", "displacement": "L", "force": "F"})
TIMES = ("1", "10")


def described(path: Path) -> dict[str, dict[str, Any]]:
    """Documents of every recording of a file, by its sheet."""
    options = MUSCLE if "muscle" in path.parent.name else ReadOptions()
    found = {}
    for trial in read_each(path, options):
        divided = None if isinstance(trial, InputError) else segmented(trial)
        if isinstance(divided, Segmentation):
            found[trial.source.sheet or ""] = describe_segmented(trial, divided)
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
    """True where 1 - F/F_peak at 1 s and 10 s after the peak is within the labels' tolerance."""
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
                files[name] = described(shared_data / name)
            count += 1
            if not agrees(held(files[name].get(sheet), hold), hold):
                wrong.append(key)
    assert count >= 30
    assert len(wrong) <= 0.03 * count, wrong


@pytest.mark.parametrize("group", ["AvgRelaxed", "AvgpCa4.4"])
def test_force_ten_seconds_after_one_stretch_does_not_know_the_ramp(shared_data: Path, group: str) -> None:
    forces, shares = [], []
    for seconds in ("0.1", "1", "10", "100"):
        (document,) = described(shared_data / "muscle-ramp-hold-mit" / f"{group}_{seconds}s.csv").values()
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
