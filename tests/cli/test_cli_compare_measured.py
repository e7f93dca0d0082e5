"""``compare`` of recordings: what was measured beside each other, and what may not be compared."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import run, write_log

from tissueid.store.schema import check

MUSCLE = ("--columns", "time=Time,displacement=L,force=F")


def test_recordings_of_one_program_are_compared(tmp_path: Path) -> None:
    one, other = write_log(tmp_path / "a.csv"), write_log(tmp_path / "b.csv", force_times=1.5)
    target = tmp_path / "pair.json"
    ended = run("compare", one, other, "--json", "-o", target)
    document = ended.json()
    check(document, "measured-contrast", where="pair.json")
    assert json.loads(target.read_bytes()) == document
    (pair,) = document["pairs"]
    rows = {(row["name"], row["time_s"]): row for row in pair["numbers"]}
    assert rows["peak", None]["ratio"] == pytest.approx(1.5, rel=0.01)
    assert rows["force", 1.0]["ratio"] == pytest.approx(1.5, rel=0.01)
    assert rows["force_over_peak", 1.0]["reason"] is None
    assert "force at 1 s [N]" in run("compare", one, other).stdout


def test_a_share_of_the_peak_is_not_compared_between_ramps(shared_data: Path) -> None:
    folder = shared_data / "muscle-ramp-hold-mit"
    paths = [folder / f"AvgRelaxed_{seconds}s.csv" for seconds in ("0.1", "100")]
    ended = run("compare", *paths, *MUSCLE, "--json")
    (pair,) = ended.json()["pairs"]
    rows = {(row["name"], row["time_s"]): row for row in pair["numbers"]}
    for name in ("force_over_peak", "force", "force_over_10s"):
        assert rows[name, 1.0]["ratio"] is None
        assert "depends on the ramp" in rows[name, 1.0]["reason"]
    assert "not compared: peak" in run("compare", *paths, *MUSCLE).stdout


def test_a_recording_beside_a_fit_or_alone_is_a_question(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.csv")
    assert "name a second" in run("compare", log).stderr
    assert "no such bundle" in run("compare", log, tmp_path / "b.h5").stderr
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "identification.json").write_text("{}", encoding="ascii")
    assert "compare recordings, or fits" in run("compare", log, tmp_path / "out").stderr
