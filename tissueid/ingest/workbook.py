"""Recipes for workbooks: one trial a sheet, .xlsx, .xls, .xlsb and .ods by python-calamine.

testXpert writes three head rows: the test's name over every column, the columns' names, their units.  A sheet
without time, displacement and force is passed over; a workbook without any trial is refused.
"""

from __future__ import annotations

import datetime as dt
import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any

import numpy as np
import python_calamine

from tissueid.errors import InputError
from tissueid.flags import Flag
from tissueid.ingest.broken_rows import refuse_broken
from tissueid.ingest.columns import Channels, ColumnChoice, channel_columns, choose_columns, has_channels
from tissueid.ingest.header import header_entries, specimen_in
from tissueid.ingest.labelled import FEWEST_ROWS, units_beside, with_units
from tissueid.ingest.layout import Anchor, anchor, results_below, results_flag
from tissueid.ingest.numbers import Row, decimal_evidence, looks_numeric, parse_number
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.recipe import NOT_MINE, Detection, InputFile, Recipe, Table, packed_kind
from tissueid.ingest.refusals import Place
from tissueid.ingest.rows import begins_a_table, flag_head
from tissueid.ingest.side_by_side import SpecimenColumns, specimen_columns
from tissueid.ingest.unpacking import BROKEN_ARCHIVE, too_much
from tissueid.ingest.vocabulary import CHANNELS

#: Rows looked at for names and units.
_HEAD_ROWS = 200
#: ... and for a table of results below the samples.
_TAIL_ROWS = 500
#: Names that a test program gives by itself: two workbooks may both have a "Specimen 1".
_DEFAULT_NAME = re.compile(
    r"(?:probe|specimen|eprouvette|éprouvette|probeta|provino|sample|test|essai|sheet|tabelle|feuil"
    r"|hoja)?[\s_#-]*\d*",
    re.IGNORECASE,
)

#: A formula whose value no spreadsheet has stored looks empty.
_OR_SAVE = "; if formulas stand there, open the workbook in a spreadsheet program and save it"

Cells = Sequence[Sequence[Any]]


def _open(data: bytes, place: Place) -> Any:
    try:
        reason = too_much(data) if data.startswith(b"PK") else None
        if reason is not None:
            message = f"the workbook is unreasonably large inside: {reason}; or export the tests as text"
            place.refuse("unreadable_workbook", message)
        return _guarded(lambda: python_calamine.CalamineWorkbook.from_filelike(io.BytesIO(data)))
    except (python_calamine.CalamineError, *BROKEN_ARCHIVE) as error:
        place.refuse(
            "unreadable_workbook",
            f"the file starts as a workbook but can't be opened ({str(error)[:120]}); save it again"
            " without password, or export the tests as text",
        )


def _guarded(parse: Callable[[], Any]) -> Any:
    """Result of the parser; where it panics, which no ``except Exception`` sees, an error as any other."""
    try:
        return parse()
    except BaseException as error:
        if type(error).__name__ != "PanicException":
            raise
        raise ValueError(f"the parser gave up: {error}") from error


def _cells(workbook: Any, sheet: str, place: Place) -> Cells:
    try:
        rows: Cells = _guarded(lambda: workbook.get_sheet_by_name(sheet).to_python(skip_empty_area=False))
    except (python_calamine.CalamineError, ValueError, OSError) as error:
        place.refuse("unreadable_workbook", f"the sheet can't be read ({str(error)[:120]})")
    return rows


def _head(cells: Cells) -> list[Row]:
    return _rows(cells[:_HEAD_ROWS])


def _rows(cells: Cells) -> list[Row]:
    return [tuple(map(_shown, row)) for row in cells]


def _shown(cell: Any) -> str:
    """A cell as text; numbers in the form that looks numeric."""
    return str(cell).strip() if not isinstance(cell, float) else repr(cell)


def _trial_anchor(cells: Cells, file: InputFile) -> Anchor | None:
    """Anchor of a trial's table in a sheet, ``None`` where the sheet is no trial."""
    head = _head(cells)
    found = anchor(head, file.options)
    if found is not None and found.names is not None and has_channels(*found.head(head), file.options):
        return found
    for index, row in enumerate(head[:5]):
        if has_channels(row, (), file.options):
            return Anchor(index, None, index + 1)
    return None


