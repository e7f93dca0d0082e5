"""What is read and fitted together: sheets, labels, patterns and names; nothing is pooled silently."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import QUICK, read_json, run, write_log, write_workbook

from tissueid.ingest import forget_readers
from tissueid.synth import EXPORTS, Hold, Log, Move, Recipe, simulate
from tissueid.synth.machines import mach1_text, shimadzu_text, zwick_workbook


def fit(out: Path, *args: str | Path) -> Any:
    return run("fit", *args, "-o", out, "--json", code={0, 4}).json()


def logs_of(document: dict[str, Any]) -> dict[str, int]:
    return {one["specimen"]: len(one["trials"]) for one in document["specimens"]}


def test_files_with_one_header_label_are_one_specimen(tmp_path):
    for number in (1, 2, 3):
        write_log(tmp_path / "lab" / f"log-{number}.csv", label="kidney 7", force_times=1.0 + 0.02 * number)
    document = fit(tmp_path / "out", tmp_path / "lab", *QUICK)
    assert logs_of(document) == {"kidney 7": 3}
    assert document["specimens"][0]["model"]["static_pooling"] == "scaled"
    assert (tmp_path / "out" / "bundle-kidney_7.h5").exists()
    assert {entry["specimen"] for entry in document["provenance"]["inputs"]} == {"kidney 7"}


@pytest.mark.parametrize(
    ("files", "pattern", "found"),
    [
        # as short as tells them apart
        (
            {"monday/log": None, "friday/log": None, "friday/other": None},
            (),
            {"friday/log": 1, "other": 1, "monday/log": 1},
        ),
        # the first group of a pattern wins over the header
        ({"cow3_a": "a", "cow3_b": "b", "cow4_a": "c"}, (r"(cow\d+)_",), {"cow3": 2, "cow4": 1}),
        # what it does not fit is grouped with nothing
        (dict.fromkeys(("x", "y", "cow1_a", "cow1_b"), "same"), (r"cow\d",), {"cow1": 2, "x": 1, "y": 1}),
    ],
    ids=["no label", "a group", "some do not fit"],
)
def test_files_are_one_specimen_by_label_or_pattern_only(tmp_path, files, pattern, found):
    for name, label in files.items():
        write_log(tmp_path / "lab" / f"{name}.csv", label=label)
    out = tmp_path / "out"
    document = fit(out, tmp_path / "lab", *QUICK, *(("--specimen-by", *pattern) if pattern else ()))
    assert logs_of(document) == found
    assert not (out / "bundle.h5").exists()
    assert len(list(out.glob("bundle-*.h5"))) == len(found)
    for one in document["specimens"]:
        assert (one["model"]["static_pooling"] == "shared") == (len(one["trials"]) == 1)


def test_each_sheet_is_its_own_specimen(tmp_path):
    document = fit(tmp_path / "out", write_workbook(tmp_path / "book.xlsx", "left", "right"), *QUICK)
    assert logs_of(document) == {"left": 1, "right": 1}
    assert [one["trials"][0]["sheet"] for one in document["specimens"]] == ["left", "right"]


@pytest.mark.parametrize("pooling", ["scaled", "partial", "shared"])
def test_the_pooling_asked_for_is_the_one_reported(tmp_path, pooling):
    for number in (1, 2):
        write_log(tmp_path / "lab" / f"log-{number}.csv", force_times=1.0 + 0.1 * number)
    document = fit(tmp_path / "out", tmp_path / "lab", "--static", pooling, *QUICK)
    (one,) = document["specimens"]
    assert one["model"]["static_pooling"] == pooling
    assert document["provenance"]["options"]["static"] == pooling
    gains = [trial["gain"] for trial in one["trials"]]
    if pooling != "shared":
        # the same log times 1.1 and 1.2: gains stand in that ratio, but for the shrinkage of two logs
        assert gains[1] / gains[0] == pytest.approx(1.2 / 1.1, rel=0.01)
    else:
        assert gains == [1.0, 1.0]


@pytest.mark.parametrize(("branches", "degree"), [(1, 2), (2, 1), (3, 0)])
def test_branches_and_degree_asked_for_are_fitted_and_reported(tmp_path, branches, degree):
    log = write_log(tmp_path / "log.csv")
    args = ["--branches", str(branches), "--stiffness-degree", str(degree), "--sampler", "none"]
    (one,) = fit(tmp_path / "out", log, *args)["specimens"]
    assert (one["model"]["branches"], one["model"]["stiffness_degree"]) == (branches, degree)
    names = [entry["name"] for entry in one["parameters"]]
    assert sum(name.startswith("relaxation_time_s") for name in names) == branches
    assert sum(name.startswith("stiffness_") for name in names) == branches * (degree + 1)
    times = [entry["value"] or entry["detail"]["estimate"] for entry in one["parameters"]
             if entry["name"].startswith("relaxation_time_s")]  # fmt: skip
    assert times == sorted(times)
    assert one["selection"] == []


def test_auto_prints_the_candidates_it_chose_from(tmp_path):
    log = write_log(tmp_path / "log.csv")
    (one,) = fit(tmp_path / "out", log)["specimens"]
    tried = {(row["branches"], row["stiffness_degree"]) for row in one["selection"]}
    (chosen,) = [row for row in one["selection"] if row["chosen"]]
    # a bending K, and branches that can't be seen, are no candidates of one ramp and hold
    assert (1, 0) in tried
    assert chosen["branches"] == one["model"]["branches"]
    assert chosen["stiffness_degree"] == one["model"]["stiffness_degree"]
    options = read_json(tmp_path / "out" / "identification.json")["provenance"]["options"]
    assert options["branches"] == options["stiffness_degree"] == "auto"


SMALL = Recipe(
    "small",
    (Log("hold", (Move(8.0, 300.0), Hold(2.0)), repeats=3),),
    rate_Hz=50.0,
    static=(60.0,),
    sigma_N=0.1,
)


@pytest.fixture(scope="module")
def logs():
    return simulate(SMALL, rng=np.random.default_rng(3))


def inspected(*args: str | Path) -> Any:
    return run("inspect", *args, "--json").json()


@pytest.fixture(scope="module")
def files(tmp_path_factory, logs):
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
def test_one_sheet_is_picked_by_option_or_behind_the_file(files, kind, sheet, expected):
    assert [one["sheet"] for one in inspected(files[kind], "--sheet", sheet)] == expected
    assert [one["sheet"] for one in inspected(f"{files[kind]}::{sheet}")] == expected


def test_a_sheet_that_is_not_there_is_refused_with_those_that_are(files):
    ended = run("inspect", f"{files['xlsx']}::nothing", code=3, said="unknown_sheet")
    assert "'synthetic hold-1', 'synthetic hold-2', 'synthetic hold-3'" in ended.stderr


def test_a_file_whose_name_has_the_mark_is_that_file(tmp_path, logs):
    path = tmp_path / "a::b.csv"
    path.write_bytes(EXPORTS["bare"].write(logs[0]))
    (one,) = inspected(path)
    assert one["path"] == str(path)


def test_one_picked_sheet_is_fitted(files, tmp_path):
    (entry,) = fit(tmp_path / "out", f"{files['txt']}::2", *QUICK)["provenance"]["inputs"]
    assert (entry["sheet"], entry["recipe"]) == ("2: Stress Relaxation", "mach-1")


def test_a_pattern_that_fits_nothing_is_a_wrong_option_and_one_that_fits_some_names_the_others(
    files, tmp_path
):
    said = ("'cow(\\\\d)'", "synthetic hold-1")
    for args in (("inspect",), ("fit", *QUICK, "-o", tmp_path / "out")):
        run(*args, files["xlsx"], "--specimen-by", r"cow(\d)", code=2, said=said)
    assert not (tmp_path / "out" / "identification.json").exists()
    ended = run("inspect", files["xlsx"], "--specimen-by", "hold-[12]", code=0, said="synthetic hold-3")
    assert "synthetic hold-1" not in ended.stderr


def test_marks_that_the_text_leaves_open_can_be_stated(tmp_path):
    path = tmp_path / "open.csv"
    rows = "".join(f"{i + 1}.000;{i + 2}.500;{i + 3}.250\n" for i in range(20))
    path.write_text("Time;Extension;Load\n(s);(mm);(N)\n" + rows)
    run("inspect", path, code=3, said="--decimal")
    (one,) = inspected(path, "--decimal", "point", "--delimiter", "semicolon")
    assert one["first"]["displacement_mm"] == 2.5


def test_every_dialect_is_listed_with_what_it_is_and_that_of_another_machine_is_written(tmp_path):
    run("synth", "--dialects", code=0, shown=(*EXPORTS, *(one.description for one in EXPORTS.values())))
    folder = tmp_path / "synthetic"
    run("synth", "paper-a-22", "-o", folder, "--rate", "10", "--dialect", "mts-793-de", code=0)
    described = inspected(folder)
    assert len(described) == 22
    assert {one["recipe"] for one in described} == {"mts-793"}


def test_a_broken_installed_reader_is_warned_of_and_the_files_are_read(tmp_path, logs, monkeypatch):
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


def test_a_mean_curve_is_left_out_with_one_line(tmp_path):
    write_log(tmp_path / "Mean.csv")
    write_log(tmp_path / "cow.csv")
    ended = run("fit", tmp_path, "-o", tmp_path / "out", *QUICK, code=0)
    (line,) = (line for line in ended.stdout.splitlines() if line.startswith("excluded"))
    assert "Mean.csv" in line
    assert "no specimen" in line
    assert "1 log," in ended.stdout
