"""One sheet, block, specimen or member picked; readers and marks named; a pattern that fits nothing."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import QUICK, run, write_log

from tissueid.ingest import RECIPES, forget_readers
from tissueid.synth import EXPORTS, Hold, Log, Move, Recipe, SyntheticLog, simulate
from tissueid.synth.machines import mach1_text, shimadzu_text, zwick_workbook

SMALL = Recipe(
    "small",
    (Log("hold", (Move(8.0, 300.0), Hold(2.0)), repeats=3),),
    rate_Hz=50.0,
    static=(60.0,),
    sigma_N=0.1,
)


@pytest.fixture(scope="module")
def logs() -> list[SyntheticLog]:
    return simulate(SMALL, rng=np.random.default_rng(3))


def inspected(*args: str | Path) -> list[dict[str, Any]]:
    ended = run("inspect", *args, "--json")
    document: list[dict[str, Any]] = ended.json()
    return document


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, logs: list[SyntheticLog]) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("sheets")
    found = {name: folder / f"synthetic.{name}" for name in ("xlsx", "txt", "csv", "zip")}
    found["xlsx"].write_bytes(zwick_workbook(logs))
    found["txt"].write_bytes(mach1_text(logs))
    found["csv"].write_bytes(shimadzu_text(logs))
    with zipfile.ZipFile(found["zip"], "w") as archive:
        for i, log in enumerate(logs, 1):
            archive.writestr(f"log {i}.csv", EXPORTS["bare"].write(log))
        archive.writestr("book.xlsx", zwick_workbook(logs))
    return found


PICKED = [
    ("xlsx", "synthetic hold-2", ["synthetic hold-2"]),
    ("txt", "3: Stress Relaxation", ["3: Stress Relaxation"]),
    ("txt", "3", ["3: Stress Relaxation"]),
    ("csv", "synthetic hold-3", ["synthetic hold-3"]),
    ("zip", "log 2.csv", ["log 2.csv"]),
    ("zip", "book.xlsx::synthetic hold-1", ["book.xlsx::synthetic hold-1"]),
    ("zip", "book.xlsx", [f"book.xlsx::synthetic hold-{i}" for i in (1, 2, 3)]),
]


@pytest.mark.parametrize(("kind", "sheet", "expected"), PICKED)
def test_one_sheet_is_picked_by_option_or_behind_the_file(
    files: dict[str, Path], kind: str, sheet: str, expected: list[str]
) -> None:
    assert [one["sheet"] for one in inspected(files[kind], "--sheet", sheet)] == expected
    assert [one["sheet"] for one in inspected(f"{files[kind]}::{sheet}")] == expected


def test_a_sheet_that_is_not_there_is_refused_with_those_that_are(files: dict[str, Path]) -> None:
    ended = run("inspect", f"{files['xlsx']}::nothing")
    assert ended.code == 3
    assert "unknown_sheet" in ended.stderr
    assert "'synthetic hold-1', 'synthetic hold-2', 'synthetic hold-3'" in ended.stderr


def test_a_file_whose_name_has_the_mark_is_that_file(tmp_path: Path, logs: list[SyntheticLog]) -> None:
    path = tmp_path / "a::b.csv"
    path.write_bytes(EXPORTS["bare"].write(logs[0]))
    (one,) = inspected(path)
    assert one["path"] == str(path)


def test_one_picked_sheet_is_fitted(files: dict[str, Path], tmp_path: Path) -> None:
    ended = run("fit", f"{files['txt']}::2", *QUICK, "-o", tmp_path / "out", "--json")
    assert ended.code in (0, 4), ended.stderr
    (entry,) = ended.json()["provenance"]["inputs"]
    assert (entry["sheet"], entry["recipe"]) == ("2: Stress Relaxation", "mach-1")


def test_a_pattern_that_fits_nothing_is_a_wrong_option(files: dict[str, Path], tmp_path: Path) -> None:
    for args in (("inspect",), ("fit", *QUICK, "-o", tmp_path / "out")):
        ended = run(*args, files["xlsx"], "--specimen-by", r"cow(\d)")
        assert ended.code == 2
        assert "'cow(\\\\d)'" in ended.stderr
        assert "synthetic hold-1" in ended.stderr
    assert not (tmp_path / "out" / "identification.json").exists()


def test_a_pattern_that_fits_some_names_the_others(files: dict[str, Path]) -> None:
    ended = run("inspect", files["xlsx"], "--specimen-by", "hold-[12]")
    assert ended.code == 0
    assert "synthetic hold-3" in ended.stderr
    assert "synthetic hold-1" not in ended.stderr


def test_a_reader_that_is_none_names_every_one(files: dict[str, Path]) -> None:
    ended = run("inspect", files["txt"], "--recipe", "nope")
    assert ended.code == 2
    for name in RECIPES:
        assert name in ended.stderr


def test_inspect_says_why_a_reader_matched(files: dict[str, Path]) -> None:
    ended = run("inspect", files["txt"], "-v")
    assert "Read as mach-1 (sure to 100%)".lower() in ended.stdout.lower()
    assert "because the first line is <Mach-1 File>" in ended.stdout


def test_marks_that_the_text_leaves_open_can_be_stated(tmp_path: Path) -> None:
    path = tmp_path / "open.csv"
    rows = "".join(f"{i + 1}.000;{i + 2}.500;{i + 3}.250\n" for i in range(20))
    path.write_text("Time;Extension;Load\n(s);(mm);(N)\n" + rows)
    refused = run("inspect", path)
    assert refused.code == 3
    assert "--decimal" in refused.stderr
    (one,) = inspected(path, "--decimal", "point", "--delimiter", "semicolon")
    assert one["first"]["displacement_mm"] == 2.5


def test_every_dialect_is_listed_with_what_it_is() -> None:
    ended = run("synth", "--dialects")
    assert ended.code == 0
    for name, export in EXPORTS.items():
        assert f"{name} " in ended.stdout
        assert export.description in ended.stdout


def test_a_dialect_of_another_machine_is_written_and_fitted(tmp_path: Path) -> None:
    folder = tmp_path / "synthetic"
    ended = run("synth", "paper-a-22", "-o", folder, "--rate", "10", "--dialect", "mts-793-de")
    assert ended.code == 0
    described = inspected(folder)
    assert len(described) == 22
    assert {one["recipe"] for one in described} == {"mts-793"}


def test_a_broken_installed_reader_is_warned_of_and_the_files_are_read(
    tmp_path: Path, logs: list[SyntheticLog], monkeypatch: pytest.MonkeyPatch
) -> None:
    info = tmp_path / "site" / "broken-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[tissueid.readers]\nmine = no_such_module_at_all:RECIPE\n")
    path = tmp_path / "synthetic.csv"
    path.write_bytes(EXPORTS["bare"].write(logs[0]))
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(info.parent))
        forget_readers()
        ended = run("inspect", path, "-v")
    forget_readers()
    assert ended.code == 0
    assert "bluehill-csv" in ended.stdout
    assert "warning: the installed reader 'mine (no_such_module_at_all:RECIPE)'" in ended.stderr


def test_a_mean_curve_is_left_out_with_one_line(tmp_path: Path) -> None:
    write_log(tmp_path / "Mean.csv")
    write_log(tmp_path / "cow.csv")
    ended = run("fit", tmp_path, "-o", tmp_path / "out", *QUICK)
    assert ended.code == 0
    (line,) = (line for line in ended.stdout.splitlines() if line.startswith("excluded"))
    assert "Mean.csv" in line
    assert "no specimen" in line
    assert "1 log," in ended.stdout
