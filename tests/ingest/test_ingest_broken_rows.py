"""Rows from which on a file is no longer what it was: refused or said, with the line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ingest_files import codes, put, read, refusal, workbook

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


def test_the_sound_table_is_read_without_a_word(tmp_path: Path) -> None:
    assert read(written(tmp_path / "a.csv", table())).flags == ()


@pytest.mark.parametrize(
    ("lost", "column"),
    [(slice(25, COUNT), 2), (slice(200, COUNT), 2), (slice(380, COUNT), 2), (slice(120), 1)],
)
def test_a_decimal_mark_lost_from_a_row_on_or_up_to_one_is_refused(
    tmp_path: Path, lost: slice, column: int
) -> None:
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


def test_a_rupture_and_a_number_of_four_digits_are_no_broken_rows(tmp_path: Path) -> None:
    force = FORCE.copy()
    force[120:] = -0.01 + np.random.default_rng(5).normal(0.0, 1e-3, COUNT - 120)
    for values in (force, np.where(np.arange(COUNT) < 100, FORCE, np.round(1e3 * FORCE) / 1e3)):
        rows = [[cell(v) for v in row] for row in zip(TIME, TRAVEL, values, strict=True)]
        assert read(written(tmp_path / "a.csv", rows)).time_s.size == COUNT
    # significant digits: decimals end where the number has enough of them
    steep = np.linspace(5.0, 4000.0, COUNT)
    rows = [
        [cell(t), cell(x), f"{f:.4g}".replace(".", ",")] for t, x, f in zip(TIME, TRAVEL, steep, strict=True)
    ]
    assert read(written(tmp_path / "b.csv", rows)).time_s.size == COUNT
