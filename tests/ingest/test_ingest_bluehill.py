"""Bluehill CSV in its locales: languages, random dialects, cut files, spoilt cells."""

import random
from dataclasses import replace
from pathlib import Path

import pytest
from ingest_files import SPEED_MM_S, assert_equal, codes, log_of, put, read, refusal

from tissueid.errors import InputError
from tissueid.ingest import ReadOptions, read_each, read_trials
from tissueid.synth import Dialect, SyntheticLog, bluehill_csv
from tissueid.synth.bluehill import LANGUAGES

BARE, COMMA = Dialect(header=False), Dialect(delimiter=";", decimal=",")


def written(folder: Path, text: str, *, name: str = "Specimen_RawData_1.csv") -> Path:
    return put(folder / name, text, "ascii")


def printed(how: Dialect = BARE, count: int = 60) -> str:
    """An export of so many rows; the head of a bare one takes two lines."""
    return bluehill_csv(log_of(count), dialect=how).decode(how.encoding)


def test_spreadsheet_quotes_only_where_a_thousand_is_reached(tmp_path):
    lines = printed(Dialect(header=False, quoted=True, thousands=",")).splitlines()
    rows = ((cell if "," in cell else cell.strip('"') for cell in line.split('","')) for line in lines[2:])
    rows = (",".join(f'"{c}"' if "," in c else c for c in (c.strip('"') for c in row)) for row in rows)
    trial = read(written(tmp_path, "\r\n".join([*lines[:2], *rows, ""])))
    assert_equal(trial, "bare", log_of(60))


def test_header_gives_protocol_specimen_and_metadata(tmp_path):
    folder = tmp_path / "meat.is_trelax_RawData"
    folder.mkdir()
    head = "Text Inputs : Note\r\nGeneral : Operator,<Ninguno>\r\n"
    trial = read(written(folder, head + printed(Dialect())))
    assert (trial.protocol.kind, trial.protocol.speed_mm_s, trial.specimen) == ("trelax", SPEED_MM_S, "22L.3")
    assert trial.source.metadata["Test : Rate 1"] == "30.00000 mm/min"
    assert trial.source.metadata["Text Inputs : Note"] == ""


def test_files_are_their_own_specimens_unless_header_or_pattern_groups(tmp_path):
    paths = [written(tmp_path, printed(), name=f"cow{i}_log.csv") for i in (1, 2)]
    assert [t.specimen for t in read_trials(tmp_path)] == [str(path) for path in paths]
    grouped = read_trials(tmp_path, ReadOptions(specimen_by=r"(cow)\d"))
    assert {t.specimen for t in grouped} == {"cow"}
    labelled = written(tmp_path, printed(Dialect()), name="cow3_log.csv")
    assert read(labelled, ReadOptions(specimen_by=r"cow\d")).specimen == "cow3"


def test_choice_between_columns_is_a_rule_a_flag_and_can_be_overridden(tmp_path):
    names = "Time,Compressive extension,Extension,Compressive load,Load\r\n(s),(mm),(mm),(N),(N)\r\n"
    body = "".join(f"{i}.0,{i}.1,-{i}.1,{i}.2,-{i}.2\r\n" for i in range(9))
    path = written(tmp_path, names + body)
    trial = read(path)
    assert dict(trial.source.columns) == {"time": "Time", "displacement": "Extension", "force": "Load"}
    flags = {flag.values["quantity"]: flag for flag in trial.flags}
    assert flags["displacement"].values["alternatives"] == ["Compressive extension"]
    assert flags["force"].values["alternatives"] == ["Compressive load"]
    mapped = read(path, ReadOptions(columns={"force": "compressive load"}))
    assert mapped.force_N[3] == 3.2
    assert [flag.values["quantity"] for flag in mapped.flags] == ["displacement"]


def test_a_last_row_cut_anywhere_is_left_out_and_flagged_or_whole(tmp_path):
    text, log = printed(COMMA, 40), log_of(40)
    last = text.rstrip().rfind("\n") + 1
    for cut in range(last + 1, len(text) - 2):
        trial = read(written(tmp_path, text[:cut]))
        assert trial.time_s.size == 39, text[last:cut]
        (flag,) = trial.flags
        assert (flag.code, flag.values["line"]) == ("cut_row", text.count("\n"))
    for whole in (text[:-2], text[:-1], text):
        assert_equal(read(written(tmp_path, whole)), "bare", log)
    trial = read(written(tmp_path, text + "1234,5;3,2\r\n"))
    assert (trial.time_s.size, codes(trial)) == (40, ["cut_row"])


