"""Recipes for delimited text: Bluehill CSV, testXpert TRA, Optics11 Chiaro, any table with a column map.

They differ in how they are recognised; all are read by the same layout, columns and rows.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise

from tissueid.errors import InputError
from tissueid.flags import Flag
from tissueid.ingest.appended import Part, recordings
from tissueid.ingest.body import read_body
from tissueid.ingest.broken_rows import restart
from tissueid.ingest.columns import (
    Channels,
    ColumnChoice,
    channel_columns,
    choose_columns,
    has_channels,
    has_time,
)
from tissueid.ingest.header import header_entries, protocol_of, specimen_in, stated_interval
from tissueid.ingest.layout import Layout, split_line
from tissueid.ingest.numbers import Row, parse_number
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.recipe import NOT_MINE, Detection, InputFile, Recipe, Table
from tissueid.ingest.refusals import Place
from tissueid.ingest.rows import flag_head, row_like, skipped_flag
from tissueid.ingest.text import Text
from tissueid.ingest.vocabulary import CHANNELS, is_comment_name, plain_words, specimen_key_rank, split_name

_GROUPED_KEY = re.compile(r"[^:]{1,40} : \S.*")
_BLUEHILL_PATH = re.compile(r"\.is_[a-z]+(?:_RawData|_Exports)?(?:[/\\.]|$)|RawData", re.IGNORECASE)
#: Rows in which a time of another name is looked for.
_ROWS_LOOKED_AT = 20
_TESTXPERT_WORDS = re.compile(r"standard (?:force|travel)|(?:force|course) standard|standard(?:kraft|weg)")


def _units_bracketed(layout: Layout) -> bool:
    filled = [unit.strip() for unit in layout.units if unit.strip()]
    return layout.units_in_row and all(unit[0] in "([" for unit in filled)


def _is_testxpert(file: InputFile, layout: Layout) -> str | None:
    """Why the file is testXpert's, or ``None``."""
    if file.suffix == ".tra":
        return "the suffix is .TRA"
    words = [name for name in layout.names if _TESTXPERT_WORDS.fullmatch(plain_words(name))]
    if words and layout.units_in_row and not _units_bracketed(layout):
        return f"the column {words[0]!r} is named as testXpert does and its unit has no brackets"
    return None


def detect_bluehill(file: InputFile) -> Detection:
    """Grouped header keys, a specimen key, a units row in brackets, or names with units in brackets."""
    layout = file.layout
    if layout is None or not has_channels(layout.names, layout.units, file.options):
        return NOT_MINE
    if _is_testxpert(file, layout):
        return NOT_MINE
    for row in layout.header:
        if _GROUPED_KEY.fullmatch(row[0]):
            return 0.95, f"the header has keys such as {row[0]!r}"
        if specimen_key_rank(row[0]) is not None:
            return 0.9, f"the header has the key {row[0]!r}"
    if _units_bracketed(layout):
        return 0.9, "a row of units in brackets stands under the names"
    bracketed = [name for name in layout.names if split_name(name)[1] and name.rstrip().endswith(")")]
    if len(bracketed) >= 3:
        return 0.8, f"the names carry units in brackets, such as {bracketed[0]!r}"
    if _BLUEHILL_PATH.search(file.path):
        return 0.7, "the file or folder is named as Bluehill does"
    return NOT_MINE


def detect_testxpert(file: InputFile) -> Detection:
    """The suffix, or testXpert's names over units without brackets."""
    reason = None if file.layout is None else _is_testxpert(file, file.layout)
    return (0.97, reason) if reason else NOT_MINE


def detect_columns(file: InputFile) -> Detection:
    """Any table of numbers."""
    if file.layout is None:
        return NOT_MINE
    if file.options.columns:
        return 0.6, "the user named the columns"
    return 0.5, f"a table of numbers in {file.layout.n_columns} columns"


def read_delimited(file: InputFile) -> Iterator[Table | InputError]:
    """The recordings in the table of a text file: one, or several below each other."""
    place = Place(file.path)
    text, layout = file.laid_out()
    layout = _behind_row_names(text, layout, file.options)
    top = text.data[: layout.offset].splitlines()
    lines = [split_line(text.decode(line), layout.delimiter) for line in top]
    names = layout.names_line or 0
    if names and len(file.options.columns) < len(CHANNELS):
        _refuse_unnamed(text, layout, len(lines[names - 1]), place)
    said = flag_head(lines[: names - 1] if names else (), place)
    left_out = [n for n, row in enumerate(lines, 1) if n > names > 0 and row_like(" ".join(row))]
    if left_out:
        said = (*said, skipped_flag(left_out, "lines of numbers between names and rows"))
    whole = header_entries(layout.header)
    layout, options = _counted(text, layout, file.options, whole)
    choice = _choice(layout, options, place)
    wanted = [choice.index[channel] for channel in CHANNELS]
    parts = [] if choice.interval_s is not None else recordings(text, layout, wanted, place, options)
    for name, header, rows, own in parts or [Part(None, (), text, layout)]:
        try:
            metadata = whole | header_entries(header)
            table = read_table(rows, own, options, replace(place, sheet=name), metadata=metadata)
            yield replace(table, flags=(*table.flags, *said))
        except InputError as error:
            yield error


