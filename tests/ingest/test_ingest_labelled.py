"""Cells that say what they hold, specimens beside one time, and force curves saved as text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from ingest_files import refusal

from tissueid.errors import InputError
from tissueid.ingest import ReadOptions, read_each, read_trials
from tissueid.ingest.side_by_side import specimen_columns
from tissueid.segment import segment

TIME = np.arange(0.0, 4.0, 0.01)
DEPTH = np.clip(2.0 * (TIME - 0.5), 0.0, 4.0)
FORCE = 3.0 * DEPTH
POUND_N = 4.4482216152605


def rows(form: str) -> str:
    return "".join(form.format(t=t, x=x, f=f) for t, x, f in zip(TIME, DEPTH, FORCE, strict=True))


def put(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def refused(path: Path, code: str) -> InputError:
    error = refusal(path)
    assert error.code == code
    return error


@pytest.mark.parametrize(
    ("form", "factor"),
    [
        ("t:{t:.3f} x:{x:.4f} F:{f:.4f}\n", 1.0),
        ("t={t:.3f}, pos={x:.4f} mm, force={f:.4f} mN\r\n", 1e-3),
        ("time: {t:.3f} s; depth: {x:.4f} mm; load: {f:.4f} lbf\n", POUND_N),
        ("t: {t:.3f} s x: {x:.4f} mm F: {f:.4f} kN\n", 1e3),
        ("t:{t:.3f}\tx:{x:.4f}\tF:{f:.4f}\n", 1.0),
    ],
)
def test_a_row_may_name_its_cells(tmp_path: Path, form: str, factor: float) -> None:
    (trial,) = read_trials(put(tmp_path / "a.txt", rows(form)))
    assert trial.time_s == pytest.approx(TIME, abs=1e-9)
    assert trial.displacement_mm == pytest.approx(DEPTH, abs=1e-4)
    assert trial.force_N == pytest.approx(factor * FORCE, abs=1e-4 * factor)


def test_names_of_the_head_stand_before_those_in_the_cells(tmp_path: Path) -> None:
    text = "Time (s),Position (mm),Load (mN),Phase\n" + rows("{t:.3f},{x:.4f},{f:.4f},Step=2\n")
    (trial,) = read_trials(put(tmp_path / "a.csv", text))
    assert trial.force_N == pytest.approx(1e-3 * FORCE, abs=1e-7)


@pytest.mark.parametrize(
    ("head", "form"),
    [
        ("Time,Position,Load\n", "{t:.3f} s,{x:.4f} mm,{f:.4f} lbf\n"),
        ("Time (s),Position (mm),Load\n", "{t:.3f},{x:.4f},{f:.4f}lbf\n"),
        ("Time (s),Position (mm),Load,Units\n", "{t:.3f},{x:.4f},{f:.4f},lbf\n"),
        ("Time,Position,Load,Unit\ns,mm,,\n", "{t:.3f},{x:.4f},{f:.4f},lbf\n"),
        ("Time Position Load\n", "{t:.3f} s {x:.4f} mm {f:.4f} lbf\n"),
    ],
)
def test_units_in_the_cells_are_those_of_the_column(tmp_path: Path, head: str, form: str) -> None:
    (trial,) = read_trials(put(tmp_path / "a.csv", head + rows(form)))
    assert trial.force_N == pytest.approx(POUND_N * FORCE, abs=1e-3)


def test_units_beside_a_column_of_a_workbook_are_its_own(tmp_path: Path) -> None:
    table = pd.DataFrame({"Time (s)": TIME, "Position (mm)": DEPTH, "Load": FORCE, "Units": "kgf"})
    table.to_excel(tmp_path / "a.xlsx", index=False)
    (trial,) = read_trials(tmp_path / "a.xlsx")
    assert trial.force_N == pytest.approx(9.80665 * FORCE, rel=1e-9, abs=1e-9)


def test_units_that_change_or_disagree_are_refused(tmp_path: Path) -> None:
    head, lines = "Time (s),Position (mm),Load,Units\n", rows("{t:.3f},{x:.4f},{f:.4f},N\n")
    changed = put(tmp_path / "a.csv", head + lines + "4.00,4.0,1.2,kN\n")
    assert "'N' and 'kN'" in str(refused(changed, "unit_conflict"))
    two = put(tmp_path / "b.csv", "Time,Position,Load,Units\ns,mm,kN,\n" + lines)
    assert "'kN' by its head and in 'N' by its cells" in str(refused(two, "unit_conflict"))
    other = put(tmp_path / "c.txt", rows("t:{t:.3f} x:{x:.4f} F:{f:.4f} N\n") + "t:4.0 x:4.0 F:1.2 kN\n")
    error = refused(other, "unit_conflict")
    assert (error.line, "'kN', elsewhere in 'N'" in str(error)) == (TIME.size + 1, True)


def together(path: Path, head: str, end: int = TIME.size) -> Path:
    lines = (
        f"{t:.2f},{x:.4f},{f:.4f}," + (f"{x:.4f},{2.0 * f:.4f},{x:.4f},{3.0 * f:.4f}" if i < end else ",,,")
        for i, (t, x, f) in enumerate(zip(TIME, DEPTH, FORCE, strict=True))
    )
    return put(path, head + "\n" + "\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("head", "sheets"),
    [
        ("Time (s),Disp 1 (mm),Force 1 (N),Disp 2 (mm),Force 2 (N),Disp 3 (mm),Force 3 (N)", "1 2 3"),
        ("Time,Displacement,Force,Displacement.1,Force.1,Displacement.2,Force.2", "1 2 3"),
        ("Time,S1 Pos,S1 Load,S2 Pos,S2 Load,S3 Pos,S3 Load\ns" + ",mm,N" * 3, "1 2 3"),
        ("Time,Liver disp,Liver force,Lung disp,Lung force,Heart disp,Heart force\ns" + ",mm,N" * 3, "1 2 3"),
        (",Liver,,Lung,,Heart,\nTime,Disp,Force,Disp,Force,Disp,Force\ns,mm,N,mm,N,mm,N", "Liver Lung Heart"),
    ],
)
def test_specimens_beside_one_time_are_trials(tmp_path: Path, head: str, sheets: str) -> None:
    trials = list(read_trials(together(tmp_path / "a.csv", head)))
    assert [one.source.sheet for one in trials] == sheets.split()
    for k, trial in enumerate(trials, 1):
        assert trial.force_N == pytest.approx(k * FORCE, abs=1e-4)
        assert trial.time_s == pytest.approx(TIME)


def test_a_specimen_beside_one_time_may_end_before_the_others(tmp_path: Path) -> None:
    head = "Time (s),Disp 1 (mm),Force 1 (N),Disp 2 (mm),Force 2 (N),Disp 3 (mm),Force 3 (N)"
    path = together(tmp_path / "a.csv", head, end=300)
    assert [one.time_s.size for one in read_trials(path)] == [TIME.size, 300, 300]
    pd.read_csv(path).to_excel(tmp_path / "b.xlsx", index=False)
    assert [one.time_s.size for one in read_trials(tmp_path / "b.xlsx")] == [TIME.size, 300, 300]
    damaged = path.read_text().replace("1.00,1.0000,3.0000,1.0000,6.0000", "1.00,1.0000,3.0000,1.0000,six")
    errors = [one for one in read_each(put(path, damaged)) if isinstance(one, Exception)]
    assert [(one.line, one.column) for one in errors] == [(102, 5)]


@pytest.mark.parametrize(
    "names",
    [
        "Time,Extension,Load,Compressive extension,Compressive load",
        "Time,Extension,Load,Corrected extension,Corrected load,Compressive extension,Compressive load",
        "Time,Pos X (mm),Force X (N),Pos Y (mm),Force Y (N),Pos Z (mm),Force Z (N)",
        "Time,Position,Force,Target position,Target force",
        "Time,Raw position,Raw force,Filtered position,Filtered force",
        "Time,Position,Force",
        "Position 1,Force 1,Position 2,Force 2",
    ],
)
def test_more_sensors_of_one_specimen_are_no_specimens(names: str) -> None:
    assert specimen_columns((), names.split(","), (), ReadOptions()) == []


JPK = """# xPosition: 1.0E-5
# segmentIndex: {index}
# springConstant: 0.05
#
# columns: {columns}
# fancyNames: "Height (measured)" "Vertical Tip Position" "Vertical Deflection" "Series Time"
# units: m m {unit} s
#
"""


def jpk(path: Path, columns: str, unit: str = "N") -> Path:
    form = "{:.6e} {:.6e} {:.6e} {:.4f}\n"
    lines = [
        form.format(1e-5 - 2e-6 * x, 1.1e-5 - 1e-6 * x, 1e-9 * f, t)
        for t, x, f in zip(TIME, DEPTH, FORCE, strict=True)
    ]
    heads = [JPK.format(index=k, columns=columns, unit=unit) for k in range(2)]
    return put(path, heads[0] + "".join(lines[:250]) + "\n" + heads[1] + "".join(lines[250:]))


def test_a_force_curve_saved_as_text_is_read_by_its_remarks(tmp_path: Path) -> None:
    path = jpk(tmp_path / "a.txt", "measuredHeight verticalTipPosition vDeflection seriesTime")
    (trial,) = read_trials(path)
    assert trial.source.recipe == "jpk-text"
    assert trial.time_s == pytest.approx(TIME)
    assert trial.displacement_mm == pytest.approx(1.1e-2 - 1e-3 * DEPTH, rel=1e-6)
    assert trial.force_N == pytest.approx(1e-9 * FORCE, abs=1e-15)
    codes = {flag.code for flag in (*trial.flags, *segment(trial).flags)}
    assert not codes & {"tension", "cantilever_bending", "units_assumed", "column_choice"}
    (bent,) = read_trials(jpk(tmp_path / "b.txt", "measuredHeight baselineHeight vDeflection seriesTime"))
    assert bent.displacement_mm == pytest.approx(1e-2 - 2e-3 * DEPTH, rel=1e-6)
    (flag,) = (one for one in bent.flags if one.code == "cantilever_bending")
    assert flag.values["stiffness_N_per_mm"] == pytest.approx(5e-5)


def test_a_deflection_in_volts_and_a_head_of_other_columns_are_refused(tmp_path: Path) -> None:
    names = "measuredHeight verticalTipPosition vDeflection seriesTime"
    volts = str(refused(jpk(tmp_path / "a.txt", names, unit="V"), "wrong_unit"))
    assert volts.endswith("or export it as N, calibrated")
    assert "--units" not in volts
    assert "names 3, the rows have 4" in str(refused(jpk(tmp_path / "b.txt", names[15:]), "ragged_rows"))


def test_tables_of_rarer_suffixes_are_found_in_a_folder(tmp_path: Path) -> None:
    text = "Time (s)\tDepth (mm)\tForce (N)\n" + rows("{t:.2f}\t{x:.4f}\t{f:.4f}\n")
    for name in ("a.tab", "b.ddf"):
        put(tmp_path / name, text)
    put(tmp_path / "readme.tab", "Nothing to see here.\n")
    assert [Path(one.source.path).name for one in read_trials(tmp_path)] == ["a.tab", "b.ddf"]


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"MATLAB 5.0 MAT-file", "a MATLAB file"),
        (b"TDSm\x0e\0\0\0", "a LabVIEW TDMS"),
        (b"\x93NUMPY\1", "NumPy"),
    ],
)
def test_files_of_programs_are_refused_by_what_they_are(tmp_path: Path, data: bytes, kind: str) -> None:
    (tmp_path / "a.mat").write_bytes(data + bytes(200))
    error = refused(tmp_path / "a.mat", "not_an_export")
    assert kind in str(error)
    assert str(error).endswith("or save its columns as CSV")
