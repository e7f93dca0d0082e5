"""Bluehill CSV in its locales: synthetic files by a plain writer, compared with the numbers written."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from ingest_files import put, read, refusal

from tissueid.ingest import ReadOptions, read_trials
from tissueid.trial import Trial

HEADER = (
    ("Text Inputs : Specimen label", "22L.3"),
    ("General : Start Date", "13/11/2018 5:14 PM"),
    ("Test : Rate 1", "10.00000", "mm/min"),
    ("Text Inputs : Note",),
    ("General : Operator", "<Ninguno>"),
)


def rows_of(count: int = 120, *, start_s: float = 990.0) -> list[tuple[Decimal, Decimal, Decimal]]:
    """Time past a thousand seconds, force past a thousand newtons, negative displacement."""
    places = Decimal("0.00001")
    return [
        (
            Decimal(repr(start_s + 0.25 * i)).quantize(places),
            Decimal(repr(-2.04726 - 0.01 * i)).quantize(places),
            Decimal(repr(12.5 * i - 4.319)).quantize(places),
        )
        for i in range(count)
    ]


def printed(value: Decimal, decimal: str, thousands: str) -> str:
    text = f"{value:,.5f}" if thousands else f"{value:.5f}"
    return text.replace(",", "\0").replace(".", decimal).replace("\0", thousands)


def bluehill(
    rows, *, delimiter=",", decimal=".", thousands="", quoted=False, newline="\r\n", header=HEADER,
    names=("Time", "Extension", "Load"), units=("(sec)", "(mm)", "(N)"), end="", lead="",
) -> str:  # fmt: skip
    """A synthetic export; not the reader's grammar, only what machines print."""
    lines = [delimiter.join((key[0], *(f'"{key[1]}"' for _ in key[1:2]), *key[2:])) for key in header]
    if header:
        lines.append("")
    lines.append(delimiter.join(names))
    if units:
        lines.append(delimiter.join(units))
    for row in rows:
        cells = [printed(value, decimal, thousands) for value in row]
        lines.append(delimiter.join(f'"{cell}"' if quoted else cell for cell in cells))
    return lead + newline.join(lines) + newline + end


def write(
    folder: Path, text: str | bytes, *, encoding: str = "ascii", name: str = "Specimen_RawData_1.csv"
) -> Path:
    return put(folder / name, text if isinstance(text, bytes) else text.encode(encoding))


def assert_reads(path: Path, rows, options: ReadOptions | None = None) -> Trial:
    trial = read(path, options)
    # equal to the last bit: both are the double nearest to the same decimal digits
    for channel, recorded in enumerate((trial.time_s, trial.displacement_mm, trial.force_N)):
        np.testing.assert_array_equal(recorded, [float(row[channel]) for row in rows])
    return trial


#: Those that the table of exports has not.
DIALECTS = {
    "comma quoted": {"quoted": True},
    "semicolon quoted decimal comma": {"delimiter": ";", "decimal": ",", "quoted": True},
    "semicolon bare point thousands": {"delimiter": ";", "decimal": ",", "thousands": "."},
    "tab decimal comma": {"delimiter": "\t", "decimal": ","},
    "comma quoted decimal comma": {"decimal": ",", "quoted": True},
    "leading empty line": {"lead": "\r\n"},
    "no header, leading empty line": {"header": (), "lead": "\r\n"},
}


@pytest.mark.parametrize("dialect", DIALECTS.values(), ids=DIALECTS)
def test_each_dialect_reads_back_exactly(tmp_path, dialect):
    rows = rows_of()
    trial = assert_reads(write(tmp_path, bluehill(rows, **dialect)), rows)
    assert trial.source.recipe == "bluehill-csv"
    assert trial.source.delimiter == dialect.get("delimiter", ",")
    assert trial.source.decimal == dialect.get("decimal", ".")
    assert [flag.code for flag in trial.flags] == []


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_no_break_space_as_thousands_separator(tmp_path, encoding):
    rows = rows_of()
    text = bluehill(rows, delimiter=";", decimal=",", quoted=True, thousands="\u00a0")
    assert_reads(write(tmp_path, text, encoding=encoding), rows)


@pytest.mark.parametrize(
    ("encoding", "names", "label"),
    [
        ("utf-8-sig", ("Zeit", "Traversenweg", "Last"), "Probenbezeichnung"),
        ("latin-1", ("Temps", "Déplacement", "Charge"), "Libellé de l'éprouvette"),
        ("utf-8", ("Tiempo", "Extensión", "Carga"), "Etiqueta de probeta"),
        ("latin-1", ("Tiempo", "Extensión", "Carga"), "Etiqueta de probeta"),
        ("latin-1", ("Tempo", "Extensão", "Força"), "Rótulo do corpo de prova"),
        ("ascii", ("Tempo", "Spostamento", "Forza"), "Etichetta provino"),
        ("cp1250", ("Czas", "Przemieszczenie", "Obciążenie"), "Etykieta próbki"),
        ("utf-8", ("Godzina", "Przemieszczenie", "Obciążenie"), "Etykieta próbki"),
        ("gbk", ("时间", "位移", "力"), "试样标签"),
        ("utf-8", ("时间", "位移", "载荷"), "试样标签"),
        ("utf-16", ("Time", "Extension", "Load"), "Specimen label"),
    ],
)
def test_localised_names_and_encodings(tmp_path, encoding, names, label):
    rows = rows_of()
    text = bluehill(rows, delimiter=";", names=names, header=((f"Text : {label}", "A 7"),))
    trial = assert_reads(write(tmp_path, text, encoding=encoding), rows)
    assert trial.source.encoding == encoding
    assert dict(trial.source.columns) == dict(zip(("time", "displacement", "force"), names, strict=True))
    assert trial.specimen == "A 7"


