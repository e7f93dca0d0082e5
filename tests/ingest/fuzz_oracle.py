"""The other reader: plain, slow and strict, told what a file is meant to be.

It shares no code with the package.  It knows the intended dialect, so that it has nothing to guess: a
line is a row where every cell is a number of the dialect, blank, a line without any number, or *odd*.
What a mutant means is its rows in their order; odd lines are what a reader must not pass over.
"""

from __future__ import annotations

from dataclasses import dataclass

from fuzz_seeds import FACTORS, Intent

DIGITS = frozenset("0123456789")
#: Separators of thousands besides the mark that is not the decimal one; before a decimal mark, a number
#: grouped by any of them can mean one thing only.
SPACES = "\u00a0\u202f '\u2019"


@dataclass(frozen=True)
class Row:
    line: int
    values: tuple[float, float, float]


@dataclass(frozen=True)
class Reading:
    """What a file holds: its rows, and the lines that are neither rows nor free of numbers."""

    rows: tuple[Row, ...]
    odd: tuple[int, ...]


def _digits(text: str, at: int) -> int:
    while at < len(text) and text[at] in DIGITS:
        at += 1
    return at


def _whole_part(text: str, marks: str) -> tuple[str, int, bool] | None:
    """The digits before the decimal mark, where they end, and whether they are grouped."""
    end = _digits(text, 0)
    whole = text[:end]
    if end == len(text) or text[end] not in marks:
        return whole, end, False
    mark, at = text[end], end
    if not 1 <= len(whole) <= 3 or whole[0] == "0":
        return None
    while at < len(text) and text[at] == mark:
        group = text[at + 1 : at + 4]
        if len(group) != 3 or not set(group) <= DIGITS:
            return None
        whole += group
        at += 4
    return whole, at, True


def number(cell: str, intent: Intent) -> float | None:
    """The value of a cell by the grammar of the dialect, or ``None``."""
    text = cell.strip(" \t")
    sign = ""
    if text[:1] in ("+", "-") and text:
        sign, text = text[0], text[1:]
    whole_part = _whole_part(text, SPACES + ("," if intent.decimal == "." else "."))
    if whole_part is None:
        return None
    whole, at, grouped = whole_part
    fraction = ""
    marked = text[at : at + 1] == intent.decimal
    if marked:
        stop = _digits(text, at + 1)
        fraction, at = text[at + 1 : stop], stop
    if not (whole or fraction) or (grouped and not marked):
        return None
    power = ""
    if text[at : at + 1] in ("e", "E") and at < len(text):
        begin = at + 2 if text[at + 1 : at + 2] in ("+", "-") else at + 1
        stop = _digits(text, begin)
        if stop == begin:
            return None
        power, at = text[at + 1 : stop], stop
    if at != len(text):
        return None
    value = float(f"{sign}{whole or '0'}.{fraction or '0'}e{power or '0'}")
    return value if abs(value) < float("inf") else None


def cells_of(line: str, delimiter: str) -> list[str] | None:
    """Cells without their quotes, ``None`` where a quote is torn."""
    cells, at = [], 0
    while True:
        if line[at : at + 1] == '"':
            text, at = "", at + 1
            while True:
                close = line.find('"', at)
                if close < 0:
                    return None
                text += line[at:close]
                if line[close + 1 : close + 2] != '"':
                    at = close + 1
                    break
                text, at = text + '"', close + 2
        else:
            stop = line.find(delimiter, at)
            stop = len(line) if stop < 0 else stop
            text, at = line[at:stop], stop
            if '"' in text:
                return None
        cells.append(text)
        if at == len(line):
            return cells
        if line[at] != delimiter:
            return None
        at += 1


def read(data: bytes, intent: Intent) -> Reading:
    """Read bytes that are meant in one way."""
    text = data.decode(intent.encoding, errors="replace").removeprefix("\ufeff")
    rows, odd = [], []
    for line_number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        if not line.strip(f' \t"{intent.delimiter}'):
            continue
        cells = cells_of(line, intent.delimiter)
        row = _row(cells, intent, line_number) if cells is not None else None
        if row is not None:
            rows.append(row)
        elif cells is None or any(_like_number(cell) for cell in cells):
            odd.append(line_number)
    return Reading(tuple(rows), tuple(odd))


def _like_number(cell: str) -> bool:
    """Whether a cell begins as a number does."""
    text = cell.strip().lstrip("+-").lstrip(".,")
    return text[:1] in DIGITS


def _row(cells: list[str], intent: Intent, line_number: int) -> Row | None:
    if len(cells) != intent.n_columns:
        return None
    values = []
    for column, unit in zip(intent.channels, intent.units, strict=True):
        value = number(cells[column], intent)
        if value is None:
            return None
        values.append(value * FACTORS[unit])
    others = set(range(intent.n_columns)) - set(intent.channels) - intent.words
    if any(cells[column].strip() and number(cells[column], intent) is None for column in others):
        return None
    return Row(line_number, (values[0], values[1], values[2]))
