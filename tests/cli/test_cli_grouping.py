"""What is fitted together, under which name, and with which model: nothing is pooled silently."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import QUICK, run, write_log


def fit(out: Path, *args: str | Path) -> dict[str, Any]:
    ended = run("fit", *args, "-o", out, "--json")
    assert ended.code in (0, 4), ended.stderr
    document: dict[str, Any] = ended.json()
    return document


def logs_of(document: dict[str, Any]) -> dict[str, int]:
    return {one["specimen"]: len(one["trials"]) for one in document["specimens"]}


def test_files_with_one_header_label_are_one_specimen(tmp_path: Path) -> None:
    for number in (1, 2, 3):
        write_log(tmp_path / "lab" / f"log-{number}.csv", label="kidney 7", force_times=1.0 + 0.02 * number)
    document = fit(tmp_path / "out", tmp_path / "lab", *QUICK)
    assert logs_of(document) == {"kidney 7": 3}
    assert document["specimens"][0]["model"]["static_pooling"] == "scaled"
    assert (tmp_path / "out" / "bundle-kidney_7.h5").exists()
    assert {entry["specimen"] for entry in document["provenance"]["inputs"]} == {"kidney 7"}


def test_files_without_label_are_their_own_even_under_one_name(tmp_path: Path) -> None:
    for day in ("monday", "friday"):
        write_log(tmp_path / "lab" / day / "log.csv", label=None)
    write_log(tmp_path / "lab" / "friday" / "other.csv", label=None)
    document = fit(tmp_path / "out", tmp_path / "lab", *QUICK)
    # as short as tells them apart
    assert logs_of(document) == {"friday/log": 1, "other": 1, "monday/log": 1}
    assert not (tmp_path / "out" / "bundle.h5").exists()
    assert len(list((tmp_path / "out").glob("bundle-*.h5"))) == 3
    for one in document["specimens"]:
        assert one["model"]["static_pooling"] == "shared"


def test_files_that_differ_in_their_suffix_alone_have_two_names(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", label=None)
    write_log(tmp_path / "log.txt", label=None)
    document = fit(tmp_path / "out", tmp_path / "log.csv", tmp_path / "log.txt", *QUICK)
    assert len(logs_of(document)) == 2
    assert run("validate", tmp_path / "out").code == 0


def test_a_label_and_a_file_of_that_name_stay_apart(tmp_path: Path) -> None:
    write_log(tmp_path / "a.csv", label="log")
    write_log(tmp_path / "log.csv", label=None)
    document = fit(tmp_path / "out", tmp_path / "a.csv", tmp_path / "log.csv", *QUICK)
    names = logs_of(document)
    assert len(names) == 2
    assert "log" in names
    assert run("validate", tmp_path / "out").code == 0


def test_specimen_by_groups_by_its_first_group_and_wins_over_the_header(tmp_path: Path) -> None:
    for name in ("cow3_a", "cow3_b", "cow4_a"):
        write_log(tmp_path / "lab" / f"{name}.csv", label=f"label of {name}")
    document = fit(tmp_path / "out", tmp_path / "lab", "--specimen-by", r"(cow\d+)_", *QUICK)
    assert logs_of(document) == {"cow3": 2, "cow4": 1}


def test_what_specimen_by_does_not_fit_is_grouped_with_nothing(tmp_path: Path) -> None:
    for name in ("x", "y", "cow1_a", "cow1_b"):
        write_log(tmp_path / "lab" / f"{name}.csv", label="same")
    document = fit(tmp_path / "out", tmp_path / "lab", "--specimen-by", r"cow\d", *QUICK)
    assert logs_of(document) == {"cow1": 2, "x": 1, "y": 1}


def test_each_sheet_is_its_own_specimen(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    source = write_log(tmp_path / "log.csv", label=None).read_text(encoding="ascii").splitlines()
    for name in ("left", "right"):
        sheet = book.create_sheet(name)
        sheet.append(["Time", "Extension", "Load"])
        sheet.append(["s", "mm", "N"])
        for line in source[3:]:
            sheet.append([float(cell) for cell in line.split(",")])
    book.save(tmp_path / "book.xlsx")
    document = fit(tmp_path / "out", tmp_path / "book.xlsx", *QUICK)
    assert logs_of(document) == {"left": 1, "right": 1}
    assert [one["trials"][0]["sheet"] for one in document["specimens"]] == ["left", "right"]


@pytest.mark.parametrize("pooling", ["scaled", "partial", "shared"])
def test_the_pooling_asked_for_is_the_one_reported(tmp_path: Path, pooling: str) -> None:
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
def test_branches_and_degree_asked_for_are_fitted_and_reported(
    tmp_path: Path, branches: int, degree: int
) -> None:
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


def test_auto_prints_the_candidates_it_chose_from(tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.csv")
    (one,) = fit(tmp_path / "out", log)["specimens"]
    tried = {(row["branches"], row["stiffness_degree"]) for row in one["selection"]}
    (chosen,) = [row for row in one["selection"] if row["chosen"]]
    # a bending K, and branches that can't be seen, are no candidates of one ramp and hold
    assert (1, 0) in tried
    assert chosen["branches"] == one["model"]["branches"]
    assert chosen["stiffness_degree"] == one["model"]["stiffness_degree"]
    options = json.loads((tmp_path / "out" / "identification.json").read_bytes())["provenance"]["options"]
    assert options["branches"] == options["stiffness_degree"] == "auto"
