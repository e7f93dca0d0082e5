"""Numbers that lost their decimal marks are refused or said, synthetic exports."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tissueid.errors import InputError
from tissueid.ingest import ReadOptions, read_each, read_trials

HEAD = 'Text Inputs : Specimen label,"synthetic"\n\nTime,Extension,Load\n(sec),(mm),(N)\n'


def export(path: Path, rows: list[str]) -> Path:
    path.write_text(HEAD + "\n".join(rows) + "\n", encoding="ascii")
    return path


def test_travel_beyond_any_machine_is_refused_with_its_column(tmp_path: Path) -> None:
    rows = [f"{i * 0.01:.2f},{i * 4167:06d},{i * 0.5:.4f}" for i in range(1, 200)]
    (one,) = read_each(export(tmp_path / "lost.csv", rows))
    assert isinstance(one, InputError)
    assert one.code == "implausible_range"
    assert "'Extension'" in one.message
    assert "5000 mm" in one.message


def test_force_beyond_any_machine_is_refused(tmp_path: Path) -> None:
    rows = [f"{i * 0.01:.2f},{i * 0.04:.4f},{i * 266000}" for i in range(1, 200)]
    (one,) = read_each(export(tmp_path / "lost.csv", rows))
    assert isinstance(one, InputError)
    assert one.code == "implausible_range"


def test_whole_numbers_throughout_are_said(tmp_path: Path) -> None:
    (trial,) = read_trials(export(tmp_path / "whole.csv", [f"{i},{i * 3},{i * i}" for i in range(40)]))
    assert "no_decimals" in {flag.code for flag in trial.flags}
    rows = [f"{i},{i * 3 + 0.25},{i * i + 0.5}" for i in range(40)]
    (trial,) = read_trials(export(tmp_path / "not.csv", rows))
    # seconds may well be whole
    assert "no_decimals" not in {flag.code for flag in trial.flags}
    (trial,) = read_trials(export(tmp_path / "one.csv", [f"{i},{i * 3},{i * i + 0.5}" for i in range(40)]))
    (flag,) = (flag for flag in trial.flags if flag.code == "no_decimals")
    assert flag.values["quantity"] == "displacement"


def test_a_unit_of_the_user_against_that_of_the_file_is_said(tmp_path: Path) -> None:
    path = export(tmp_path / "log.csv", [f"{i * 0.01:.2f},{i * 0.04:.4f},{i * 0.5:.4f}" for i in range(40)])
    (trial,) = read_trials(path, ReadOptions(units={"force": "kN"}))
    (flag,) = (flag for flag in trial.flags if flag.code == "unit_overridden")
    assert flag.values["quantity"] == "force"
    np.testing.assert_allclose(trial.force_N[2], 1000.0)
    (trial,) = read_trials(path, ReadOptions(units={"force": "N"}))
    assert not trial.flags
