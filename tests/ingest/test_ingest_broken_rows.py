"""Rows from which on a file is no longer what it was, and numbers that lost their marks: refused or said."""

from pathlib import Path

import numpy as np
import pytest
from ingest_files import codes, put, read, refusal, workbook

from tissueid.flags import warning_line
from tissueid.ingest import ReadOptions

COUNT = 400
TIME = 0.1 * np.arange(COUNT)
TRAVEL = -0.02 * np.minimum(np.arange(COUNT), 150) - 0.51234
FORCE = (
    -0.51381
    - 0.3
    * np.minimum(np.arange(COUNT), 150)
    * np.where(np.arange(COUNT) < 150, 1.0, 0.6 + 0.4 * np.exp(-(np.arange(COUNT) - 150) / 60))
    + np.random.default_rng(4).normal(0.0, 1e-3, COUNT)
)


def cell(value: float) -> str:
    """With as many digits as needed: no fixed decimals, as a spreadsheet prints."""
    return f"{value:.5f}".rstrip("0").rstrip(".").replace(".", ",")


def table() -> list[list[str]]:
    return [[cell(v) for v in row] for row in zip(TIME, TRAVEL, FORCE, strict=True)]


def written(path: Path, rows: list[list[str]]) -> Path:
    return put(path, "Zeit (s);Weg (mm);Kraft (N)\n" + "".join(";".join(row) + "\n" for row in rows))


@pytest.mark.parametrize(
    ("lost", "column"),
    [(slice(25, COUNT), 2), (slice(200, COUNT), 2), (slice(380, COUNT), 2), (slice(120), 1)],
)
def test_a_decimal_mark_lost_from_a_row_on_or_up_to_one_is_refused(tmp_path, lost, column) -> None:
    rows = table()
    for row in rows[lost]:
        row[column] = f"{float(row[column].replace(',', '.')):.5f}".replace(".", "").replace("-0", "-")
    error = refusal(written(tmp_path / "a.csv", rows))
    assert (error.code, error.line, error.column) == ("damaged_number", (lost.start or 0) + 2, column + 1)
    assert f"{len(rows[lost])} rows" in error.message


@pytest.mark.parametrize("first", [40, 300])
def test_columns_exchanged_from_a_row_on_are_refused(tmp_path: Path, first: int) -> None:
    rows = table()
    for row in rows[first:]:
        row[1], row[2] = row[2], row[1]
    error = refusal(written(tmp_path / "a.csv", rows))
    assert (error.code, error.line) == ("mixed_tables", first + 2)
    assert "each other's column" in error.message


def test_a_row_of_another_recording_is_refused(tmp_path: Path) -> None:
    rows = table()
    rows[222][1:] = ["812,5", "-4100,25"]
    error = refusal(written(tmp_path / "a.csv", rows))
    assert (error.code, error.line) == ("mixed_tables", 224)


def test_the_same_holds_in_a_workbook(tmp_path: Path) -> None:
    rows = zip(TIME.tolist(), TRAVEL.tolist(), FORCE.tolist(), strict=True)
    crossed = [(t, x, f) if k < 200 else (t, f, x) for k, (t, x, f) in enumerate(rows)]
    head = ("Time (s)", "Extension (mm)", "Load (N)")
    error = refusal(workbook(tmp_path / "a.xlsx", {"A": [head, *crossed]}))
    assert (error.code, error.line) == ("mixed_tables", 202)


