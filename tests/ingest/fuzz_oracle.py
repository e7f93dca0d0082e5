"""The other reader: plain, slow and strict, told what a file is meant to be.

It shares no code with the package.  It knows the intended dialect, so that it has nothing to guess: a
line is a row where every cell is a number of the dialect, blank, a line without any number, or *odd*.
What a mutant means is its rows in their order; odd lines are what a reader must not pass over.
"""

from dataclasses import dataclass

from fuzz_seeds import FACTORS, OTHER_MARK, Intent, split_cells

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
    """The content of a file: its rows, and the lines that are neither rows nor free of numbers."""

    rows: tuple[Row, ...]
    odd: tuple[int, ...]


def number(cell: str, intent: Intent) -> float | None:
    """The value of a cell by the grammar of the dialect, or ``None``."""
    whole, point, rest = cell.strip(" \t").replace("\u2212", "-").partition(intent.decimal)
    marks = [mark for mark in SPACES + OTHER_MARK[intent.decimal] if mark in whole]
    if marks:
        sign = whole[:1] if whole[:1] in {"+", "-"} else ""
        first, *others = whole.removeprefix(sign).split(marks[0])
        sound = 1 <= len(first) <= 3 and first[0] != "0" and all(len(group) == 3 for group in others)
        if not (point and sound and set(first).union(*others) <= DIGITS):
            return None
        whole = sign + first + "".join(others)
    plain = f"{whole}.{rest}" if point else whole
    if not set(plain) <= DIGITS | set("+-.eE"):
        return None
    try:
        value = float(plain)
    except ValueError:
        return None
    return value if abs(value) < float("inf") else None


def cells_of(line: str, delimiter: str) -> list[str] | None:
    """Cells without their quotes, ``None`` where a quote is torn."""
    cells = []
    for cell in split_cells(line, delimiter):
        inner = cell
        if '"' in cell:
            inner = cell[1:-1]
            if len(cell) < 2 or cell[0] + cell[-1] != '""' or '"' in inner.replace('""', ""):
                return None
        cells.append(inner.replace('""', '"'))
    return cells


def read(data: bytes, intent: Intent, turn: tuple[int, Intent] | None = None) -> Reading:
    """Read bytes that are meant in one way, or from behind a line on in another."""
    text = data.decode(intent.encoding, errors="replace").removeprefix("\ufeff")
    rows, odd = [], []
    for line_number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        if turn is not None and line_number > turn[0]:
            intent = turn[1]
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
