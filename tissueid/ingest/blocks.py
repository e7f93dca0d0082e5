"""Recipes for text that holds several tables: Mach-1 and MTS 793 below each other, Shimadzu side by side.

Each table is laid out as if it stood alone, at its lines in the file.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from tissueid.errors import InputError
from tissueid.flags import Flag
from tissueid.ingest.columns import has_channels
from tissueid.ingest.delimited import read_table
from tissueid.ingest.header import header_entries, protocol_of
from tissueid.ingest.layout import Layout, find_decimal, is_units_row, numeric_columns, split_line
from tissueid.ingest.numbers import Row, looks_numeric
from tissueid.ingest.recipe import NOT_MINE, Detection, InputFile, Recipe, Table
from tissueid.ingest.refusals import Place
from tissueid.ingest.side_by_side import SpecimenColumns, specimen_columns
from tissueid.ingest.text import Text
from tissueid.ingest.vocabulary import plain_words, split_name

#: Rows looked at for the decimal mark, and for which columns hold numbers.
_SAMPLED_BYTES = 1 << 14


class BlockHead(NamedTuple):
    """Names and units over a table, empty units where there is no such row, and where it stands."""

    names: Row
    units: Row
    names_line: int
    first_line: int


def read_block(
    file: InputFile,
    sheet: str | None,
    text: Text,
    head: BlockHead,
    *,
    delimiter: str,
    metadata: Mapping[str, str],
    decimal: str | None = None,
) -> Table:
    """The table of a text with nothing but its rows in it, at their lines."""
    names, units, names_line, first_line = head
    place = Place(file.path, sheet)
    opening = text.data[:_SAMPLED_BYTES].splitlines()
    rows = [split_line(text.decode(line), delimiter) for line in opening]
    sample = [row for row in rows if sum(map(looks_numeric, row)) >= 2]
    mark = file.options.decimal or decimal
    if mark is None:
        mark = find_decimal(text, sample, delimiter, place, first=first_line - 1, rows=rows)
    usual = Counter(map(len, sample)).most_common(1)
    # a delimiter at the end of every row is one more column, without a name
    unnamed = any(cell.strip() for row in sample for cell in row[len(names) :])
    n_columns = max(len(names), usual[0][0] if usual and not unnamed else 0)
    layout = Layout(
        delimiter=delimiter,
        decimal=mark,
        header=(),
        names=(*names, *[""] * (n_columns - len(names))),
        units=tuple((*units, *[""] * n_columns)[:n_columns]),
        units_in_row=bool(units),
        names_line=names_line,
        first_line=first_line,
        offset=0,
        n_columns=n_columns,
        numeric=numeric_columns(sample, n_columns),
    )
    return read_table(text, layout, file.options, place, metadata=metadata)


# Mach-1: <Mach-1 File>, entries between <INFO> and <END INFO>, then blocks: <Command>, entries such as
# "Ramp velocity, mm/s:<tab>0.5000", and a table between <DATA> and <END DATA>.  A <divider> parts the steps
# of one table; where the time starts again behind it, the steps are trials of their own.
_MACH1_FIRST = b"<Mach-1 File>"
_MARK = re.compile(rb"^[ \t]*<([^<>\r\n]{1,80})>[ \t]*\r?$", re.MULTILINE)
_DIVIDER = re.compile(rb"^[ \t]*<divider>[ \t]*(?=\r?$)", re.MULTILINE | re.IGNORECASE)
#: Keys that are a depth in a relative move only; elsewhere they are positions.
_TRAVEL = ("position", "displacement", "distance", "amplitude")


@dataclass(frozen=True, slots=True)
class _Command:
    """One table: its number and command, what was said above it, and where it stands."""

    number: int
    command: str
    header: Mapping[str, str]
    start: int
    stop: int
    ended: bool

    @property
    def sheet(self) -> str:
        return f"{self.number}: {self.command}" if self.command else str(self.number)


def _entries(lines: str) -> dict[str, str]:
    """Lines such as ``Ramp velocity, mm/s:<tab>0.5``."""
    entries = {}
    for line in lines.splitlines():
        key, tab, value = line.partition("\t")
        if not tab:
            key, _, value = line.partition(":")
        if key.strip():
            entries[key.strip().rstrip(":").rstrip()] = " ".join(value.split())
    return entries


def _commands(text: Text) -> Iterator[_Command]:
    """The tables of a file, in their order."""
    info: dict[str, str] = {}
    header: dict[str, str] = {}
    command, number, at, section = "", 0, 0, ""
    for mark in _MARK.finditer(text.data):
        word = text.decode(mark[1]).strip()
        kind = word.casefold()
        if kind == "divider":
            continue
        between = text.data[at : mark.start()]
        if section == "data":
            number += 1
            yield _Command(number, command, {**info, **header}, at, mark.start(), kind == "end data")
        elif section == "info":
            info.update(_entries(text.decode(between)))
        else:
            header.update(_entries(text.decode(between)))
        section = kind if kind in {"data", "info"} else ""
        if section != "data":
            header = {}
            command = "" if kind in {"info", "end info", "end data"} else word
        at = mark.end()
    if section == "data":
        yield _Command(number + 1, command, {**info, **header}, at, len(text.data), ended=False)


def detect_mach1(file: InputFile) -> Detection:
    """The mark in the first line."""
    begins = file.text is not None and file.text.data.lstrip(b" \t\r\n").startswith(_MACH1_FIRST)
    return (1.0, "the first line is <Mach-1 File>") if begins else NOT_MINE


def read_mach1(file: InputFile) -> Iterator[Table | InputError]:
    """Every table with time, position and force."""
    text = file.decoded()
    seen: list[str] = []
    found = False
    for block in _commands(text):
        data = text.data[block.start : block.stop]
        blank = len(data) - len(data.lstrip(b"\r\n"))
        line, _, rows = data[blank:].partition(b"\n")
        names = tuple(name.strip() for name in split_line(text.decode(line), "\t"))
        seen.append(f"{block.sheet} ({', '.join(names)[:80]})")
        if has_channels(names, (), file.options) and rows.strip():
            found = True
            names_line = text.data.count(b"\n", 0, block.start + blank) + 1
            yield from _read_steps(file, text, block, BlockHead(names, (), names_line, names_line + 1), rows)
    if not found:
        blocks = "; the blocks are " + "; ".join(seen[:10]) if seen else "; it has no <DATA> block"
        message = f"no block holds time, position and force{blocks}; name them with --columns"
        Place(file.path).refuse("no_columns", message)


def _read_steps(
    file: InputFile, text: Text, block: _Command, head: BlockHead, rows: bytes
) -> Iterator[Table | InputError]:
    parts = _parts(text, rows, head.names)
    line = head.first_line
    for count, part in enumerate(parts, 1):
        sheet = block.sheet if len(parts) == 1 else f"{block.sheet} ({count})"
        alone = replace(text, data=_DIVIDER.sub(b"", part))
        end = line + part.count(b"\n")
        try:
            lines = head._replace(first_line=line)
            table = read_block(file, sheet, alone, lines, delimiter="\t", metadata=block.header)
            protocol = protocol_of(_as_keys(block), file.path, decimal=table.decimal)
            flags = table.flags
            if part is parts[-1] and not block.ended:
                message = f"the block has no <END DATA>: the file is cut at line {end}"
                flags = (*flags, Flag("cut_row", message, {"line": end, "kept": True}))
            yield replace(table, protocol=replace(protocol, kind=block.command.lower() or None), flags=flags)
        except InputError as error:
            yield error
        line = end


def _as_keys(block: _Command) -> dict[str, str]:
    """Header entries, a relative move's travel as its depth; which way a move goes is no matter."""
    relative = "relative" in plain_words(block.command)
    return {
        (f"Depth, {key.rpartition(',')[2].strip()}" if relative and _is_travel(key) else key): (
            value.removeprefix("-") if _is_travel(key.removeprefix("Ramp ")) else value
        )
        for key, value in block.header.items()
    }


