"""A table that is one of several in a text, below or beside others, laid out as if it stood alone.

Formats that hold many tables in one file, or side by side, cut them out; the lines above a table are
kept as blank ones, so that a refusal still points at the line of the file.

Specimens whose columns stand side by side in one table, each under its name.

::

    1_1             1_2
    Time Force Stroke Time Force Stroke
    sec  N     mm     sec  N     mm
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

from tissueid.errors import InputError
from tissueid.ingest.columns import has_channels, split_name
from tissueid.ingest.layout import Layout, Row, find_decimal, split_line
from tissueid.ingest.numbers import looks_numeric
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import Text
from tissueid.ingest.vocabulary import Channel, rank_of

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


@dataclass(frozen=True, slots=True)
class SpecimenColumns:
    """The columns ``[start, stop)`` of one specimen, and its name: that above them, or its number."""

    name: str
    start: int
    stop: int
    is_named: bool


def specimen_columns(
    above: Sequence[str], names: Sequence[str], units: Sequence[str], options: ReadOptions
) -> list[SpecimenColumns]:
    """The specimens of a table, each beginning under its name, or else at a column of time.

    ``above``, ``names``, ``units``: the row with the specimens' names, and the two below it.  Returns empty
    where the columns are not those of specimens.  A specimen may lack its time where others of the same names
    stand beside it: it is refused by itself.
    """
    by_name = [index for index, name in enumerate(above[: len(names)]) if name.strip()]
    spans = _spans(by_name, names)
    if len(spans) > 1 and all(
        _holds_force(names[start:stop], units[start:stop], options) for start, stop in spans
    ):
        return [SpecimenColumns(above[start].strip(), start, stop, is_named=True) for start, stop in spans]
    spans = _spans([i for i, name in enumerate(names) if _is(name, "time")], names)
    if not spans or not all(has_channels(names[a:b], units[a:b], options) for a, b in spans):
        return []
    if all(_named(above[start:stop]) for start, stop in spans):
        return [SpecimenColumns(above[start].strip(), start, stop, is_named=True) for start, stop in spans]
    groups = {tuple(name.strip() for name in names[start:stop] if name.strip()) for start, stop in spans}
    if len(spans) < 2 or len(groups) > 1:
        return []
    return [SpecimenColumns(str(k), *span, is_named=False) for k, span in enumerate(spans, 1)]


def _is(name: str, channel: Channel) -> bool:
    return rank_of(split_name(name.strip())[0], channel, loose=False) is not None


def _spans(starts: Sequence[int], names: Sequence[str]) -> list[tuple[int, int]]:
    """Columns from each start to the next; none where named columns stand before the first."""
    if not starts or any(name.strip() for name in names[: starts[0]]):
        return []
    return list(pairwise([*starts, len(names)]))


def _holds_force(names: Sequence[str], units: Sequence[str], options: ReadOptions) -> bool:
    """Columns of a recording, its time apart."""
    return has_channels(names, units, options) or (
        sum(bool(name.strip()) for name in names) == 2
        and any(_is(name, "force") for name in names)
        and any(_is(name, "displacement") for name in names)
    )


def _named(above: Sequence[str]) -> bool:
    """True where one name stands above a group: over its first column, or over each."""
    cells = {cell.strip() for cell in above if cell.strip()}
    return len(cells) == 1 and above[0].strip() in cells


def shifted(error: InputError, columns: int) -> InputError:
    """A refusal that points at the column of the file, not of the specimen."""
    column = None if error.column is None else error.column + columns
    return InputError(
        error.code, error.message, path=error.path, sheet=error.sheet, line=error.line, column=column
    )