def _counted(
    text: Text, layout: Layout, options: ReadOptions, metadata: Mapping[str, str]
) -> tuple[Layout, ReadOptions]:
    """Layout and options of a table without a time, or with an empty one, whose header states a rate."""
    stated = None if "time" in options.columns else stated_interval(metadata, layout.decimal)
    if stated is None:
        return layout, options
    cells = zip(layout.names, (*_first_row(text, layout), *[""] * layout.n_columns), strict=False)
    names = tuple(name if cell.strip() else "" for name, cell in cells)
    if has_time(names, layout.units, options) or _rises(text, layout, options):
        return layout, options
    return replace(layout, names=names), replace(
        options, columns={**options.columns, "time": f"{stated!r} s"}
    )


def _first_row(text: Text, layout: Layout) -> Row:
    """The cells of the first line with any."""
    line = text.data[layout.offset :].lstrip(b"\r\n").split(b"\n", 1)[0]
    return split_line(text.decode(line), layout.delimiter)


def _rising(text: Text, layout: Layout, options: ReadOptions) -> Iterator[tuple[int, bool]]:
    """Columns of no channel that rise from row to row, each with whether it counts the rows."""
    taken = channel_columns(layout.names, options).values()
    lines = text.data[layout.offset :].split(b"\n", _ROWS_LOOKED_AT)[:_ROWS_LOOKED_AT]
    rows = [split_line(text.decode(line), layout.delimiter) for line in lines if line.strip()]
    for index in range(layout.n_columns):
        cells = [parse_number(row[index], layout.decimal) for row in rows if index < len(row)]
        steps = {b - a for a, b in pairwise(one for one in cells if isinstance(one, float))}
        if index not in taken and layout.numeric[index] and min(steps, default=0.0) > 0.0:
            yield index, steps == {1.0}


def _rises(text: Text, layout: Layout, options: ReadOptions) -> bool:
    """True where another column rises from row to row, and is no count of rows: the time, named otherwise."""
    return not all(counts for _, counts in _rising(text, layout, options))


def _behind_row_names(text: Text, layout: Layout, options: ReadOptions) -> Layout:
    """The layout with names as R writes them, shifted or behind an X, where the first column counts rows."""
    names = layout.names
    named = len(names) if all(names) else names.index("")
    # a mark at the end of each line leaves an empty column, which is none of the shift
    last = _first_row(text, layout)[named : named + 1]
    shifted = 1 < named < layout.n_columns and any(map(str.strip, last)) and not any(names[named:])
    own = ("", *names[:-1]) if shifted else ("", *names[1:])
    counted = names[0] == "X" not in options.columns.values() and has_channels(own, layout.units, options)
    if not (shifted or counted) or layout.units_in_row or not _counts_rows(text, layout):
        return layout
    return replace(layout, names=own)


def _counts_rows(text: Text, layout: Layout) -> bool:
    """True where the first column counts the rows, whatever its name."""
    bare = replace(layout, names=("",) * layout.n_columns, units=())
    return (0, True) in _rising(text, bare, ReadOptions())


def _refuse_unnamed(text: Text, layout: Layout, printed: int, place: Place) -> None:
    """Refuse numbers that no name says what they are: shifted rows, or decimal commas among commas."""
    named = max((i for i, name in enumerate(layout.names, 1) if name.strip()), default=0)
    numbers = [i for i in range(layout.n_columns) if layout.numeric[i]]
    unnamed = [i for i in numbers if i >= named]
    comments = [i for i, name in enumerate(layout.names) if is_comment_name(name)]
    way_out = (
        "Export with another delimiter, or name the columns by --columns time=#1,displacement=#2,force=#3"
    )
    if unnamed and (printed <= unnamed[-1] or len(unnamed) >= named):
        message = (
            f"the names row has {named} names, the rows {layout.n_columns} cells with numbers: a decimal"
            f" comma that is also the delimiter? {way_out}"
        )
        place.refuse("ragged_rows", message, line=layout.first_line, column=unnamed[0] + 1)
    asked = [i for i in numbers if i in comments or (comments and not layout.names[i].strip())]
    if asked and not (asked == [0] and _counts_rows(text, layout)):
        what = f"under {layout.names[asked[0]]!r}" if asked[0] in comments else "without a name"
        message = (
            f"column {asked[0] + 1} {what} holds numbers: are the names shifted against the rows? {way_out}"
        )
        place.refuse("ragged_rows", message, line=layout.first_line, column=asked[0] + 1)


def read_table(
    text: Text, layout: Layout, options: ReadOptions, place: Place, *, metadata: Mapping[str, str]
) -> Table:
    """One laid-out table: its columns chosen, its rows read."""
    choice, columns, flags = _continuous(text, layout, options, place)
    return Table(
        *columns,
        choice.names,
        sheet=place.sheet,
        encoding=text.encoding,
        delimiter=layout.delimiter,
        decimal=layout.decimal,
        metadata=metadata,
        specimen=specimen_in(metadata),
        flags=(*text.flags, *choice.flags, *flags),
        axes=choice.axes,
    )