def _test_name(cells: Cells, found: Anchor) -> str | None:
    """The name that testXpert repeats above every column."""
    if not found.names:
        return None
    filled, named = (list(filter(None, row)) for row in _rows(cells[found.names - 1 : found.names + 1]))
    return filled[0] if len(filled) >= 2 and len(set(filled)) == 1 and len(filled) == len(named) else None


def detect_testxpert_workbook(file: InputFile) -> Detection:
    """One test name repeated over the columns of the first trial."""
    if packed_kind(file.data) != "workbook":
        return NOT_MINE
    with suppress(InputError):
        workbook = _open(file.data, Place(file.path))
        for sheet in workbook.sheet_names:
            cells = _cells(workbook, sheet, Place(file.path, sheet))
            found = _trial_anchor(cells, file)
            if found is not None and (name := _test_name(cells, found)) is not None:
                return 0.95, f"the test name {name!r} stands above every column"
            if found is not None:
                break
    return NOT_MINE


def detect_workbook(file: InputFile) -> Detection:
    """Any workbook."""
    return (0.6, "a workbook") if packed_kind(file.data) == "workbook" else NOT_MINE


def read_workbook(file: InputFile) -> Iterator[Table | InputError]:
    """Every trial of a workbook, in the order of its sheets."""
    workbook = _open(file.data, Place(file.path))
    trials: list[tuple[str, Cells, Anchor]] = []
    faults: dict[str, InputError] = {}
    for sheet in workbook.sheet_names:
        try:
            cells = _cells(workbook, sheet, Place(file.path, sheet))
        except InputError as error:
            faults[sheet] = error
            continue
        found = _trial_anchor(cells, file)
        if found is not None:
            trials.append((sheet, cells, found))
    yield from faults.values()
    names = Counter(name for _, cells, found in trials if (name := _test_name(cells, found)) is not None)
    for sheet, cells, found in trials:
        for number, block, head in _below_each_other(file, cells, found):
            for one in _side_by_side(file, block, head):
                name = "::".join([sheet, *([number] if number else ()), *([one.name] if one else ())])
                own = [one.of(row) for row in block] if one else block
                try:
                    yield _read_sheet(file, name, own, head, names=names)
                except InputError as error:
                    yield one.placed(error) if one else error
    if not trials and not faults:
        yield _no_trial(file, workbook)


def _below_each_other(file: InputFile, cells: Cells, found: Anchor) -> list[tuple[str, Cells, Anchor]]:
    """Recordings of a sheet with their numbers, at their rows: behind a head the time starts again."""
    whole = [("", cells, found)]
    head = found.head(_rows(cells[: found.first]))
    results = _results(cells, found, *head, file.options)
    time = channel_columns(head[0], file.options).get("time", len(cells[0]))
    filled = [
        (index, row[time])
        for index, row in enumerate(cells[:results])
        if index >= found.first and len(row) > time and type(row[time]) in (float, int)
    ]
    starts = [above + 1 for (above, before), (_, after) in pairwise(filled) if after < before]
    blocks: list[tuple[str, Cells, Anchor]] = []
    for number, (start, stop) in enumerate(pairwise([0, *starts, len(cells)]), 1):
        own = _trial_anchor(cells[start:stop], file)
        if own is None or own.names is None or stop - start - own.first < FEWEST_ROWS:
            return whole
        units = None if own.units is None else start + own.units
        rows = [*([()] * start), *cells[start:stop]]
        blocks.append((str(number), rows, Anchor(start + own.names, units, start + own.first)))
    return blocks if starts else whole


def _side_by_side(file: InputFile, cells: Cells, found: Anchor) -> Sequence[SpecimenColumns | None]:
    """The specimens that stand side by side in a sheet; None alone where it holds one trial."""
    if found.names is None:
        return [None]
    head = _rows(cells[: found.first])
    names, units = found.head(head)
    above = head[found.names - 1] if found.names else ()
    specimens = specimen_columns(above, names, units, file.options)
    return specimens if len(specimens) > 1 else [None]