def _is_travel(key: str) -> bool:
    return plain_words(key.partition(",")[0]).startswith(_TRAVEL)


def _parts(text: Text, rows: bytes, names: Row) -> list[bytes]:
    """The rows, cut where the time starts again behind a divider."""
    time = next((i for i, name in enumerate(names) if plain_words(name).startswith("time")), 0)
    parts, start = [], 0
    for divider in _DIVIDER.finditer(rows):
        before = _cell(text, rows[max(0, divider.start() - 400) : divider.start()], time, last=True)
        after = _cell(text, rows[divider.end() : divider.end() + 400], time, last=False)
        if before is not None and after is not None and after < before:
            parts.append(rows[start : divider.start()])
            start = divider.start()
    return [*parts, rows[start:]]


def _cell(text: Text, rows: bytes, column: int, *, last: bool) -> float | None:
    """The number in a column of the last or the first whole row of a piece."""
    lines = [line for line in text.decode(rows).splitlines() if line.strip()]
    for line in reversed(lines) if last else lines:
        cells = line.split("\t")
        if len(cells) > column and looks_numeric(cells[column]):
            try:
                return float(cells[column].replace(",", "."))
            except ValueError:
                return None
    return None


MACH_1 = Recipe("mach-1", "Biomomentum Mach-1 text, one trial a block", detect_mach1, read_mach1)