def test_counters_without_units_and_comment_columns(tmp_path):
    rows = rows_of()
    body = "".join(f"{t},{f},{x},224,0,\r\n" for t, x, f in rows)
    head = "Time,Load,Extension,Segment ID,Total Cycle Count,Comment\r\n(sec),(N),(mm),,,note\r\n"
    assert_reads(write(tmp_path, head + body), rows)


def test_spreadsheet_quotes_only_where_a_thousand_is_reached(tmp_path):
    rows = rows_of()
    cells = ((printed(v, ".", "," if abs(v) >= 1000 else "") for v in row) for row in rows)
    body = "".join(",".join(f'"{c}"' if "," in c else c for c in row) + "\r\n" for row in cells)
    assert_reads(write(tmp_path, "Time,Extension,Load\r\n(s),(mm),(N)\r\n" + body), rows)


def test_whole_lines_quoted_by_a_spreadsheet(tmp_path):
    rows = rows_of()
    inner = bluehill(rows, quoted=True, thousands=",", header=()).splitlines()
    text = "".join('"' + line.replace('"', '""') + '"\r\n' for line in inner)
    assert_reads(write(tmp_path, text), rows)


def test_header_gives_protocol_specimen_and_metadata(tmp_path):
    folder = tmp_path / "meat.is_trelax_RawData"
    folder.mkdir()
    trial = read(write(folder, bluehill(rows_of())))
    assert trial.protocol.kind == "trelax"
    assert trial.protocol.speed_mm_s == pytest.approx(10 / 60, rel=1e-15)
    assert trial.specimen == "22L.3"
    assert trial.source.metadata["Test : Rate 1"] == "10.00000 mm/min"
    assert trial.source.metadata["Text Inputs : Note"] == ""


def test_files_are_their_own_specimens_unless_header_or_pattern_groups(tmp_path):
    paths = [write(tmp_path, bluehill(rows_of(), header=()), name=f"cow{i}_log.csv") for i in (1, 2)]
    assert [t.specimen for t in read_trials(tmp_path)] == [str(path) for path in paths]
    grouped = read_trials(tmp_path, ReadOptions(specimen_by=r"(cow)\d"))
    assert {t.specimen for t in grouped} == {"cow"}
    trial = read(write(tmp_path, bluehill(rows_of()), name="cow3_log.csv"), ReadOptions(specimen_by=r"cow\d"))
    assert trial.specimen == "cow3"


def test_choice_between_columns_is_a_rule_a_flag_and_can_be_overridden(tmp_path):
    names = ("Time", "Compressive extension", "Extension", "Compressive load", "Load")
    body = "".join(f"{i}.0,{i}.1,-{i}.1,{i}.2,-{i}.2\r\n" for i in range(9))
    path = write(tmp_path, f"{','.join(names)}\r\n(s),(mm),(mm),(N),(N)\r\n{body}")
    trial = read(path)
    assert dict(trial.source.columns) == {"time": "Time", "displacement": "Extension", "force": "Load"}
    flags = {flag.values["quantity"]: flag for flag in trial.flags}
    assert flags["displacement"].values["alternatives"] == ["Compressive extension"]
    assert flags["force"].values["alternatives"] == ["Compressive load"]
    mapped = read(path, ReadOptions(columns={"force": "compressive load"}))
    assert mapped.force_N[3] == 3.2
    assert [flag.values["quantity"] for flag in mapped.flags] == ["displacement"]


def test_a_last_row_cut_anywhere_is_left_out_and_flagged_or_whole(tmp_path):
    rows = rows_of(40)
    text = bluehill(rows, delimiter=";", decimal=",")
    last = text.rstrip().rfind("\n") + 1
    for cut in range(last + 1, len(text) - 2):
        trial = read(write(tmp_path, text[:cut]))
        assert trial.time_s.size == len(rows) - 1, text[last:cut]
        (flag,) = trial.flags
        assert flag.code == "cut_row"
        assert flag.values["line"] == text.count("\n")
    for whole in (text[:-2], text[:-1], text):
        assert_reads(write(tmp_path, whole), rows)


def test_a_short_last_row_with_its_line_end_is_cut_too(tmp_path):
    rows = rows_of(40)
    trial = read(write(tmp_path, bluehill(rows) + "1234.5,3.2\r\n"))
    assert trial.time_s.size == len(rows)
    assert [flag.code for flag in trial.flags] == ["cut_row"]


