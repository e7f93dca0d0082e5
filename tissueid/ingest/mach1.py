"""Recipe for Mach-1 text: many blocks a file, each with its command, its header and its table.

::

    <Mach-1 File>
    <INFO>
    Time:<tab>10:21:07
    <END INFO>
    <Stress Relaxation>
    Ramp velocity, mm/s:<tab>0.5000
    Fixed relaxation time, s:<tab>60.000
    <DATA>
    Time, s<tab>Position (z), mm<tab>Fz, gf
    0.00000<tab>1.20000<tab>0.01
    <divider>
    10.00000<tab>1.30000<tab>5.44
    <END DATA>

One trial a table that holds time, position and force; its sheet is the number and command of the block,
``"2: Stress Relaxation"``.  A ``<divider>`` parts the steps of one table; where the time starts again
behind it, the steps are trials of their own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from tissueid.errors import InputError
from tissueid.flags import Flag
from tissueid.ingest.block import Head, block_layout, block_text
from tissueid.ingest.columns import has_channels
from tissueid.ingest.delimited import read_table
from tissueid.ingest.header import protocol_of
from tissueid.ingest.layout import Row, split_line
from tissueid.ingest.numbers import looks_numeric
from tissueid.ingest.recipe import Detection, InputFile, Recipe, Table
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import Text
from tissueid.ingest.vocabulary import plain_words

_FIRST = b"<Mach-1 File>"
_MARK = re.compile(rb"^[ \t]*<([^<>\r\n]{1,80})>[ \t]*\r?$", re.MULTILINE)
_DIVIDER = re.compile(rb"^[ \t]*<divider>[ \t]*(?=\r?$)", re.MULTILINE | re.IGNORECASE)
#: Keys that are a depth in a relative move only; elsewhere they are positions.
_TRAVEL = ("position", "displacement", "distance", "amplitude")


@dataclass(frozen=True, slots=True)
class _Block:
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


def _blocks(text: Text) -> Iterator[_Block]:
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
            stop = mark.start()
            yield _Block(number, command, {**info, **header}, at, stop, ended=kind == "end data")
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
        stop = len(text.data)
        yield _Block(number + 1, command, {**info, **header}, at, stop, ended=False)


def detect_mach1(file: InputFile) -> Detection:
    """The mark in the first line."""
    if file.text is not None and file.text.data.lstrip(b" \t\r\n").startswith(_FIRST):
        return 1.0, "the first line is <Mach-1 File>"
    return 0.0, "no <Mach-1 File> in the first line"


def read_mach1(file: InputFile) -> Iterator[Table | InputError]:
    """Every table with time, position and force."""
    text, place = file.text, Place(file.path)
    if text is None:
        yield place.refusal("not_an_export", "this is no text")
        return
    seen: list[str] = []
    found = False
    for block in _blocks(text):
        data = text.data[block.start : block.stop]
        blank = len(data) - len(data.lstrip(b"\r\n"))
        line, _, rows = data[blank:].partition(b"\n")
        names = tuple(name.strip() for name in split_line(text.decode(line), "\t"))
        seen.append(f"{block.sheet} ({', '.join(names)[:80]})")
        if has_channels(names, (), file.options) and rows.strip():
            found = True
            names_line = text.data.count(b"\n", 0, block.start + blank) + 1
            yield from _read_block(file, text, block, names, rows, names_line)
    if not found:
        blocks = "; the blocks are " + "; ".join(seen[:10]) if seen else "; it has no <DATA> block"
        message = f"no block holds time, position and force{blocks}; name them with --columns"
        yield place.refusal("no_columns", message)


def _read_block(
    file: InputFile, text: Text, block: _Block, names: Row, rows: bytes, names_line: int
) -> Iterator[Table | InputError]:
    parts = _parts(text, rows, names)
    line = names_line + 1
    for count, part in enumerate(parts, 1):
        sheet = block.sheet if len(parts) == 1 else f"{block.sheet} ({count})"
        place = Place(file.path, sheet)
        alone = block_text(text, _DIVIDER.sub(b"", part), line)
        try:
            layout = block_layout(
                alone, Head(names, (), names_line, line), delimiter="\t", options=file.options, place=place,
            )  # fmt: skip
            table = read_table(alone, layout, file.options, place, metadata=block.header)
            protocol = protocol_of(_as_keys(block), file.path, decimal=layout.decimal)
            cut = () if block.ended or part is not parts[-1] else (_open_end(line + part.count(b"\n")),)
            yield replace(
                table,
                protocol=replace(protocol, kind=block.command.lower() or None),
                flags=(*table.flags, *cut),
            )
        except InputError as error:
            yield error
        line += part.count(b"\n")


def _as_keys(block: _Block) -> dict[str, str]:
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


def _open_end(line: int) -> Flag:
    return Flag(
        "cut_row",
        f"the block has no <END DATA>: the file is cut at line {line}",
        {"line": line, "kept": True},
    )


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