def test_a_leap_that_stays_is_said_and_a_gap_or_a_fast_ramp_is_none(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    travel = TRAVEL + rng.normal(0.0, 1e-5, COUNT)
    travel[:150] = travel[0] + rng.normal(0.0, 1e-5, 150)
    travel[150:] = travel[0] - 3.0 + rng.normal(0.0, 1e-5, COUNT - 150)

    def flags(time: np.ndarray, x: np.ndarray) -> list[str]:
        rows = [[f"{v:.6f}".replace(".", ",") for v in row] for row in zip(time, x, FORCE, strict=True)]
        return codes(read(written(tmp_path / "a.csv", rows)))

    assert "jump" in flags(TIME, travel)
    assert "jump" not in flags(np.where(np.arange(COUNT) < 150, TIME, TIME + 5.0), travel)
    travel[148:152] = travel[0] + np.array([-0.5, -1.2, -2.0, -2.7])
    assert "jump" not in flags(TIME, travel)


def test_sound_rows_a_rupture_and_a_number_of_four_digits_are_no_broken_rows(tmp_path: Path) -> None:
    assert read(written(tmp_path / "a.csv", table())).flags == ()
    force, nothing = FORCE.copy(), np.zeros(COUNT)
    force[120:] = -0.01 + np.random.default_rng(5).normal(0.0, 1e-3, COUNT - 120)
    coarse = np.where(np.arange(COUNT) < 100, FORCE, np.round(1e3 * FORCE) / 1e3)
    for travel, values in ((TRAVEL, force), (TRAVEL, coarse), (nothing, nothing)):
        rows = [[cell(v) for v in row] for row in zip(TIME, travel, values, strict=True)]
        assert read(written(tmp_path / "a.csv", rows)).time_s.size == COUNT
    # significant digits: decimals end where the number has enough of them
    steep = zip(TIME, TRAVEL, np.linspace(5.0, 4000.0, COUNT), strict=True)
    rows = [[cell(t), cell(x), f"{f:.4g}".replace(".", ",")] for t, x, f in steep]
    assert read(written(tmp_path / "b.csv", rows)).time_s.size == COUNT


def export(path: Path, rows: list[str]) -> Path:
    head = 'Text Inputs : Specimen label,"synthetic"\n\nTime,Extension,Load\n(sec),(mm),(N)\n'
    return put(path, head + "\n".join(rows) + "\n")


def sound(count: int = 40) -> list[str]:
    return [f"{i * 0.01:.2f},{i * 0.04:.4f},{i * 0.5:.4f}" for i in range(count)]


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (lambda i: f"{i * 0.01:.2f},{i * 4167:06d},{i * 0.5:.4f}", ("'Extension'", "5000 mm")),
        (lambda i: f"{i * 0.01:.2f},{i * 0.04:.4f},{i * 266000}", ("'Load'", "5e+06 N")),
    ],
)
def test_travel_and_force_beyond_any_machine_are_refused_with_their_column(tmp_path, row, words) -> None:
    one = refusal(export(tmp_path / "lost.csv", [row(i) for i in range(1, 200)]))
    assert one.code == "implausible_range"
    assert all(word in one.message for word in words)


@pytest.mark.parametrize(
    ("travel", "force", "said"),
    [
        (lambda i: i * 3, lambda i: i * i, [None]),
        # seconds may well be whole
        (lambda i: i * 3 + 0.25, lambda i: i * i + 0.5, []),
        (lambda i: i * 3, lambda i: i * i + 0.5, ["displacement"]),
    ],
)
def test_whole_numbers_throughout_are_said(tmp_path: Path, travel, force, said) -> None:
    trial = read(export(tmp_path / "whole.csv", [f"{i},{travel(i)},{force(i)}" for i in range(40)]))
    assert [flag.values.get("quantity") for flag in trial.flags if flag.code == "no_decimals"] == said


def test_what_is_said_of_a_clock_of_whole_milliseconds_fits_its_line_and_helps(tmp_path: Path) -> None:
    rows = "".join(f"{100 * i},{0.04 * i:.3f},{0.5 * i:.4f}\n" for i in range(400))
    path = put(tmp_path / "a.csv", f"timestamp,position_mm,force_N\n{rows}")
    line = next(warning_line(one.code, one.message) for one in read(path).flags if one.code == "no_decimals")
    assert "--units time=ms" in line
    assert "..." not in line
    assert codes(read(path, ReadOptions(units={"time": "ms"}))) == []


def test_a_unit_of_the_user_against_that_of_the_file_is_said(tmp_path: Path) -> None:
    path = export(tmp_path / "log.csv", sound())
    trial = read(path, ReadOptions(units={"force": "kN"}))
    (flag,) = (flag for flag in trial.flags if flag.code == "unit_overridden")
    assert flag.values["quantity"] == "force"
    np.testing.assert_allclose(trial.force_N[2], 1000.0)
    trial = read(path, ReadOptions(units={"force": "N"}))
    assert not trial.flags


def test_a_number_that_lost_its_mark_among_fixed_decimals_is_refused_at_its_line(tmp_path: Path) -> None:
    rows = sound(60)
    rows[30] = rows[30].replace("15.0000", "150000")
    one = refusal(export(tmp_path / "lost.csv", rows))
    assert (one.code, one.line, one.column) == ("damaged_number", 35, 3)
    # where decimals vary it may be meant: read, and said
    rows = [f"{i * 0.01:g},{i * 0.04 + 0.001:g},{i * 0.53 + 0.03:g}" for i in range(60)]
    rows[30] = rows[30].replace("15.93", "1593")
    trial = read(export(tmp_path / "varied.csv", rows))
    assert trial.force_N[30] == 1593.0
    assert "no_decimals" in codes(trial)


