"""Where the table stands in a file: delimiter, header, names, units, first row, decimal mark.

The table is the longest run of rows of numbers in the head of the file.  The names are sought above
it, the units below the names; what stands higher is the header.  Nothing depends on blank lines: a
Bluehill file may begin with one, or have none.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from tissueid.ingest.columns import has_channels
from tissueid.ingest.numbers import decimal_evidence, looks_numeric
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import HEAD_BYTES, Text
from tissueid.units import quantity_of

__all__ = ["Anchor", "Layout", "Row", "anchor", "find_layout", "is_units_row", "split_line"]

Row = tuple[str, ...]

_DELIMITERS = (";", "\t", "|", ",")
_TAIL_BYTES = 1 << 12
#: Lines in which the table is sought, and how many of the last of them vote on the delimiter.
_HEAD_LINES = 200
_SCORED_LINES = 100
_BRACKETED = re.compile(r"\s*[(\[].*[)\]]\s*")


@dataclass(frozen=True, slots=True)
class Anchor:
    """Rows of a table by their number, counted from 0; ``None`` where there is no such row."""

    names: int | None
    units: int | None
    first: int


@dataclass(frozen=True, slots=True)
class Layout:
    """How a text file is laid out.

    Attributes
    ----------
    delimiter, decimal : str
    header : tuple of Row
        Lines above the names, cut into cells.
    names, units : Row
        Padded to ``n_columns``; empty texts where the file has none.
    units_in_row : bool
        Whether there is a units row.
    names_line : int or None
        One-based.
    first_line : int
        One-based line at which the rows begin.
    offset : int
        Byte at which the rows begin.
    n_columns : int
    numeric : tuple of bool
        Which columns hold numbers in the sample.
    """

    delimiter: str
    decimal: str
    header: tuple[Row, ...]
    names: Row
    units: Row
    units_in_row: bool
    names_line: int | None
    first_line: int
    offset: int
    n_columns: int
    numeric: tuple[bool, ...]


def split_line(line: str, delimiter: str) -> Row:
    """The cells of a header line, quotes removed; forgiving, unlike the reader of rows."""
    line = line.rstrip("\r\n")
    if '"' not in line:
        return tuple(line.split(delimiter))
    try:
        return tuple(next(csv.reader([line], delimiter=delimiter)))
    except (csv.Error, StopIteration):
        return tuple(line.split(delimiter))


def _numeric_share(row: Row) -> float:
    """The share of a row's filled cells that look numeric, 0 where fewer than two do."""
    filled = [cell for cell in row if cell.strip()]
    numeric = sum(map(looks_numeric, filled))
    return numeric / len(filled) if numeric >= 2 else 0.0


def is_units_row(row: Row) -> bool:
    """Whether a row states units: ``(sec),(mm),(N),,`` or ``"s","mm","N"``."""
    filled = [cell.strip() for cell in row if cell.strip()]
    if not filled or any(map(looks_numeric, filled)):
        return False
    if all(_BRACKETED.fullmatch(cell) for cell in filled):
        return True
    known = sum(quantity_of(cell) is not None or _BRACKETED.fullmatch(cell) is not None for cell in filled)
    return len(filled) >= 2 and known >= 2 and 2 * known > len(filled)


def anchor(rows: Sequence[Row], options: ReadOptions) -> Anchor | None:
    """Find names, units and first row of the longest run of rows of numbers.

    Parameters
    ----------
    rows : sequence of Row
        The head of the table, blank rows included.
    options : ReadOptions
        The user's names count as names.

    Returns
    -------
    Anchor or None
        ``None`` where no row holds two numbers.
    """
    best, best_length = -1, 0
    start, length = -1, 0
    for index, row in enumerate(rows):
        if not any(cell.strip() for cell in row):
            continue
        if _numeric_share(row) >= 0.5:
            start, length = (index, 1) if length == 0 else (start, length + 1)
            if length > best_length:
                best, best_length = start, length
        else:
            length = 0
    if best < 0:
        return None
    above = [i for i in range(best - 1, -1, -1) if any(cell.strip() for cell in rows[i])]
    for index in above:
        if _numeric_share(rows[index]) > 0.0 or is_units_row(rows[index]):
            continue
        following = [i for i in range(index + 1, best) if any(cell.strip() for cell in rows[i])]
        units = following[0] if following and is_units_row(rows[following[0]]) else None
        if has_channels(rows[index], rows[units] if units is not None else (), options):
            return Anchor(index, units, (units if units is not None else index) + 1)
    return _anchor_without_words(rows, best, above)