# MTS 793: a first line of signs, MTS793|BTW|ENU|1|2|.|/|:|1|0|0|A, whose sixth field is the decimal mark,
# then blocks between blank lines; channels that a machine was told to follow (Command) are no measurements.
_MTS793_FIRST = re.compile(rb"MTS793\|[^\r\n]*")
_BLANK = re.compile(rb"\n[ \t]*\r?\n")
_DECIMAL_FIELD = 5
#: Lines of a block in which its names stand, and what is decoded of it to find them.
_HEAD_LINES = 5


class _Block(NamedTuple):
    """One table: its title, its head, and the bytes of its rows."""

    title: Row
    head: BlockHead
    rows: bytes


def detect_mts793(file: InputFile) -> Detection:
    """The signs in the first line."""
    begins = file.text is not None and _MTS793_FIRST.match(file.text.data)
    return (1.0, "the first line begins MTS793|") if begins else NOT_MINE


def _stated_decimal(text: Text) -> str | None:
    match = _MTS793_FIRST.match(text.data)
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
        head = chunk[:_SAMPLED_BYTES].splitlines(keepends=True)[: _HEAD_LINES + 1]
        rows = [tuple(cell.strip() for cell in split_line(text.decode(one), delimiter)) for one in head]
        at = next(
            (i for i, row in enumerate(rows) if has_channels(row, _units_below(rows, i), file.options)), None
        )
        if at is not None:
            units = _units_below(rows, at)
            first = at + (2 if units else 1)
            skip = sum(map(len, head[:first]))
            title = rows[at - 1] if at else ()
            blocks.append(_Block(title, BlockHead(rows[at], units, line + at, line + first), chunk[skip:]))
        elif blocks and rows and sum(map(looks_numeric, rows[0])) >= 2:
            # rows that go on behind a blank line
            last = blocks[-1]
            gap = b"\n" * (line - last.head.first_line - last.rows.count(b"\n"))
            blocks[-1] = last._replace(rows=last.rows + gap + chunk)
        else:
            metadata |= _pairs(text.decode(chunk), delimiter)
    return blocks, metadata


def _units_below(rows: list[Row], index: int) -> Row:
    return rows[index + 1] if index + 1 < len(rows) and is_units_row(rows[index + 1]) else ()


def _pairs(lines: str, delimiter: str) -> dict[str, str]:
    entries: dict[str, str] = {}
    for line in lines.splitlines():
        cells = [cell.strip() for cell in line.split(delimiter) if cell.strip()]
        if len(cells) >= 2:
            entries.setdefault(cells[0].rstrip(": "), " ".join(cells[1:]))
    return entries


