"""Several recordings in one text, below or beside each other, and cells that say what they hold."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from ingest_files import codes, put, refusal, workbook, zipped

from tissueid.errors import InputError
from tissueid.ingest import ReadOptions, read_each, read_one, read_trials
from tissueid.ingest.side_by_side import specimen_columns
from tissueid.segment import segment

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


@pytest.mark.parametrize(
    "head",
    [
        "B\nTime (s),Extension (um),Load (mN)\n",
        "\nTime,Extension,Load\ns,um,mN\n",
        "Units,s,um,mN\nTime,Extension,Load\n",
    ],
)
def test_a_head_in_other_units_begins_another_recording(tmp_path: Path, head: str) -> None:
    text = "A\n" + HEAD + "".join(lines(30, 1.0)) + head + "".join(lines(30, 1.0))
    first, second = read_trials(put(tmp_path / "a.csv", text))
    assert (first.displacement_mm[2], first.force_N[2]) == (0.1, 1.5)
    assert (second.displacement_mm[2], second.force_N[2]) == pytest.approx((1e-4, 1.5e-3))
    later = "".join(lines(30, 8.5, start=3.0))
    assert refusal(put(tmp_path / "b.csv", text.rsplit("0.0,", 1)[0] + later)).code == "ragged_rows"


def test_a_head_of_exchanged_columns_begins_another_recording(tmp_path: Path) -> None:
    text = HEAD + "".join(lines(30, 1.0)) + "Time (s),Load (N),Extension (mm)\n" + "".join(lines(30, 1.0))
    assert read_trials(put(tmp_path / "a.csv", text))[1].displacement_mm[2] == 1.5


def test_a_segment_of_labview_whose_time_starts_again_is_a_recording(tmp_path: Path) -> None:
    def segment_in(units: str, start: float) -> str:
        head = f"Channels\t2\t\t\nTime\t10:11:12\t10:11:12\t\nY_Unit_Label\t{units}\t\n***End_of_Header***\n"
        return head + "X_Value\tZ\tLoad\tComment\n" + "".join(lines(30, 1.0, start=start)).replace(",", "\t")

    top = "LabVIEW Measurement\t\n***End_of_Header***\n\n"
    text = top + segment_in("mm\tN", 0.0) + segment_in("mm\tN", 3.0) + segment_in("um\tmN", 0.0)
    first, second = read_trials(put(tmp_path / "a.lvm", text))
    assert (first.time_s.size, second.time_s.size) == (60, 30)
    assert second.force_N[2] == pytest.approx(1.5e-3)


@pytest.mark.parametrize("between", [[["B"]], [["B", None, None], ["s", "um", "mN"]], [[], [None]]])
def test_recordings_below_each_other_in_a_sheet_are_read(tmp_path: Path, between) -> None:
    names = ["Time", "Extension", "Load"]
    rows = [[float(cell) for cell in line.split(",")] for line in lines(30, 1.0)]
    path = workbook(tmp_path / "a.xlsx", {"S": [names, *rows, *between, names, *rows]})
    first, second = read_trials(path)
    assert [first.source.sheet, second.source.sheet] == ["S::1", "S::2"]
    scale = 1e-3 if len(between[-1]) > 1 else 1.0
    assert (first.force_N[2], second.force_N[2]) == pytest.approx((1.5, 1.5 * scale))
    rows[3][2] = "x"
    broken = workbook(tmp_path / "b.xlsx", {"S": [names, *rows[4:], *between, names, *rows]})
    assert [error.line for error in read_each(broken) if isinstance(error, InputError)] == [32 + len(between)]


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


TIME = np.arange(0.0, 4.0, 0.01)
DEPTH = np.clip(2.0 * (TIME - 0.5), 0.0, 4.0)
FORCE = 3.0 * DEPTH
POUND_N = 4.4482216152605


def rows(form: str) -> str:
    return "".join(form.format(t=t, x=x, f=f) for t, x, f in zip(TIME, DEPTH, FORCE, strict=True))


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
        (b"\x93NUMPY\1", "numpy.load(FILE)"),
        (b"PAR1\x15", "pandas.read_parquet(FILE)"),
        (b"ARROW1\0\0", "pandas.read_feather(FILE)"),
        (b"\x80\4\x95", "pandas.read_pickle(FILE)"),
    ],
)
def test_files_of_programs_are_refused_by_what_they_are(tmp_path: Path, data: bytes, kind: str) -> None:
    (tmp_path / "a.mat").write_bytes(data + bytes(200))
    error = refused(tmp_path / "a.mat", "not_an_export")
    assert kind in str(error)
    assert "or save its columns as CSV" in str(error)


def test_an_archive_of_arrays_and_formulas_without_values_say_how_they_are_saved(tmp_path: Path) -> None:
    arrays = put(tmp_path / "a.npz", zipped({"t.npy": b"\x93NUMPY", "x.npy": b"\x93NUMPY"}))
    assert "numpy.load(FILE)" in refused(arrays, "not_an_export").message
    rows = [["Time (s)", "Extension (mm)", "Load (N)"], *([k, k, f"={k}*2"] for k in range(9))]
    error = refused(workbook(tmp_path / "a.xlsx", {"S": rows}), "empty_cell")
    assert "if formulas stand there, open the workbook" in error.message