def test_lines_without_numbers_are_left_out_and_flagged(tmp_path):
    rows = rows_of(10)
    lines = bluehill(rows, header=()).splitlines(keepends=True)
    lines.insert(5, "paused by operator\r\n")
    trial = assert_reads(write(tmp_path, "".join(lines)), rows)
    (flag,) = trial.flags
    assert (flag.code, flag.values["lines"]) == ("rows_skipped", [6])


def spoilt(line: int, cell: str, *, column: int = 2, delimiter=",", decimal=".") -> str:
    """A sound file of 60 rows with one cell replaced."""
    lines = bluehill(rows_of(60), delimiter=delimiter, decimal=decimal).split("\r\n")
    cells = lines[line - 1].split(delimiter)
    cells[column - 1] = cell
    lines[line - 1] = delimiter.join(cells)
    return "\r\n".join(lines)


@pytest.mark.parametrize(
    ("cell", "code"),
    [
        ("abc", "text_in_numbers"),
        ("", "empty_cell"),
        ("NaN", "not_finite"),
        ("inf", "not_finite"),
        ("1e999", "not_finite"),
        ("1.234.5", "damaged_number"),
        ("1_000", "text_in_numbers"),
        ("0x10", "text_in_numbers"),
        ("-", "text_in_numbers"),
        ('"1"5', "damaged_number"),
        ('"2,11,0828.5"', "damaged_number"),
        ('"0,123.5"', "damaged_number"),
        ('"1,2345.5"', "damaged_number"),
        ('"1,234"', "ambiguous_decimal"),
        ('"1,23"', "inconsistent_decimal"),
        ("1.0,2.0", "ragged_rows"),
    ],
)
@pytest.mark.parametrize("line", [9, 40, 67])
def test_a_bad_cell_is_refused_with_line_column_and_value(tmp_path, cell, code, line):
    error = refusal(write(tmp_path, spoilt(line, cell)))
    assert (error.code, error.line) == (code, line)
    assert error.column == {"ragged_rows": 4}.get(code, 1 if cell == '"1"5' else 2)
    assert str(line) in str(error)


@pytest.mark.parametrize(
    ("cell", "code"),
    [
        ("2,110,828", "damaged_number"),
        ("1.5", "inconsistent_decimal"),
        ("0.500", "inconsistent_decimal"),
        ("1.500", "ambiguous_decimal"),
        ("361.639.800", "damaged_number"),
    ],
)
def test_destroyed_decimals_in_a_decimal_comma_file(tmp_path, cell, code):
    error = refusal(write(tmp_path, spoilt(30, cell, delimiter=";", decimal=",")))
    assert (error.code, error.line, error.column) == (code, 30, 2)
    assert repr(cell) in error.message


def test_a_whole_file_of_destroyed_decimals_names_its_first_bad_line(tmp_path):
    body = "".join(f"{361 + i}.639.800;30.137.143;2.110.828\r\n" for i in range(30))
    error = refusal(write(tmp_path, "Zeit;Traversenweg;Last\r\n(s);(mm);(N)\r\n" + body))
    assert (error.code, error.line, error.column) == ("damaged_number", 3, 1)


def test_time_running_backwards_is_refused_at_its_line(tmp_path):
    error = refusal(write(tmp_path, spoilt(30, "3.0", column=1)))
    assert (error.code, error.line, error.column) == ("time_backwards", 30, 1)


def test_numbers_that_can_be_decimal_or_grouped_need_the_users_word(tmp_path):
    body = "".join(f"{i + 1}.000;{i + 2}.500;{i + 3}.250\n" for i in range(20))
    path = write(tmp_path, "Time;Extension;Load\n(s);(mm);(N)\n" + body)
    assert refusal(path).code == "ambiguous_decimal"
    trial = read(path, ReadOptions(decimal="."))
    assert trial.displacement_mm[0] == 2.5


def test_cr_only_without_names_is_refused_and_reads_with_a_map(tmp_path):
    path = write(tmp_path, "0.0,1.0,2.0\r0.1,1.1,2.1\r0.2,1.2,2.2")
    assert refusal(path).code == "no_columns"
    columns = {"time": "#1", "displacement": "#2", "force": "#3"}
    trial = read(path, ReadOptions(columns=columns))
    assert trial.force_N.tolist() == [2.0, 2.1, 2.2]
    assert [flag.code for flag in trial.flags] == ["units_assumed"] * 3


@pytest.mark.parametrize(
    ("units", "code"), [("(foo)", "unknown_unit"), ("(mm)", "wrong_unit"), ("(MPa)", "wrong_unit")]
)
def test_units_that_do_not_fit_are_refused_and_can_be_stated(tmp_path, units, code):
    rows = rows_of()
    path = write(tmp_path, bluehill(rows, units=("(s)", "(mm)", units)))
    error = refusal(path)
    assert (error.code, error.column) == (code, 3)
    if code == "unknown_unit":
        assert_reads(path, rows, ReadOptions(units={"force": "N"}))


def test_name_and_units_row_that_disagree_are_refused(tmp_path):
    path = write(tmp_path, bluehill(rows_of(), names=("Time", "Extension", "Load (kN)")))
    assert refusal(path).code == "unit_conflict"