def test_a_hold_that_is_logged_in_whole_seconds_has_lost_no_marks(tmp_path: Path) -> None:
    times = [*(i * 0.05 for i in range(400)), *range(20, 200)]
    rows = [f"{t:.4f},{min(t, 5.0):.4f},{min(t, 5.0) * 0.31 + 0.001:.4f}" for t in times]
    assert "no_decimals" not in codes(read(export(tmp_path / "decimated.csv", rows)))
    # a number that lost its mark there is far above the rows beside it as well
    rows[500] = rows[500].replace("120.0000", "1200000")
    assert refusal(export(tmp_path / "lost.csv", rows)).code == "damaged_number"


def test_numbers_beyond_the_names_are_refused(tmp_path: Path) -> None:
    rows = [f"0,{i:02d},1,{i:02d},2,{i:02d}" for i in range(40)]
    one = refusal(export(tmp_path / "comma.csv", rows))
    assert (one.code, one.line, one.column) == ("ragged_rows", 5, 4)
    assert "decimal comma" in one.message


def test_a_second_head_with_other_units_is_refused_and_the_same_head_is_said(tmp_path: Path) -> None:
    rows = sound()
    again = [*rows[:20], "Time,Extension,Load", "(sec),(mm),(N)", *rows[20:]]
    trial = read(export(tmp_path / "same.csv", again))
    assert trial.time_s.size == 40
    assert [flag.values["lines"] for flag in trial.flags if flag.code == "rows_skipped"] == [[25, 26]]
    other = [line.replace("(N)", "(kN)") for line in again]
    one = refusal(export(tmp_path / "other.csv", other))
    assert one.line == 26


@pytest.mark.parametrize("with_position", [True, False])
def test_a_counter_that_starts_again_at_each_turn_is_no_displacement(tmp_path, with_position: bool) -> None:
    text, z = "timestamp,direction,z,displacement,force\n", 0.75
    rows = [(way, 0.5 * k) for way in ("DOWN", "UP") * 2 for k in range(25)]
    for i, (way, counted) in enumerate(rows):
        sign = 1.0 if way == "UP" else -1.0
        z += sign * 0.5
        force = 0.2 * max(0.0, -z - 6.0) ** 1.5 + 0.001 * (i % 3)
        text += (
            f"{1724677979.4 + 0.3 * i:.4f},{way},{z if with_position else ''},{sign * counted},{force:.3f}\n"
        )
    if not with_position:
        text = (
            "\n".join(",".join(line.split(",")[:2] + line.split(",")[3:]) for line in text.splitlines())
            + "\n"
        )
    trial = read(put(tmp_path / "a.csv", text))
    choice = [flag.values["taken"] for flag in trial.flags if flag.code == "column_choice"]
    assert choice == (["z"] if with_position else [])
    assert ("jump" in codes(trial)) is not with_position
    leap = float(np.abs(np.diff(trial.displacement_mm)).max())
    assert leap == pytest.approx(0.5 if with_position else 12.0)


@pytest.mark.parametrize(
    ("names", "slower"),
    [
        (("Time (s)", "Displacement (mm)", "Time (s)", "Force (N)"), 2.0),
        (("Displacement Time (s)", "Displacement (mm)", "Load Time (s)", "Load (N)"), 2.0),
        (("Time (s)", "Displacement (mm)", "Time (s)", "Force (N)"), 1.0),
        (("Total Time (s)", "Displacement (mm)", "Cycle Elapsed Time (s)", "Force (N)"), 2.0),
        (("Time (s)", "Displacement (mm)", "Time (ms)", "Force (N)"), 1000.0),
    ],
)
@pytest.mark.parametrize("kind", ["csv", "xlsx"])
def test_channels_with_clocks_that_part_are_refused(tmp_path: Path, kind: str, names, slower: float) -> None:
    rows = [names, *zip(TIME, TRAVEL, slower * TIME, FORCE, strict=True)]
    path = tmp_path / f"a.{kind}"
    if kind == "csv":
        put(path, "\n".join(",".join(map(str, row)) for row in rows) + "\n")
    else:
        workbook(path, {"Sheet1": [list(row) for row in rows]})
    if slower in (1.0, 1000.0) or names[0].startswith("Total"):
        assert read(path).time_s[-1] == pytest.approx(TIME[-1])
        return
    error = refusal(path)
    assert (error.code, error.column) == ("several_clocks", 3)
    assert read(path, ReadOptions(columns={"time": "#3"})).time_s[-1] == pytest.approx(2.0 * TIME[-1])
