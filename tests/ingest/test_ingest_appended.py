"""Recordings below each other in one text: heads that come again, and columns that tell specimens apart."""

from __future__ import annotations

from pathlib import Path

import pytest
from ingest_files import codes, put, refusal

from tissueid.errors import InputError
from tissueid.ingest import read_each, read_one, read_trials

HEAD = "Time (s),Extension (mm),Load (N)\n"


def lines(count: int, force: float, *, start: float = 0.0) -> list[str]:
    return [f"{start + k / 10:.1f},{k * 0.05:.3f},{force + k * 0.25:.3f}\n" for k in range(count)]


def test_a_head_behind_which_the_time_starts_again_begins_another_recording(tmp_path: Path) -> None:
    text = "Operator,lab\nLiver 1\n" + HEAD + "".join(lines(30, 1.0))
    text += (
        "\nRate,0.5,mm/s\nLiver 2\n" + HEAD + "".join(lines(20, 2.0)) + "\n" + HEAD + "".join(lines(25, 3.0))
    )
    path = put(tmp_path / "a.csv", text)
    first, second, third = read_trials(path)
    sheets = [trial.source.sheet for trial in (first, second, third)]
    assert sheets == ["1: Liver 1", "2: Liver 2", "3"]
    assert [trial.time_s.size for trial in (first, second, third)] == [30, 20, 25]
    assert [trial.force_N[2] for trial in (first, second, third)] == [1.5, 2.5, 3.5]
    assert [codes(trial) for trial in (first, second, third)] == [[], [], []]
    assert (first.protocol.speed_mm_s, second.protocol.speed_mm_s) == (None, 0.5)
    assert len({trial.specimen for trial in (first, second, third)}) == 3
    assert read_one(path, "2: Liver 2").force_N[0] == 2.0


def test_units_of_a_row_stand_under_each_head_and_labels_above_it(tmp_path: Path) -> None:
    head = "Record,Position,Time,Force\n,um,s,mN\n"
    rows = "".join(f"1,{k * 50},{k / 10:.1f},{k * 0.25:.3f}\n" for k in range(20))
    text = "".join(f"Export version:,3\nSpecimen label:,{name}\n{head}{rows}\n" for name in "AB")
    first, second = read_trials(put(tmp_path / "a.csv", text))
    assert (first.specimen, second.specimen) == ("A", "B")
    assert second.displacement_mm[2] == pytest.approx(0.1)
    assert second.force_N[2] == pytest.approx(0.5e-3)


def test_a_head_that_comes_again_while_the_time_goes_on_is_a_page(tmp_path: Path) -> None:
    text = HEAD + "".join(lines(30, 1.0)) + "Page 2\n" + HEAD + "".join(lines(30, 8.5, start=3.0))
    (trial,) = read_trials(put(tmp_path / "a.csv", text))
    assert trial.source.sheet is None
    assert trial.time_s.size == 60


def test_each_head_has_its_own_units(tmp_path: Path) -> None:
    names, rows = "Time,Extension,Load\n", "".join(lines(30, 1.0))
    text = f"A\n{names}s,mm,N\n{rows}\nB\n{names}s,um,mN\n{rows}\nC\n{names}{rows}"
    first, second, third = read_trials(put(tmp_path / "a.csv", text))
    assert (second.displacement_mm[2], second.force_N[2]) == pytest.approx((1e-4, 1.5e-3))
    assert first.force_N[2] == third.force_N[2] == 1.5
    names = "Time (s),Extension (mm),Load\n"
    text = f"Load unit: N\n{names}{rows}\nLoad unit: mN\n{names}{rows}"
    assert [trial.force_N[2] for trial in read_trials(put(tmp_path / "b.csv", text))] == [1.5, 1.5e-3]


@pytest.mark.parametrize(("second", "specimens"), [("A", ["A"]), ("B", ["A", "B"])])
def test_another_specimen_named_above_a_head_begins_a_recording_though_the_time_goes_on(
    tmp_path: Path, second: str, specimens: list[str]
) -> None:
    text = "Specimen label,A\n" + HEAD + "".join(lines(30, 1.0))
    text += f"\nSpecimen label,{second}\n" + HEAD + "".join(lines(20, 8.5, start=3.0))
    trials = read_trials(put(tmp_path / "a.csv", text))
    assert [trial.specimen for trial in trials] == specimens
    assert sum(trial.time_s.size for trial in trials) == 50


@pytest.mark.parametrize(
    ("label", "names"),
    [("Specimen", "AB"), ("Sample No", "12"), ("sample_id", "AB"), ("Probe", "AB"), ("试样编号", "12")],
)
@pytest.mark.parametrize("start", [0.0, 5.0])
def test_a_column_of_specimens_parts_the_rows(tmp_path: Path, label: str, names: str, start: float) -> None:
    rows = [f"{names[0]},{line}" for line in lines(30, 1.0)]
    rows += [f"{names[1]},{line}" for line in lines(20, 2.0, start=start)]
    first, second = read_trials(put(tmp_path / "a.csv", f"{label},{HEAD}" + "".join(rows)))
    assert [first.source.sheet, second.source.sheet] == [f"1: {names[0]}", f"2: {names[1]}"]
    assert (first.time_s.size, second.time_s.size, second.force_N[0]) == (30, 20, 2.0)
    assert first.specimen != second.specimen


