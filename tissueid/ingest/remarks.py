"""Lines beside the rows of a table: remarks that may be passed over, and rows that may not.

A remark holds no number where a number could stand.  A line of digits that is no row of the table is a
damaged row, or a row of another table, and leaving it out would lose data.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from tissueid.flags import Flag
from tissueid.ingest.columns import has_channels
from tissueid.ingest.layout import Layout, Row, is_units_row, split_line
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.refusals import Place
from tissueid.ingest.results import announced_results, results_flag, results_spans
from tissueid.ingest.text import Text

_STARTS = re.compile(r"[\W_]*\d")
_EXPONENT = re.compile(r"(?<=\d)[eE][+-]?\d+")
#: Words with a letter: ``230403-FF1A`` is a specimen, not a number.
_NAMES = re.compile(r"[\w-]*[^\W\d_][\w-]*")
_NUMBERS = re.compile(r"\d+(?:[.,]\d+)?")
#: A clock or a date: remarks carry them.
_MOMENT = re.compile(r"(?<![\d.,])(?:\d{1,2}:\d{2}(?::\d{2})?|\d{1,4}([/.-])\d{1,2}\1\d{1,4})(?![\d.,])")
_GUID = re.compile(r"[0-9A-Fa-f]{8}-(?:[0-9A-Fa-f]{4}-){3}[0-9A-Fa-f]{12}")
#: Time, displacement and force.
_LEAST_NUMBERS = 3
#: So many rows above the names are a table of their own, fewer may be results.
_TABLE_ROWS = 3


def row_like(line: str) -> bool:
    """True where a line is made of numbers, by whatever delimiter: a row, be it sound or damaged.

    >>> row_like("0.10&-2e-05&1.50"), row_like("13.11.2018 17:14"), row_like("2304-A1,2304-A1,2304-A1")
    (True, False, False)
    """
    bare = _NAMES.sub("", _EXPONENT.sub("", line))
    digits, letters = sum(map(str.isdecimal, bare)), sum(map(str.isalpha, line))
    return (
        _STARTS.match(line) is not None
        and len(_NUMBERS.findall(bare)) >= _LEAST_NUMBERS
        and digits >= letters
        and _MOMENT.search(line) is None
        and _GUID.search(line) is None
    )


def begins_a_table(cells: Sequence[str], names: Sequence[str], units: Sequence[str]) -> bool:
    """True where a line among the rows gives names or units other than those of the table."""
    filled = _stripped(cells)
    if filled in (_stripped(names), _stripped(units)):
        return False
    return is_units_row(filled) or has_channels(filled, (), ReadOptions())


def _stripped(cells: Sequence[str]) -> tuple[str, ...]:
    """The cells without padding and without empty ones at the end."""
    filled = [cell.strip() for cell in cells]
    while filled and not filled[-1]:
        filled.pop()
    return tuple(filled)


def flag_rows_above(text: Text, layout: Layout, place: Place) -> tuple[Flag, ...]:
    """:func:`flag_head` for the lines above the names of a laid-out text."""
    if layout.names_line is None:
        return ()
    head = [text.decode(line) for line in text.data[: layout.offset].splitlines()[: layout.names_line - 1]]
    return flag_head([split_line(line, layout.delimiter) for line in head], place)


def flag_head(head: Sequence[Row], place: Place) -> tuple[Flag, ...]:
    """Flag of results and of rows of numbers above the names, which would pass for a header.

    ``head``: all lines above the names, from the first.  Raises InputError: ``mixed_tables`` where they are
    another table: three lines and more, or under names of their own.
    """
    results = announced_results(head)
    said = tuple(results_flag(span.start + 1, span.stop) for span in results)
    inside = {index + 1 for span in results for index in span}
    found = [n for n, row in enumerate(head, 1) if n not in inside and row_like(" ".join(row))]
    if not found:
        return said
    named = any(has_channels(row, (), ReadOptions()) for row in head[: found[0] - 1])
    spans = {index + 1 for span in results_spans(head) for index in span}
    if named or len(set(found) - spans) >= _TABLE_ROWS:
        place.refuse(
            "mixed_tables",
            f"{len(found)} lines of numbers stand above the names in line {len(head) + 1}: is this two"
            " files in one, or were lines moved? Export the file again, one recording a file",
            line=found[0],
            column=1,
        )
    return (*said, skipped_flag(found, "lines of numbers above the names"))


def skipped_flag(lines: Sequence[int], what: str) -> Flag:
    """Lines that were left out."""
    shown = ", ".join(map(str, lines[:3])) + (" ..." if len(lines) > 3 else "")
    return Flag(
        "rows_skipped",
        f"{len(lines)} {what} were left out: lines {shown}",
        {"count": len(lines), "lines": list(lines[:20])},
    )