def _anchor_without_words(rows: Sequence[Row], best: int, above: Sequence[int]) -> Anchor:
    """Names that are no known words: the line above the units, else the line above the numbers."""
    if not above:
        return Anchor(None, None, best)
    if is_units_row(rows[above[0]]):
        if len(above) > 1 and len(rows[above[1]]) >= 2 and len(rows[above[1]]) >= len(rows[above[0]]) - 1:
            return Anchor(above[1], above[0], best)
        if all(_BRACKETED.fullmatch(cell) for cell in rows[above[0]] if cell.strip()):
            return Anchor(None, above[0], best)
    row = rows[above[0]]
    named = sum(bool(cell.strip()) for cell in row) >= 2 and _numeric_share(row) == 0.0
    return Anchor(above[0] if named and len(row) >= len(rows[best]) - 1 else None, None, best)


def find_layout(text: Text, options: ReadOptions, place: Place) -> Layout:
    """Lay out a text file.

    Raises
    ------
    InputError
        ``not_an_export`` where there is no table, ``no_rows`` where it has no rows of numbers,
        ``ambiguous_decimal`` where point and comma can't be told apart.
    """
    head = text.data[:HEAD_BYTES]
    raw = head.splitlines(keepends=True)
    if len(text.data) > HEAD_BYTES:
        raw = raw[:-1]
    if not raw:
        place.refuse("not_an_export", f"the first line is longer than {HEAD_BYTES} bytes: this is no table")
    lines = [text.decode(line) for line in raw[:_HEAD_LINES]]
    delimiter = options.delimiter or _find_delimiter(lines)
    rows = [split_line(line, delimiter) for line in lines]
    found = anchor(rows, options)
    if found is None:
        raise _no_numbers(rows, delimiter, options, place)
    sample = [row for row in rows[found.first :] if _numeric_share(row) >= 0.5]
    n_columns = Counter(map(len, sample)).most_common(1)[0][0]
    names = _padded(rows[found.names] if found.names is not None else (), n_columns)
    units = _padded(rows[found.units] if found.units is not None else (), n_columns)
    decimal = options.decimal or _find_decimal(text, sample, delimiter, place, first=found.first, rows=rows)
    top = found.first if found.names is None else found.names
    return Layout(
        delimiter,
        decimal,
        tuple(row for row in rows[:top] if any(cell.strip() for cell in row)),
        names,
        units,
        found.units is not None,
        None if found.names is None else found.names + 1,
        found.first + 1,
        sum(map(len, raw[: found.first])),
        n_columns,
        tuple(all(i < len(row) and looks_numeric(row[i]) for row in sample[:50]) for i in range(n_columns)),
    )


def _padded(row: Row, n_columns: int) -> Row:
    """Empty cells at the end are added or dropped; a filled one stays and is refused later."""
    cells = list(row)
    while len(cells) > n_columns and not cells[-1].strip():
        cells.pop()
    return tuple(cells + [""] * (n_columns - len(cells)))


def _find_delimiter(lines: Sequence[str]) -> str:
    """The delimiter with which most cells of most lines are numbers; the first of equals."""

    def score(delimiter: str) -> float:
        return sum(_numeric_share(split_line(line, delimiter)) for line in lines[-_SCORED_LINES:])

    return max(_DELIMITERS, key=score)


def _no_numbers(rows: Sequence[Row], delimiter: str, options: ReadOptions, place: Place) -> Exception:
    for index, row in enumerate(rows):
        if has_channels(row, (), options):
            return place.refusal(
                "no_rows",
                "there is no row of numbers under the names; export the raw data again",
                line=index + 1,
            )
    filled = [index for index, row in enumerate(rows) if any(cell.strip() for cell in row)]
    line = filled[0] + 1 if filled else 1
    start = delimiter.join(rows[line - 1])[:60].strip() if rows else ""
    return place.refusal(
        "not_an_export",
        f"no line holds a row of numbers (the text begins {start!r}); give the raw data export of the"
        f" test machine",
        line=line,
    )


def _find_decimal(
    text: Text, sample: Sequence[Row], delimiter: str, place: Place, *, first: int, rows: Sequence[Row]
) -> str:
    """Point or comma, by the votes of the first rows and the last."""
    tail = [split_line(text.decode(line), delimiter) for line in text.data[-_TAIL_BYTES:].splitlines()[1:-1]]
    cells = [cell for row in (*sample, *tail) for cell in row if looks_numeric(cell)]
    points, commas, open_cells = decimal_evidence(cells)
    if points != commas:
        return "." if points > commas else ","
    if not open_cells:
        return "."
    for index, row in enumerate(rows[first:], start=first):
        for column, cell in enumerate(row):
            marks = cell.count(".") + cell.count(",")
            if not looks_numeric(cell) or marks == 0:
                continue
            if marks > 1:
                return "."  # damaged: the reader of rows will name it
            place.refuse(
                "ambiguous_decimal",
                f"{cell!r} may be a decimal number or a thousand and more, and no other cell decides;"
                " state the decimal mark with --decimal",
                line=index + 1,
                column=column + 1,
            )
    return "."
