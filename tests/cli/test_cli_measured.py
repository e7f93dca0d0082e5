"""What `inspect`, and no command at all, says of recordings: a line each, tables, a verdict."""

from __future__ import annotations

import csv
import io
import os
import subprocess
import sys
from pathlib import Path

import openpyxl
import pytest
from command_line import REPOSITORY, run, write_log

from tissueid.store.schema import first_problem


def test_no_command_is_inspect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = write_log(tmp_path / "one.csv")
    named, plain = run("inspect", log), run(log)
    assert (plain.code, plain.stdout) == (0, named.stdout)
    assert "F(1 s)" in plain.stdout
    assert "keep" in plain.stdout
    assert all(len(line) <= 100 for line in plain.stdout.splitlines()[1:])
    # options before the file, a folder, and a sheet's mark
    assert run("--json", log).json() == run("inspect", log, "--json").json()
    assert run(tmp_path).stdout == run("inspect", tmp_path).stdout
    monkeypatch.chdir(tmp_path)
    assert run("one.csv").code == 0
    assert "missing.csv" in run("missing.csv").stderr


def test_a_command_goes_before_a_file_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_log(Path("doctor"))
    assert "F(1 s)" not in run("doctor").stdout
    assert "F(1 s)" in run("./doctor").stdout
    assert "No such command" in run("inspct").stderr


def test_a_look_at_a_file_loads_no_compiler(tmp_path: Path) -> None:
    log = write_log(tmp_path / "one.csv")
    code = (
        "import sys; from tissueid.cli.main import main; "
        f"code = main([{str(log)!r}, '-q']); "
        "print(code, sorted({'numba', 'scipy.optimize', 'lmfit', 'emcee'} & set(sys.modules)))"
    )
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
    )
    assert ended.stdout.strip() == "0 []"


def test_every_recording_has_a_line_and_all_a_summary(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        write_log(tmp_path / name)
    (tmp_path / "bad.csv").write_text("no table here\n", encoding="ascii")
    ended = run(tmp_path)
    lines = ended.stdout.splitlines()
    assert ended.code == 7
    assert [line.split("  ")[0] for line in lines[:2]] == ["a.csv", "b.csv"]
    assert lines[2:] == ["2 read, 1 refused", "2 start in contact; -v lists flags"]
    assert all(len(line) <= 100 for line in lines)
    assert "read as bluehill-csv" in run(tmp_path, "-v").stdout


def test_tables_hold_what_the_json_says(tmp_path: Path) -> None:
    log = write_log(tmp_path / "one.csv")
    table, book = tmp_path / "m.csv", tmp_path / "m.xlsx"
    (document,) = run(log, "--json", "--csv", table, "--xlsx", book).json()
    assert first_problem([document], "inspect") is None
    (hold,) = document["measured"]["holds"]
    (row,) = csv.DictReader(io.StringIO(table.read_text(encoding="utf-8")))
    at = {one["time_s"]: one for one in hold["forces"]}
    assert float(row["force_1s_N"]) == at[1.0]["after_stop_N"]
    assert float(row["peak_N"]) == hold["push"]["peak"]["force_N"]
    assert row["force_100s_N"] == ""
    assert row["verdict"] == document["verdict"]["level"]
    head, cells = openpyxl.load_workbook(book).active.iter_rows(values_only=True)
    assert dict(zip(head, cells, strict=True))["force_1s_N"] == pytest.approx(at[1.0]["after_stop_N"])


def test_a_softer_push_is_said(tmp_path: Path) -> None:
    for number, times in enumerate((1.0, 1.01, 0.99, 0.8)):
        write_log(tmp_path / f"{number}.csv", label="liver", force_times=times)
    verdicts = [one["verdict"] for one in run(tmp_path, "--json").json()]
    assert [one["level"] for one in verdicts] == ["good", "good", "good", "look"]
    assert "19 % softer than the last push, spread 1 %" in verdicts[-1]["reason"]


def test_sheets_stand_below_their_file(shared_data: Path) -> None:
    book = shared_data / "zwick-meat-gpl3" / "230403_C_Indentation_relaxation_500N_force.xlsx"
    lines = run(book).stdout.splitlines()
    assert lines[0] == book.name
    assert lines[1].startswith("  230403-FF1A  0.8588 N at 1.85 mm, 1.5 mm/s in 1.4 s; F(1 s) ")
    assert all(len(line) <= 100 for line in lines[1:])
    assert "start in contact" in lines[-2] + lines[-1]