def _no_trial(file: InputFile, workbook: Any) -> InputError:
    sheets = [str(name) for name in workbook.sheet_names]
    seen = ""
    for sheet in sheets:
        head = _head(_cells(workbook, sheet, Place(file.path, sheet)))
        found = anchor(head, file.options)
        if found is not None and found.names is not None:
            columns = ", ".join(repr(cell[:40]) for cell in head[found.names][:20] if cell)
            seen = f"; the columns of {sheet!r} are {columns}"
            break
    return Place(file.path).refusal(
        "no_trial_sheet",
        f"none of the sheets {', '.join(map(repr, sheets[:10]))}{' ...' if len(sheets) > 10 else ''}"
        f" holds time,"
        f" displacement and force{seen}; name them with --columns time=NAME,displacement=NAME,force=NAME",
    )


def _read_sheet(file: InputFile, sheet: str, cells: Cells, found: Anchor, *, names: Counter[str]) -> Table:
    place = Place(file.path, sheet)
    head = _rows(cells[: found.first])
    printed, units = found.head(head)
    beside = units_beside(printed, (tuple(map(_shown, row)) for row in cells[found.first :]), place)
    units = with_units(printed, units, beside, place)
    line = None if found.names is None else found.names + 1
    choice = choose_columns(printed, units, options=file.options, place=place, line=line)
    results = _results(cells, found, printed, units, file.options)
    stop = len(cells) if results is None else results
    above = () if found.names is None else flag_head(head[: found.names], place)
    columns, flags = _read_columns(cells[:stop], found.first, choice, place)
    columns, clock = choice.timed(
        columns, lambda other: _read_columns(cells[:stop], found.first, other, place)[0], place, line
    )
    flags += clock
    _refuse_other_heads(cells[:stop], flags, printed, units, place)
    if results is not None:
        flags.append(results_flag(results + 1, len(cells)))
    metadata = header_entries([row for row in head[: found.names] if any(row)])
    test = _test_name(cells, found)
    if test is not None:
        metadata = {"Test name": test}
    specimen = specimen_in(metadata)
    if specimen is None and test is not None and names[test] == 1 and not _DEFAULT_NAME.fullmatch(test):
        specimen = test
    return Table(
        *columns,
        choice.names,
        sheet=sheet,
        metadata=metadata,
        specimen=specimen,
        flags=(*choice.flags, *above, *flags),
        axes=choice.axes,
    )


def _refuse_other_heads(cells: Cells, flags: Sequence[Flag], names: Row, units: Row, place: Place) -> None:
    """Refuse rows left out as remarks that give other names or units: what follows is another recording."""
    for flag in flags:
        for number in flag.values["lines"] if flag.code == "rows_skipped" else ():
            if begins_a_table(tuple(map(_shown, cells[number - 1])), names, units):
                message = (
                    f"row {number} gives other names or units than the head of the sheet: two recordings in"
                    " one sheet; split it, one recording each"
                )
                place.refuse("mixed_tables", message, line=number, column=1)


def _results(cells: Cells, found: Anchor, names: Row, units: Row, options: ReadOptions) -> int | None:
    """The row at which a table of results begins below the samples, counted from 0."""
    start = max(found.first, len(cells) - _TAIL_ROWS)
    below = results_below(_rows(cells[start:]), names, units, options)
    return None if below is None else start + below


