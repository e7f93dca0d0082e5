"""What is no recording: refused by name and reason, never with a traceback."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from ingest_files import put, read, refusal, workbook

from tissueid.errors import InputError, UsageError
from tissueid.ingest import (
    REFUSAL_CODES,
    ReadOptions,
    find_inputs,
    match_of,
    read_each,
    read_one,
    read_trials,
)
from tissueid.ingest.refusals import Place

GOOD = "Time,Extension,Load\n(s),(mm),(N)\n0.0,0.0,0.1\n0.1,0.5,0.2\n0.2,1.0,0.4\n"


def refused(path: Path) -> InputError:
    item = refusal(path)
    assert item.code in REFUSAL_CODES
    assert item.path == str(path)
    return item


PNG = b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 20
RESULTS = "Specimen,Maximum load (N),Modulus (MPa)\nA,12.5,3.1\nB,13.5,3.4\nC,11.9,2.9\n"

WRONG = {
    "png": (PNG, "not_an_export", "PNG"),
    "png named csv": (PNG, "not_an_export", "PNG"),
    "empty": (b"", "empty_file", "empty"),
    "blank lines": (b"\r\n\r\n \r\n", "empty_file", "empty"),
    "json": (json.dumps({"time": [0, 1], "force": [1, 2]}).encode(), "not_an_export", "JSON"),
    "html": (b"<!DOCTYPE html><html><body>1,2,3</body></html>", "not_an_export", "HTML"),
    "prose": (b"Dear colleague,\n\nplease find the data, as agreed.\n", "not_an_export", "Dear"),
    "random bytes": (bytes((i * 7919 + i * i) % 256 for i in range(5000)), "not_an_export", "binary"),
    "NUL in a cell": (GOOD.replace("0.5", "0\x005").encode(), "not_an_export", "binary"),
    "one long line": (b"1" * 200_000, "not_an_export", "line"),
    "letters": (b"Time,x,u,F\n0,1,2,3\n1,2,3,4\n", "no_columns", "'x', 'u'"),
    "results only": (RESULTS.encode(), "no_columns", "Maximum load (N)"),
    "names without rows": (b"Time,Extension,Load\n(s),(mm),(N)\n", "no_rows", "no row"),
    "one row": (b"Time,Extension,Load\n(s),(mm),(N)\n0.0,1.0,2.0\n", "no_rows", "1 rows"),
    "zip without workbook": (b"PK\x03\x04" + b"\0" * 60, "unreadable_workbook", "workbook"),
    "broken xls": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + b"\0" * 600, "unreadable_workbook", "workbook"),
    "truncated UTF-16": (b"\xff\xfe" + GOOD.encode("utf-16-le")[:-1], "not_an_export", "UTF-16"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_files_are_refused_with_their_kind(tmp_path, name):
    data, code, word = WRONG[name]
    error = refused(put(tmp_path / f"{name}.csv", data))
    assert error.code == code
    assert word in error.message


def test_a_column_the_user_named_must_exist_once(tmp_path):
    path = put(tmp_path / "a.csv", "Time,L,L\n0,1,2\n1,2,3\n")
    for wanted, word in (("X", "'L'"), ("L", "#2, #3")):
        error = refusal(path, ReadOptions(columns={"displacement": wanted, "force": "#3"}))
        assert error.code == "column_not_found"
        assert word in error.message


def test_missing_paths_and_empty_directories(tmp_path):
    with pytest.raises(UsageError, match=r"nowhere\.csv"):
        find_inputs([tmp_path / "nowhere.csv"])
    (tmp_path / "notes.txt").write_text("the operator was ill")
    with pytest.raises(InputError) as caught:
        read_trials(tmp_path)
    assert caught.value.code == "no_recording"
    assert refused(tmp_path / "gone.csv").code == "unreadable_file"
    assert refused(tmp_path).code == "unreadable_file"


def test_directories_in_natural_order_without_hidden_files_and_own_output(tmp_path):
    hidden = (".hidden.csv", "~$log.xlsx", "out/log_3.csv")
    for name in ("log_10.csv", "log_2.CSV", *hidden, "sub/log_1.txt", "x.md"):
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(GOOD)
    (tmp_path / "out" / "identification.json").write_text("{}")
    names = [path.relative_to(tmp_path).as_posix() for path in find_inputs([tmp_path])]
    assert names == ["log_2.CSV", "log_10.csv", "sub/log_1.txt"]
    assert find_inputs([tmp_path / "x.md", tmp_path / "x.md"]) == [tmp_path / "x.md"]


def trial_sheet(name: str, rows: list[list[object]] | None = None) -> list[list[object]]:
    head = [[name] * 3, ["Prüfzeit", "Standardkraft", "Standardweg"], ["s", "N", "mm"]]
    return head + (rows or [[0.1 * i, 2.0 * i, 0.5 * i] for i in range(20)])


def test_a_bad_sheet_never_stops_the_others(tmp_path):
    bad = [[0.0, 1.0, 2.0], [0.1, "1,5", 2.1], [0.2, 1.6, 2.2]]
    sheets = {
        "Parameter": [["Titel", "", "x"]],
        "A 1": trial_sheet("A 1"),
        "A 2": trial_sheet("A 2", bad),
        "A 3": trial_sheet("A 3", [[0.0, 1.0, 2.0], [0.1, None, 2.1], [0.2, 1.6, 2.2]]),
        "A 4": trial_sheet("A 4", [[0.0, 1.0, 2.0], [0.2, 1.1, 2.1], [0.1, 1.6, 2.2]]),
        "A 5": trial_sheet("A 5")[:3],
        "A 6": trial_sheet("A 6"),
    }
    items = list(read_each(workbook(tmp_path / "t.xlsx", sheets)))
    found = [
        (item.sheet, item.code, item.line, item.column) if isinstance(item, InputError) else item.source.sheet
        for item in items
    ]
    assert found == [
        "A 1",
        ("A 2", "text_in_numbers", 5, 2),
        ("A 3", "empty_cell", 5, 2),
        ("A 4", "time_backwards", 6, 1),
        ("A 5", "no_rows", 3, None),
        "A 6",
    ]
    good = items[0]
    assert good.displacement_mm[3] == 1.5
    assert good.specimen == "A 1"


def test_sheets_that_share_a_test_name_stay_apart(tmp_path):
    path = workbook(
        tmp_path / "t.xlsx", {"x": trial_sheet("A"), "y": trial_sheet("A"), "z": trial_sheet("Probe 1")}
    )
    assert [trial.specimen for trial in read_trials(path)] == [f"{path}::{sheet}" for sheet in "xyz"]


def test_a_workbook_without_a_trial_says_what_it_saw(tmp_path):
    path = workbook(
        tmp_path / "t.xlsx", {"Results": [["", "Fmax", "dL"], *([f"s{i}", 1.0, 2.0] for i in range(5))]}
    )
    error = refused(path)
    assert error.code == "no_trial_sheet"
    assert "Fmax" in error.message


def test_unknown_sheet_names_the_trials(tmp_path):
    path = workbook(tmp_path / "t.xlsx", {"a": trial_sheet("a")})
    with pytest.raises(InputError, match="'a'") as caught:
        read_one(path, "b")
    assert caught.value.code == "unknown_sheet"


def test_recipe_says_why_and_can_be_forced(tmp_path):
    path = put(tmp_path / "a.csv", GOOD)
    match = match_of(path)
    assert match.recipe.key == "bluehill-csv"
    assert "brackets" in match.reason
    trial = read(path, ReadOptions(recipe="columns"))
    assert trial.source.recipe == "columns"
    with pytest.raises(UsageError, match="bluehill-csv"):
        list(read_each(path, ReadOptions(recipe="nonsense")))


@pytest.mark.parametrize(
    "wrong",
    [
        {"columns": {"stress": "a"}},
        {"units": {"force": "mm"}},
        {"specimen_by": "("},
        {"delimiter": "::"},
        {"decimal": ";"},
    ],
)
def test_options_that_make_no_sense_are_usage_errors(wrong):
    with pytest.raises(UsageError):
        ReadOptions(**wrong)


def test_refusal_codes_are_closed():
    with pytest.raises(ValueError, match="unknown refusal code"):
        Place("a.csv").refusal("nonsense", "")