@pytest.mark.parametrize(
    ("tail", "size", "said"), [("0.0", 31, []), ("0.2", 31, ["cut_row"]), ("", 30, ["cut_row"])]
)
def test_a_last_zero_without_a_line_end_is_whole_where_zeros_are_left_off(tmp_path, tail, size, said) -> None:
    rows = "".join(f"{0.1 * k:.2f},{0.5 * k:.3f},{round(0.123 * k, 3)}\n" for k in range(30))
    trial = read(put(tmp_path / "a.csv", f"Time (s),Extension (mm),Load (N)\n{rows}3.00,15.000,{tail}"))
    assert (trial.time_s.size, codes(trial)) == (size, said)


def spoilt(line: int, cell: str, *, column: int = 2, how: Dialect = BARE) -> str:
    """A sound file of 60 rows with one cell replaced."""
    lines = printed(how).split("\r\n")
    cells = lines[line - 1].split(how.delimiter)
    cells[column - 1] = cell
    lines[line - 1] = how.delimiter.join(cells)
    return "\r\n".join(lines)


@pytest.mark.parametrize(
    ("cell", "code"),
    [
        ("abc", "text_in_numbers"), ("", "empty_cell"), ("NaN", "not_finite"), ("inf", "not_finite"),
        ("1e999", "not_finite"), ("1.234.5", "damaged_number"), ("1_000", "text_in_numbers"),
        ("0x10", "text_in_numbers"), ("-", "text_in_numbers"), ('"1"5', "damaged_number"),
        ('"2,11,0828.5"', "damaged_number"), ('"0,123.5"', "damaged_number"),
        ('"1,2345.5"', "damaged_number"), ('"1,234"', "ambiguous_decimal"),
        ('"1,23"', "inconsistent_decimal"), ("1.0,2.0", "ragged_rows"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("line", [3, 34, 61])
def test_a_bad_cell_is_refused_with_line_column_and_value(tmp_path, cell, code, line):
    error = refusal(written(tmp_path, spoilt(line, cell)))
    assert (error.code, error.line) == (code, line)
    assert error.column == {"ragged_rows": 4}.get(code, 1 if cell == '"1"5' else 2)
    assert str(line) in str(error)


@pytest.mark.parametrize(
    ("cell", "code"),
    [
        ("2,110,828", "damaged_number"), ("1.5", "inconsistent_decimal"), ("0.500", "inconsistent_decimal"),
        ("1.500", "ambiguous_decimal"), ("361.639.800", "damaged_number"),
    ],
)  # fmt: skip
def test_destroyed_decimals_in_a_decimal_comma_file(tmp_path, cell, code):
    error = refusal(written(tmp_path, spoilt(30, cell, how=COMMA)))
    assert (error.code, error.line, error.column) == (code, 30, 2)
    assert repr(cell) in error.message


def test_time_running_backwards_is_refused_at_its_line(tmp_path):
    error = refusal(written(tmp_path, spoilt(30, "3.0", column=1)))
    assert (error.code, error.line, error.column) == ("time_backwards", 30, 1)


def test_cr_only_without_names_is_refused_and_reads_with_a_map(tmp_path):
    path = written(tmp_path, "0.0,1.0,2.0\r0.1,1.1,2.1\r0.2,1.2,2.2")
    assert refusal(path).code == "no_columns"
    trial = read(path, ReadOptions(columns={"time": "#1", "displacement": "#2", "force": "#3"}))
    assert trial.force_N.tolist() == [2.0, 2.1, 2.2]
    assert codes(trial) == ["units_assumed"] * 3


@pytest.mark.parametrize(
    ("units", "code"), [("(foo)", "unknown_unit"), ("(mm)", "wrong_unit"), ("(MPa)", "wrong_unit")]
)
def test_units_that_do_not_fit_are_refused_and_can_be_stated(tmp_path, units, code):
    path = written(tmp_path, printed(replace(BARE, units=("(s)", "(mm)", units))))
    error = refusal(path)
    assert (error.code, error.column) == (code, 3)
    if code == "unknown_unit":
        assert_equal(read(path, ReadOptions(units={"force": "N"})), "bare", log_of(60))


def test_name_and_units_row_that_disagree_are_refused(tmp_path):
    names = ("Time", "Extension", "Load (kN)")
    assert refusal(written(tmp_path, printed(replace(BARE, names=names)))).code == "unit_conflict"


_UNICODE = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be")
#: Code pages that hold the letters of a language.
CODE_PAGES = {
    "en": ("ascii", "latin-1", "cp1250", "gbk"),
    "pl": ("cp1250",),
    "zh": ("gbk",),
    "ja": ("cp932",),
    **dict.fromkeys(("de", "fr", "es", "pt", "it"), ("latin-1", "cp1252")),
}
#: Delimiter, decimal mark, thousands separator.
MARKS = (
    (",", ".", ""), (",", ".", ","), (",", ",", ""),
    (";", ",", ""), (";", ",", "."), (";", ",", "\u00a0"), (";", ",", "\u202f"), (";", ".", "'"),
    ("\t", ",", ""), ("\t", ".", ""),
)  # fmt: skip
COLUMNS = ((), (), (("Segment ID", "", "22476"),), (("Comment", "(text)", "no remark"),))
COUNTS = (2, 3, 5, 8, 40, 150, 600)


def random_dialect(draw: random.Random) -> Dialect:
    """Any combination that an export could print."""
    language = draw.choice(list(LANGUAGES))
    encoding = draw.choice((*_UNICODE, *CODE_PAGES[language]))
    delimiter, decimal, thousands = draw.choice(MARKS)
    try:
        thousands.encode(encoding)
    except UnicodeEncodeError:
        thousands = ""
    newline = draw.choice(("\r\n", "\n", "\r"))
    windows = newline == "\r\n"
    names_carry_units = draw.random() < 0.3
    wrapped = draw.random() < 0.1
    return Dialect(
        delimiter=delimiter,
        decimal=decimal,
        thousands=thousands,
        quoted=bool(thousands) or delimiter == decimal or draw.random() < 0.4,
        encoding=encoding,
        names=LANGUAGES[language].names,
        header=draw.random() < 0.85,
        units_row=not names_carry_units,
        newline=newline,
        language=language,
        groups=draw.random() < 0.6,
        header_lines=draw.choice((0, 0, 5, 20, 48)),
        vertical=not wrapped and draw.random() < 0.25,
        units=("s", "mm", "N") if names_carry_units else ("(sec)", "(mm)", "(N)"),
        unit_in_names=names_carry_units,
        order=draw.choice(((0, 1, 2), (0, 2, 1), (2, 1, 0))),
        columns=draw.choice(COLUMNS),
        results=draw.choice(("", "", "before", "after")),
        wrapped=wrapped,
        lead=draw.choice(("", "\r\n")) if windows else "",
        end=draw.choice(("", "\r\r\n", "\r\n")) if windows else "",
    )


def fault(path: Path, dialect: Dialect, log: SyntheticLog) -> str | None:
    """The fault in the reading of one file, ``None`` where there is none."""
    (item,) = read_each(path)
    if isinstance(item, InputError):
        return f"refused: {item}"
    try:
        assert_equal(item, "bare", log)
    except AssertionError:
        return "other numbers"
    if dialect.header and (item.specimen, item.protocol.speed_mm_s) != ("22L.3", SPEED_MM_S):
        return f"specimen {item.specimen!r}, speed {item.protocol.speed_mm_s}"
    return None


@pytest.mark.parametrize(("seed", "count"), [(11, 60), pytest.param(12, 4000, marks=pytest.mark.slow)])
def test_random_dialects_read_back_exactly(tmp_path: Path, seed: int, count: int) -> None:
    draw, path, wrong = random.Random(seed), tmp_path / "synthetic.csv", []
    for _ in range(count):
        dialect = random_dialect(draw)
        log = log_of(draw.choice(COUNTS), start_s=draw.choice((0.0, 990.0)))
        path.write_bytes(bluehill_csv(log, dialect=dialect))
        found = fault(path, dialect, log)
        if found is not None:
            wrong.append(f"{found}; {log.time_s.size} rows, {dialect}")
    assert not wrong, "\n".join([f"{len(wrong)} of {count} dialects were misread", *wrong[:5]])