def test_a_specimen_named_in_its_first_row_alone_goes_on_below_it(tmp_path: Path) -> None:
    rows = [f"{'A' if k == 0 else ''},{line}" for k, line in enumerate(lines(30, 1.0))]
    rows += [f"{'B' if k == 0 else ''},{line}" for k, line in enumerate(lines(20, 2.0))]
    trials = read_trials(put(tmp_path / "a.csv", f"Specimen,{HEAD}" + "".join(rows)))
    assert [(trial.source.sheet, trial.time_s.size) for trial in trials] == [("1: A", 30), ("2: B", 20)]


@pytest.mark.parametrize(("name", "start", "count"), [("Trial", 0.0, 2), ("Trial", 3.0, 1), ("Site", 0.0, 2)])
def test_a_column_of_runs_parts_them_where_the_time_starts_again(tmp_path, name, start, count) -> None:
    rows = [f"liver,1,{line}" for line in lines(30, 1.0)]
    rows += [f"liver,2,{line}" for line in lines(30, 8.5, start=start)]
    trials = read_trials(put(tmp_path / "a.csv", f"Organ,{name},{HEAD}" + "".join(rows)))
    assert [trial.source.sheet for trial in trials] == (["1: 1", "2: 2"] if count == 2 else [None])


@pytest.mark.parametrize("name", ["Sample", "Probe", "Probenhöhe", "Specimen"])
def test_a_column_of_changing_numbers_tells_no_specimens_apart(tmp_path: Path, name: str) -> None:
    ramp = [f"{k},{line}" for k, line in enumerate(lines(30, 1.0))]
    hold = [f"29,{line}" for line in lines(300, 8.5, start=3.0)]
    (trial,) = read_trials(put(tmp_path / "a.csv", f"{name},{HEAD}" + "".join(ramp + hold)))
    assert trial.time_s.size == 330


@pytest.mark.parametrize(
    "foot",
    [
        "\nPeak force (N),8.25\n",
        "Peak force,8.25,N\n",
        "\nOperator,lab\nTemperature,23.1,C\nEnd of test\n",
        "\n,Min,Max\nLoad (N),1,8.25\n",
    ],
)
def test_keys_and_values_behind_the_last_row_are_left_out_and_said(tmp_path: Path, foot: str) -> None:
    (trial,) = read_trials(put(tmp_path / "a.csv", HEAD + "".join(lines(30, 1.0)) + foot))
    assert trial.time_s.size == 30
    assert codes(trial) == ["rows_skipped"]


def test_a_table_below_250_lines_of_header_is_found(tmp_path: Path) -> None:
    header = "".join(f"Key {k},value\n" for k in range(250))
    (trial,) = read_trials(put(tmp_path / "a.csv", header + HEAD + "".join(lines(30, 1.0))))
    assert (trial.time_s.size, trial.source.metadata["Key 249"]) == (30, "value")


def test_a_row_of_numbers_between_names_and_units_is_said(tmp_path: Path) -> None:
    head = "Time,Extension,Load\n9,0,0.680\n(s),(mm),(N)\n"
    (trial,) = read_trials(put(tmp_path / "a.csv", head + "".join(lines(30, 1.0))))
    assert trial.time_s.size == 30
    assert codes(trial) == ["rows_skipped"]
    assert trial.flags[0].values["lines"] == [2]


@pytest.mark.parametrize(
    ("row", "line"), [("err,1.500,8.500\n", 32), ("Total,1.500,8.500\n", 32), ("Segment,2,hold\n", 200)]
)
def test_a_row_whose_time_is_no_number_ends_no_table(tmp_path: Path, row: str, line: int) -> None:
    rows = lines(30 if line == 32 else 300, 1.0)
    rows.insert(line - 2, row)
    error = refusal(put(tmp_path / "a.csv", HEAD + "".join(rows)))
    assert (error.code, error.line) == ("text_in_numbers", line)


@pytest.mark.parametrize(("name", "count"), [("Specimen", 30), ("Test", 30), ("Test", 2)])
def test_rows_of_recordings_that_stand_mixed_are_refused(tmp_path: Path, name: str, count: int) -> None:
    both = zip(lines(count, 1.0), lines(count, 9.0), strict=True)
    error = refusal(put(tmp_path / "a.csv", f"{name},{HEAD}" + "".join(f"A,{a}B,{b}" for a, b in both)))
    assert error.code == "mixed_tables"
    assert "sort them" in error.message


def test_a_damaged_recording_is_refused_at_its_line_and_the_others_are_read(tmp_path: Path) -> None:
    bad = lines(30, 2.0)
    bad[10] = "1.0,0.5x,4.5\n"
    text = HEAD + "".join(lines(30, 1.0)) + HEAD + "".join(bad) + HEAD + "".join(lines(30, 3.0))[:-4]
    first, second, third = read_each(put(tmp_path / "a.csv", text))
    assert isinstance(second, InputError)
    assert (second.code, second.line, second.column, second.sheet) == ("text_in_numbers", 43, 2, "2")
    assert not isinstance(first, InputError)
    assert not isinstance(third, InputError)
    assert codes(third) == ["cut_row"]
    assert "line 93" in third.flags[0].message
