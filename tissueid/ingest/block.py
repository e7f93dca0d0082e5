"""A table that is one of several in a text, laid out as if it stood alone.

Formats that hold many tables in one file, or side by side, cut them out; the lines above a table are
kept as blank ones, so that a refusal still points at the line of the file.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import NamedTuple

from tissueid.ingest.layout import Layout, Row, find_decimal, split_line
from tissueid.ingest.numbers import looks_numeric
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import Text

#: Rows looked at for the decimal mark, and for which columns hold numbers.
_SAMPLED_BYTES = 1 << 14


class Head(NamedTuple):
    """Names and units over a table, empty units where there is no such row, and where it stands.

    Lines are one-based: of the names and of the first row.
    """

    names: Row
    units: Row
    names_line: int
    first_line: int


def block_text(text: Text, rows: bytes, first_line: int) -> Text:
    """Rows of a text, at their lines.

    ``rows``: whole lines; ``first_line``: one-based line of the file at which they stand.
    """
    return replace(text, data=b"\n" * (first_line - 1) + rows)


def _ends_empty(sample: list[Row], named: int) -> bool:
    """True where the cells behind the named columns are empty in every row."""
    return all(not any(cell.strip() for cell in row[named:]) for row in sample)


def block_layout(
    text: Text,
    head: Head,
    *,
    delimiter: str,
    options: ReadOptions,
    place: Place,
    decimal: str | None = None,
) -> Layout:
    """The layout of a block text.

    ``text``: of :func:`block_text`; ``decimal``: as the file states it; found in the numbers otherwise.
    Raises InputError: ``ambiguous_decimal``.
    """
    names, units, names_line, first_line = head
    first = first_line - 1
    opening = text.data[first : first + _SAMPLED_BYTES].splitlines()
    rows = [split_line(text.decode(line), delimiter) for line in opening]
    sample = [row for row in rows if sum(map(looks_numeric, row)) >= 2]
    mark = options.decimal or decimal
    if mark is None:
        padded: list[Row] = [()] * first
        mark = find_decimal(text, sample, delimiter, place, first=first, rows=padded + rows)
    usual = Counter(map(len, sample)).most_common(1)
    # a delimiter at the end of every row is one more column, without a name
    n_columns = max(len(names), usual[0][0] if usual and _ends_empty(sample, len(names)) else 0)
    return Layout(
        delimiter=delimiter,
        decimal=mark,
        header=(),
        names=(*names, *[""] * (n_columns - len(names))),
        units=tuple((*units, *[""] * n_columns)[:n_columns]),
        units_in_row=bool(units),
        names_line=names_line,
        first_line=first_line,
        offset=first,
        n_columns=n_columns,
        numeric=tuple(
            bool(sample) and all(i < len(row) and looks_numeric(row[i]) for row in sample[:50])
            for i in range(n_columns)
        ),
    )
