"""Recipe for MTS 793 text: a first line of signs, then blocks between blank lines.

::

    MTS793|BTW|ENU|1|2|.|/|:|1|0|0|A

    Operator Information
    Specimen Name<tab>A 7

    Data Acquisition: Timed<tab><tab>Time:<tab>12.5<tab>Sec<tab>1/2/2020 10:00:00 AM
    Time<tab>Axial Displacement<tab>Axial Force
    Sec<tab>mm<tab>N
    0.0625<tab>0.01<tab>-1.2

The sixth field of the first line is the decimal mark; columns are parted by tabs.  One trial a block of
data that holds time, displacement and force; the channels a machine was told to follow (``Command``,
``Sollwert``) are no measurements.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from tissueid.errors import InputError
from tissueid.ingest.block import Head, block_layout, block_text
from tissueid.ingest.columns import has_channels
from tissueid.ingest.delimited import read_table
from tissueid.ingest.layout import Row, split_line
from tissueid.ingest.numbers import looks_numeric
from tissueid.ingest.recipe import Detection, InputFile, Recipe, Table
from tissueid.ingest.refusals import Place
from tissueid.ingest.results import is_units_row
from tissueid.ingest.text import Text

_FIRST = re.compile(rb"MTS793\|[^\r\n]*")
_BLANK = re.compile(rb"\n[ \t]*\r?\n")
_DECIMAL_FIELD = 5
#: Lines of a block in which its names stand, and what is decoded of it to find them.
_HEAD_LINES = 5
_HEAD_BYTES = 1 << 14


@dataclass(frozen=True, slots=True)
class _Block:
    """One table: its title, names, units, and the bytes of its rows."""

    title: Row
    names: Row
    units: Row
    names_line: int
    first_line: int
    rows: bytes


def detect_mts793(file: InputFile) -> Detection:
    """The signs in the first line."""
    if file.text is not None and _FIRST.match(file.text.data):
        return 1.0, "the first line begins MTS793|"
    return 0.0, "no MTS793| in the first line"


def _stated_decimal(text: Text) -> str | None:
    match = _FIRST.match(text.data)
    fields = text.decode(match[0]).split("|") if match else []
    stated = fields[_DECIMAL_FIELD] if len(fields) > _DECIMAL_FIELD else ""
    return stated if stated in {".", ","} else None


def _delimiter(file: InputFile, data: bytes) -> str:
    return file.options.delimiter or ("\t" if b"\t" in data else ";")


def _chunks(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Stretches between blank lines, with the line at which they begin."""
    start = 0
    for blank in _BLANK.finditer(data):
        yield data.count(b"\n", 0, start) + 1, data[start : blank.start() + 1]
        start = blank.end()
    yield data.count(b"\n", 0, start) + 1, data[start:]


def _parse(file: InputFile, text: Text) -> tuple[list[_Block], dict[str, str]]:
    """The tables, and what the other blocks say."""
    blocks: list[_Block] = []
    metadata: dict[str, str] = {}
    delimiter = _delimiter(file, text.data)
    for line, chunk in _chunks(text.data):
        head = chunk[:_HEAD_BYTES].splitlines(keepends=True)[: _HEAD_LINES + 1]
        rows = [tuple(cell.strip() for cell in split_line(text.decode(one), delimiter)) for one in head]
        at = next(
            (i for i, row in enumerate(rows) if has_channels(row, _units_below(rows, i), file.options)), None
        )
        if at is not None:
            units = _units_below(rows, at)
            first = at + (2 if units else 1)
            skip = sum(map(len, head[:first]))
            title = rows[at - 1] if at else ()
            blocks.append(_Block(title, rows[at], units, line + at, line + first, chunk[skip:]))
        elif blocks and rows and sum(map(looks_numeric, rows[0])) >= 2:
            blocks[-1] = _joined(blocks[-1], chunk, line)
        else:
            metadata |= _entries(text.decode(chunk), delimiter)
    return blocks, metadata


def _units_below(rows: list[Row], index: int) -> Row:
    return rows[index + 1] if index + 1 < len(rows) and is_units_row(rows[index + 1]) else ()


def _joined(block: _Block, chunk: bytes, line: int) -> _Block:
    """Rows that go on behind a blank line."""
    gap = b"\n" * (line - block.first_line - block.rows.count(b"\n"))
    return _Block(
        block.title, block.names, block.units, block.names_line, block.first_line, block.rows + gap + chunk
    )


def _entries(lines: str, delimiter: str) -> dict[str, str]:
    entries: dict[str, str] = {}
    for line in lines.splitlines():
        cells = [cell.strip() for cell in line.split(delimiter) if cell.strip()]
        if len(cells) >= 2:
            entries.setdefault(cells[0].rstrip(": "), " ".join(cells[1:]))
    return entries


def read_mts793(file: InputFile) -> Iterator[Table | InputError]:
    """Every block of data with time, displacement and force."""
    text, whole = file.text, Place(file.path)
    if text is None:
        yield whole.refusal("not_an_export", "this is no text")
        return
    blocks, metadata = _parse(file, text)
    if not blocks:
        yield whole.refusal(
            "no_columns",
            "no block of data holds time, displacement and force; log them together, or name the columns"
            " with --columns time=NAME,displacement=NAME,force=NAME",
        )
    for count, block in enumerate(blocks, 1):
        name = next((cell for cell in block.title if cell), "")
        sheet = None if len(blocks) == 1 else f"{count}: {name.rstrip(':')}" if name else str(count)
        place = Place(file.path, sheet)
        alone = block_text(text, block.rows, block.first_line)
        try:
            layout = block_layout(
                alone, Head(block.names, block.units, block.names_line, block.first_line),
                delimiter=_delimiter(file, text.data), options=file.options, place=place,
                decimal=_stated_decimal(text),
            )  # fmt: skip
            yield read_table(alone, layout, file.options, place, metadata=metadata)
        except InputError as error:
            yield error


MTS_793 = Recipe(
    "mts-793", "MTS 793 text (Basic TestWare, MultiPurpose), one trial a block", detect_mts793, read_mts793
)
