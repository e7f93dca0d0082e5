"""Numbers that lost their decimal marks are refused or said, synthetic exports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ingest_files import read, refusal

from tissueid.ingest import ReadOptions
from tissueid.ingest.rows import row_like

HEAD = 'Text Inputs : Specimen label,"synthetic"\n\nTime,Extension,Load\n(sec),(mm),(N)\n'


def export(path: Path, rows: list[str]) -> Path:
    path.write_text(HEAD + "\n".join(rows) + "\n", encoding="ascii")
    return path


def test_travel_beyond_any_machine_is_refused_with_its_column(tmp_path: Path) -> None:
    rows = [f"{i * 0.01:.2f},{i * 4167:06d},{i * 0.5:.4f}" for i in range(1, 200)]
    one = refusal(export(tmp_path / "lost.csv", rows))
    assert one.code == "implausible_range"
    assert "'Extension'" in one.message
    assert "5000 mm" in one.message


def test_force_beyond_any_machine_is_refused(tmp_path: Path) -> None:
    rows = [f"{i * 0.01:.2f},{i * 0.04:.4f},{i * 266000}" for i in range(1, 200)]
    one = refusal(export(tmp_path / "lost.csv", rows))
    assert one.code == "implausible_range"


def test_whole_numbers_throughout_are_said(tmp_path: Path) -> None:
    trial = read(export(tmp_path / "whole.csv", [f"{i},{i * 3},{i * i}" for i in range(40)]))
    assert "no_decimals" in {flag.code for flag in trial.flags}
    rows = [f"{i},{i * 3 + 0.25},{i * i + 0.5}" for i in range(40)]
    trial = read(export(tmp_path / "not.csv", rows))
    # seconds may well be whole
    assert "no_decimals" not in {flag.code for flag in trial.flags}
    trial = read(export(tmp_path / "one.csv", [f"{i},{i * 3},{i * i + 0.5}" for i in range(40)]))
    (flag,) = (flag for flag in trial.flags if flag.code == "no_decimals")
    assert flag.values["quantity"] == "displacement"


def test_a_unit_of_the_user_against_that_of_the_file_is_said(tmp_path: Path) -> None:
    path = export(tmp_path / "log.csv", [f"{i * 0.01:.2f},{i * 0.04:.4f},{i * 0.5:.4f}" for i in range(40)])
    trial = read(path, ReadOptions(units={"force": "kN"}))
    (flag,) = (flag for flag in trial.flags if flag.code == "unit_overridden")
    assert flag.values["quantity"] == "force"
    np.testing.assert_allclose(trial.force_N[2], 1000.0)
    trial = read(path, ReadOptions(units={"force": "N"}))
    assert not trial.flags


@pytest.mark.parametrize(
    ("line", "is_row"),
    [
        ("0.10,0.20,1.50", True),
        ('"0,10";"0,20";"1.234,50"', True),
        ("0.10&-2e-05&1.50", True),
        ("'0.1'\t'0.2'\t'0.3'", True),
        ("?0.1;0.2?;?0.3", True),
        ("230403-FF1A,230403-FF1A,230403-FF1A", False),
        ("13/11/2018 5:14:03", False),
        ("3 cycles of 0.5 mm at 10 N", False),
        ("12,3", False),
        ("paused at 0.1,0.2,0.3", False),
    ],
)
def test_a_row_is_told_from_a_remark_whatever_its_delimiter(line: str, is_row: bool) -> None:
    assert row_like(line) is is_row


def test_a_number_that_lost_its_mark_among_fixed_decimals_is_refused_at_its_line(tmp_path: Path) -> None:
    rows = [f"{i * 0.01:.2f},{i * 0.04:.4f},{i * 0.5:.4f}" for i in range(60)]
    rows[30] = rows[30].replace("15.0000", "150000")
    one = refusal(export(tmp_path / "lost.csv", rows))
    assert (one.code, one.line, one.column) == ("damaged_number", 35, 3)
    # where decimals vary it may be meant: read, and said
    rows = [f"{i * 0.01:g},{i * 0.04 + 0.001:g},{i * 0.53 + 0.03:g}" for i in range(60)]
    rows[30] = rows[30].replace("15.93", "1593")
    trial = read(export(tmp_path / "varied.csv", rows))
    assert trial.force_N[30] == 1593.0
    assert "no_decimals" in {flag.code for flag in trial.flags}


def test_numbers_beyond_the_names_are_refused(tmp_path: Path) -> None:
    rows = [f"0,{i:02d},1,{i:02d},2,{i:02d}" for i in range(40)]
    one = refusal(export(tmp_path / "comma.csv", rows))
    assert (one.code, one.line, one.column) == ("ragged_rows", 5, 4)
    assert "decimal comma" in one.message


def test_a_second_head_with_other_units_is_refused_and_the_same_head_is_said(tmp_path: Path) -> None:
    rows = [f"{i * 0.01:.2f},{i * 0.04:.4f},{i * 0.5:.4f}" for i in range(40)]
    again = [*rows[:20], "Time,Extension,Load", "(sec),(mm),(N)", *rows[20:]]
    trial = read(export(tmp_path / "same.csv", again))
    assert trial.time_s.size == 40
    assert [flag.values["lines"] for flag in trial.flags if flag.code == "rows_skipped"] == [[25, 26]]
    other = [line.replace("(N)", "(kN)") for line in again]
    one = refusal(export(tmp_path / "other.csv", other))
    assert one.line == 26