def read_mts793(file: InputFile) -> Iterator[Table | InputError]:
    """Every block of data with time, displacement and force."""
    text = file.decoded()
    blocks, metadata = _parse(file, text)
    if not blocks:
        message = (
            "no block of data holds time, displacement and force; log them together, or name the columns"
            " with --columns time=NAME,displacement=NAME,force=NAME"
        )
        Place(file.path).refuse("no_columns", message)
    for count, block in enumerate(blocks, 1):
        name = next((cell for cell in block.title if cell), "")
        sheet = None if len(blocks) == 1 else f"{count}: {name.rstrip(':')}" if name else str(count)
        try:
            yield read_block(
                file,
                sheet,
                replace(text, data=block.rows),
                block.head,
                delimiter=_delimiter(file, text.data),
                metadata=metadata,
                decimal=_stated_decimal(text),
            )
        except InputError as error:
            yield error


MTS_793 = Recipe(
    "mts-793", "MTS 793 text (Basic TestWare, MultiPurpose), one trial a block", detect_mts793, read_mts793
)

# Shimadzu: three head rows (names of specimens and of columns, units) over specimens side by side.  A
# specimen ends where its cells are empty, and must stay ended.
_STROKE = frozenset({"stroke", "ストローク", "hub"})


def _specimens(file: InputFile) -> list[SpecimenColumns]:
    layout = file.layout
    if layout is None:
        return []
    above = layout.header[-1] if layout.header else ()
    return specimen_columns(above, layout.names, layout.units, file.options)


def detect_shimadzu(file: InputFile) -> Detection:
    """Specimens named above columns that repeat, or above one stroke."""
    specimens = _specimens(file)
    if len(specimens) > 1:
        names = ", ".join(repr(s.name) for s in specimens[:3])
        return 0.98, f"the specimens {names} stand side by side above the same columns"
    columns = file.layout.names if file.layout is not None and specimens else ()
    if any(plain_words(split_name(name)[0]) in _STROKE for name in columns):
        return 0.94, f"the specimen {specimens[0].name!r} stands above Time, Force and Stroke"
    return NOT_MINE


def read_shimadzu(file: InputFile) -> Iterator[Table | InputError]:
    """Every specimen."""
    text, layout = file.laid_out()
    specimens = _specimens(file)
    named = bool(specimens) and specimens[0].is_named
    metadata = header_entries(layout.header[:-1] if named else layout.header)
    called = [specimen.name for specimen in specimens]
    for count, specimen in enumerate(specimens, 1):
        sheet = specimen.name if called.count(specimen.name) == 1 else f"{count}: {specimen.name}"
        names, names_line = specimen.of(layout.names), layout.names_line or layout.first_line
        try:
            yield read_block(
                file,
                sheet,
                _alone(text, layout, specimen, Place(file.path, sheet)),
                BlockHead(names, specimen.of(layout.units), names_line, layout.first_line),
                delimiter=layout.delimiter,
                metadata=metadata,
                decimal=layout.decimal,
            )
        except InputError as error:
            yield specimen.placed(error)


def _alone(text: Text, layout: Layout, specimen: SpecimenColumns, place: Place) -> Text:
    """The lines of the file with the cells of one specimen, blank where it has ended."""
    lines: list[str] = []
    ended = 0
    for number, raw in enumerate(text.data[layout.offset :].splitlines(), layout.first_line):
        row = split_line(text.decode(raw), layout.delimiter)
        cells = specimen.of(row)
        if not any(cell.strip() for cell in cells):
            ended = ended or (number if any(cell.strip() for cell in row) else 0)
            lines.append("")
            continue
        if ended:
            message = (
                f"the cells of the specimen are empty in line {ended}, filled below; fill or remove the row"
            )
            place.refuse("empty_cell", message, line=ended, column=1)
        lines.append(_joined(cells, layout.delimiter))
    # without a last line end the last row may be cut, as in the file
    rows = "\n".join(lines) + ("\n" if text.data.endswith(b"\n") else "")
    return replace(text, data=rows.encode(text.codec, "replace"))


def _joined(cells: Sequence[str], delimiter: str) -> str:
    return delimiter.join(
        '"' + cell.replace('"', '""') + '"' if delimiter in cell or '"' in cell else cell for cell in cells
    )


SHIMADZU = Recipe(
    "shimadzu", "Shimadzu Trapezium text, specimens side by side", detect_shimadzu, read_shimadzu
)