def _continuous(
    text: Text, layout: Layout, options: ReadOptions, place: Place
) -> tuple[ColumnChoice, Channels, list[Flag]]:
    """Columns and rows, of a displacement that starts again at each turn where no other fits and does not."""
    first = choice = _choice(layout, options, place)
    if choice.interval_s is not None:
        counters = (index for index, counts in _rising(text, layout, options) if counts)
        choice = replace(choice, counter=next(counters, None))
    columns, flags = read_body(text, layout, choice, place)
    columns, more = choice.timed(
        columns, lambda other: read_body(text, layout, other, place)[0], place, layout.first_line
    )
    flags = [*flags, *more]
    read = columns, flags
    said = [flag.values for flag in choice.flags if flag.values.get("quantity") == "displacement"]
    names = [name for values in said for name in values.get("alternatives", ())]
    while restart(columns[0], columns[1]) is not None:
        if not names:
            return first, *read
        name, counter = names.pop(0), first.names["displacement"]
        other = replace(options, columns={**options.columns, "displacement": name})
        try:
            choice = _choice(layout, other, place)
            columns, flags = read_body(text, layout, choice, place)
        except InputError:
            continue
        words = f"displacement was taken from {name!r}, not from {counter!r}, which starts again at each turn"
        values = {"quantity": "displacement", "taken": name, "alternatives": [counter]}
        flags = [*flags, Flag("column_choice", words, values)]
    return choice, columns, flags


def _choice(layout: Layout, options: ReadOptions, place: Place) -> ColumnChoice:
    if len(layout.names) > layout.n_columns:
        message = (
            f"the names row has {len(layout.names)} cells, the rows {layout.n_columns}; export the file again"
        )
        place.refuse("ragged_rows", message, line=layout.first_line, column=layout.n_columns + 1)
    return choose_columns(
        layout.names,
        layout.units,
        options=options,
        place=place,
        line=layout.names_line or layout.first_line,
        clock=layout.clock,
    )


BLUEHILL_CSV = Recipe(
    "bluehill-csv", "Instron Bluehill raw data, CSV in any locale", detect_bluehill, read_delimited
)
TESTXPERT_TRA = Recipe(
    "testxpert-tra", "ZwickRoell testXpert text export (.TRA)", detect_testxpert, read_delimited
)
COLUMNS_TEXT = Recipe(
    "columns", "any delimited text, by known names or the user's column map", detect_columns, read_delimited
)

# Piuma and Chiaro: "D[Z1] (nm)<tab>10000.000<tab>t[1] (s)<tab>2.000" in the header says where the piezo goes
# and in which time; a step to the same place is a hold.
_STEP = re.compile(r"([-+\d.,]+) t\[\d\] \(s\) ([-+\d.,]+)")
_NM_TO_MM = 1e-6
_COLUMNS = frozenset({"time", "load", "indentation", "cantilever", "piezo"})


def detect_chiaro(file: InputFile) -> Detection:
    """The columns of a cantilever indenter."""
    printed = () if file.layout is None else file.layout.names
    if {plain_words(split_name(name)[0]) for name in printed} >= _COLUMNS:
        return 0.98, "the columns are those of a cantilever on a piezo: Load, Indentation, Cantilever, Piezo"
    return NOT_MINE


def read_chiaro(file: InputFile) -> Iterator[Table | InputError]:
    """The one table, with the tip and the sweep of the header as its protocol."""
    for item in read_delimited(file):
        if isinstance(item, InputError):
            yield item
            continue
        stated = protocol_of(item.metadata, file.path, decimal=item.decimal)
        steps = _sweep(item.metadata)
        if stated.speed_mm_s is None and steps and steps[0][0] != 0.0:
            stated = replace(stated, speed_mm_s=abs(steps[0][0]) / steps[0][1])
        if stated.hold_s is None and len(steps) > 1 and steps[1][0] == steps[0][0]:
            stated = replace(stated, hold_s=steps[1][1])
        yield replace(item, protocol=stated)


def _sweep(metadata: Mapping[str, str]) -> list[tuple[float, float]]:
    """The steps of the piezo up to the first that is not used: where to [mm], and in which time [s]."""
    steps: list[tuple[float, float]] = []
    for number in range(1, 10):
        match = _STEP.fullmatch(metadata.get(f"D[Z{number}] (nm)", ""))
        try:
            place, seconds = (
                (float(text.replace(",", ".")) for text in match.groups()) if match else (0.0, 0.0)
            )
        except ValueError:
            break
        if seconds <= 0.0:
            break
        steps.append((place * _NM_TO_MM, seconds))
    return steps


CHIARO = Recipe("chiaro", "Optics11 Piuma and Chiaro text (nano-indenter)", detect_chiaro, read_chiaro)