def _read_columns(
    cells: Cells, first: int, choice: ColumnChoice, place: Place
) -> tuple[Channels, list[Flag]]:
    """The three channels in s, mm, N; every cell must be stored as a number."""
    wanted = [choice.index[channel] for channel in CHANNELS]
    moment, mark = _first_moment(cells[first:], wanted[0]), _mark_of_texts(cells[first:], wanted)
    kept: list[tuple[int, list[Any]]] = []
    skipped: list[int] = []
    flags: list[Flag] = []
    for number, row in enumerate(cells[first:], start=first + 1):
        values = [row[index] if index < len(row) else "" for index in wanted]
        if moment is not None and isinstance(values[0], dt.datetime | dt.time | dt.timedelta):
            values[0] = _seconds_since(moment, values[0]) / choice.factors["time"]
        if mark is not None:
            parsed = [parse_number(value, mark) for value in values]
            values = [*parsed] if all(isinstance(number, float) for number in parsed) else values
        if all(type(value) in (float, int) for value in values):
            kept.append((number, values))
        elif not any(_shown(value) for value in values):
            continue
        elif not any(isinstance(cell, float | int) for cell in row):
            if all(looks_numeric(_shown(value)) for value in values):
                raise _bad_cell(values, wanted, number, place)
            skipped.append(number)
        elif number == len(cells) and any(_shown(value) == "" for value in values):
            message = f"row {number} is the last and incomplete: it was left out"
            flags.append(Flag("cut_row", message, {"line": number, "kept": False}))
        else:
            raise _bad_cell(values, wanted, number, place)
    if len(kept) < 2:
        message = f"the sheet has {len(kept)} rows of numbers, a recording needs two; export again{_OR_SAVE}"
        place.refuse("no_rows", message, line=first + 1)
    if skipped:
        message = f"{len(skipped)} rows without numbers were left out: {', '.join(map(str, skipped[:5]))}"
        flags.append(Flag("rows_skipped", message, {"count": len(skipped), "lines": skipped[:20]}))
    columns = list(np.array([values for _, values in kept], dtype=np.float64).T.copy())
    bad = np.argwhere(~np.isfinite(np.stack(columns, axis=1)))
    if bad.size:
        at, k = (int(index) for index in bad[0])
        message = f"{columns[k][at]} is not a finite number; correct or remove the row"
        place.refuse("not_finite", message, line=kept[at][0], column=wanted[k] + 1)
    columns = choice.counted(columns)
    fractional = [column != np.floor(column) for column in columns]
    refuse_broken(columns, fractional, "sheet", place, lambda row, k: (kept[row][0], wanted[k] + 1))
    return choice.scaled(columns), flags


def _mark_of_texts(rows: Cells, wanted: Sequence[int]) -> str | None:
    """Decimal mark of numbers that are stored as text in all three columns; None where it is not certain.

    One that a spreadsheet took for a number may have lost its mark.
    """
    values = [row[index] for row in rows for index in wanted if index < len(row) and row[index] != ""]
    if not all(isinstance(value, str) for value in values):
        return None
    points, commas, _ = decimal_evidence(filter(looks_numeric, values))
    return None if (points > 0) == (commas > 0) else "." if points else ","


def _first_moment(rows: Cells, column: int) -> dt.datetime | None:
    """Midnight before the time of the first row, where it is a date or a clock; None where it is a number."""
    value = rows[0][column] if rows and column < len(rows[0]) else ""
    if isinstance(value, dt.datetime):
        return dt.datetime.combine(value.date(), dt.time())
    return dt.datetime(1970, 1, 1) if isinstance(value, dt.time | dt.timedelta) else None


def _seconds_since(moment: dt.datetime, value: dt.datetime | dt.time | dt.timedelta) -> float:
    """Seconds since the midnight of the first row."""
    if isinstance(value, dt.timedelta):
        return value.total_seconds()
    at = value if isinstance(value, dt.datetime) else dt.datetime.combine(moment.date(), value)
    return (at - moment).total_seconds()


def _bad_cell(values: Sequence[Any], wanted: Sequence[int], number: int, place: Place) -> InputError:
    """The refusal of the first cell that is no number."""
    cells = zip(map(_shown, values), values, wanted, strict=True)
    shown, at = next((text, k + 1) for text, value, k in cells if type(value) not in (float, int))
    if not shown:
        message = f"the cell is empty; fill or remove the row{_OR_SAVE}"
        return place.refusal("empty_cell", message, line=number, column=at)
    message = (
        f"{shown[:40]!r} is stored as text or date, not as a number; go back to the original"
        " export, or save the sheet as CSV"
    )
    return place.refusal("text_in_numbers", message, line=number, column=at)


TESTXPERT_WORKBOOK = Recipe(
    "testxpert-workbook",
    "ZwickRoell testXpert workbook, one sheet a test",
    detect_testxpert_workbook,
    read_workbook,
)
WORKBOOK = Recipe(
    "workbook", "any workbook (.xlsx, .xls, .xlsb, .ods), one trial a sheet", detect_workbook, read_workbook
)
