"""Recordings below each other in one table: under a head that comes again, or told by a column of specimens.

A head that comes again while the time goes on begins a page; where the time starts again, or the name of the
specimen above the head or in a column changes, another recording begins.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

from tissueid.ingest.columns import channel_columns
from tissueid.ingest.header import header_entries, specimen_in
from tissueid.ingest.header_units import stated_units
from tissueid.ingest.labelled import FEWEST_ROWS
from tissueid.ingest.layout import Anchor, Layout, is_units_row, split_line, units_above
from tissueid.ingest.numbers import CellFault, Row, parse_number
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import Text
from tissueid.ingest.vocabulary import is_specimen_name, plain_words
from tissueid.units import quantity_of

#: Names of what is done several times to a specimen.
_RUNS = re.compile(
    r"(?:test|trial|run|repeat|replicate|indent(?:ation)?|curve|file|site|location)"
    r"(?: ?(?:no|nr|id|name|number))?"
)
#: The rows beside a head are sought in so many bytes.
_NEAR_BYTES = 1 << 13


class Part(NamedTuple):
    """One recording: its name, what stood above it, its rows, and where they stand."""

    name: str | None
    header: tuple[Row, ...]
    text: Text
    layout: Layout


class _Cut(NamedTuple):
    """The bytes of the rows of one recording, its name, the lines above it, and its names and units."""

    start: int
    stop: int
    name: str
    header: tuple[Row, ...]
    names: Row
    units: Row


def recordings(
    text: Text, layout: Layout, wanted: Sequence[int], place: Place, options: ReadOptions
) -> list[Part]:
    """Recordings of a table whose time, displacement and force are ``wanted``; empty where it is one."""
    time = wanted[0]
    names = {
        i: plain_words(name)
        for i, name in enumerate(layout.names)
        if i not in wanted and quantity_of(layout.units[i]) is None
    }
    labels = [i for i, name in names.items() if is_specimen_name(name)]
    runs = [i for i, name in names.items() if i not in labels and _RUNS.fullmatch(name)]
    cuts = _by_label(text, layout, time, labels, runs, place) if labels or runs else []
    cuts = cuts or list(_by_head(text, layout, time, options))
    if len(cuts) < 2:
        return []
    parts = []
    line, counted = layout.first_line, layout.offset
    for count, cut in enumerate(cuts, 1):
        line, counted = line + text.data.count(b"\n", counted, cut.start), cut.start
        own = replace(layout, offset=0, first_line=line, names=cut.names, units=cut.units)
        name = f"{count}: {cut.name}" if cut.name else str(count)
        parts.append(Part(name, cut.header, replace(text, data=text.data[cut.start : cut.stop]), own))
    return parts


def _row(text: Text, layout: Layout, time: int, line: bytes) -> tuple[Row, float] | None:
    """Cells and time of a line that is a row."""
    cells = split_line(text.decode(line), layout.delimiter)
    value = parse_number(cells[time], layout.decimal) if len(cells) == layout.n_columns else None
    return None if value is None or isinstance(value, CellFault) else (cells, value)


def _by_label(
    text: Text, layout: Layout, time: int, labels: Sequence[int], runs: Sequence[int], place: Place
) -> list[_Cut]:
    """Stretches of rows with the same label; empty where there is one, or each row has its own."""
    starts: list[tuple[int, str]] = []
    begun: list[int] = []  # rows in front of each start
    at, rows, still = layout.offset, 0, 0
    label, last, seen = ("", ""), b"", [b""]
    delimiter, both = layout.delimiter.encode(), [*labels, *runs]
    for line in text.data[layout.offset :].splitlines(keepends=True):
        raw = line.split(delimiter)
        same = len(raw) == layout.n_columns and [raw[i] for i in both] == seen
        row = None if same else _row(text, layout, time, line)
        if row is not None:
            cells, value = row
            # a cell that is empty goes on with what stands above it
            own = [" ".join(cells[i].strip() for i in some) for some in (labels, runs)]
            here = (own[0] or label[0], own[1] or label[1])
            above = None if here == label else _row(text, layout, time, last)
            before = value if above is None else above[1]
            still += above is not None and value == before
            if not starts or here[0] != label[0] or value < before:
                starts.append((at if starts else layout.offset, " ".join(filter(None, here))))
                begun.append(rows)
            label, seen = here, [raw[i] for i in both] if len(raw) == layout.n_columns else [b""]
        if same or row is not None:
            rows, last = rows + 1, line
        at += len(line)
    if 3 * still > rows:
        message = (
            f"rows of several recordings, by column {layout.names[both[0]]!r}, stand at each time; sort"
            " them by recording, then by time"
        )
        place.refuse("mixed_tables", message, line=layout.first_line)
    if any(later - row < FEWEST_ROWS for row, later in pairwise([*begun, rows])):
        return []
    stops = [*(start for start, _ in starts[1:]), len(text.data)]
    return [
        _Cut(start, stop, name, (), layout.names, layout.units)
        for (start, name), stop in zip(starts, stops, strict=True)
    ]


def _by_head(text: Text, layout: Layout, time: int, options: ReadOptions) -> Iterator[_Cut]:
    """Rows under each head behind which the time starts again, or above which another specimen is named."""
    if layout.names_line is None:
        return
    data = text.data
    printed = data[: layout.offset].splitlines()[layout.names_line - 1].strip()
    # a head may differ in its units, or in the order of its columns behind the first
    opening = re.match(rb"\W*\w+", printed)
    begins = opening[0] if opening else printed
    start, name, header, units = layout.offset, _title(layout.header), layout.header, layout.units
    at, names = layout.offset, layout.names
    while (at := data.find(b"\n" + begins, at) + 1) > 0:
        below = data.find(b"\n", at) % (len(data) + 1)
        same, cells = data.startswith(printed, at), split_line(text.decode(data[at:below]), layout.delimiter)
        heads = layout.names if same else _names(cells, layout, time, options)
        if heads is None:
            continue
        above = max(start, at - _NEAR_BYTES)
        lines = data[above:at].splitlines(keepends=True)
        ended = _first(text, layout, time, lines[::-1])
        begun = _first(text, layout, time, data[below : below + _NEAR_BYTES].splitlines(keepends=True))
        at, head = below, at
        if ended is None or begun is None:
            continue
        stop = head - ended[0]
        own = _rows(text, layout, data[stop:head])
        specimen = specimen_in(header_entries(own))
        if begun[1] < ended[1] or specimen not in (None, specimen_in(header_entries(header))):
            yield _Cut(start, stop, name, header, names, units)
            start, header, name, names = below + begun[0], own, _title(own), heads
            # the same machine may have been set to other units
            under = _rows(text, layout, data[below:start])
            over = Anchor(len(own), units_above((*own, cells), len(own), options), 0)
            stated = next(filter(is_units_row, under), ()) or over.head((*own, cells))[1]
            stated = stated or stated_units(own, names, options) or layout.units
            units = (*stated, *[""] * layout.n_columns)[: layout.n_columns]
    yield _Cut(start, len(data), name, header, names, units)


def _names(cells: Row, layout: Layout, time: int, options: ReadOptions) -> Row | None:
    """Names in other units or another order over the columns of this table; None where cells are no names."""
    names = (*cells, *[""] * layout.n_columns)[: layout.n_columns]
    found = channel_columns(names, options) if not any(cells[layout.n_columns :]) else {}
    return names if found.get("time") == time else None


def _rows(text: Text, layout: Layout, data: bytes) -> tuple[Row, ...]:
    """The lines of a piece that hold something."""
    rows = (split_line(text.decode(line), layout.delimiter) for line in data.splitlines())
    return tuple(row for row in rows if any(map(str.strip, row)))


def _first(text: Text, layout: Layout, time: int, lines: Sequence[bytes]) -> tuple[int, float] | None:
    """Bytes in front of the first row among some lines, and its time."""
    passed = 0
    for line in lines:
        row = _row(text, layout, time, line)
        if row is not None:
            return passed, row[1]
        passed += len(line)
    return None


def _title(header: Sequence[Row]) -> str:
    """Name of a recording in the lines above it: its specimen, or a last line of one cell."""
    last = [cell.strip() for cell in header[-1] if cell.strip()] if header else []
    return specimen_in(header_entries(header)) or (
        last[0].rstrip(":") if len(last) == 1 and last[0][0] != "*" else ""
    )
