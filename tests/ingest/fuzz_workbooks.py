"""The three classes for workbooks: spoilt archives, spoilt rows, spoilt cells, spoilt units.

A sheet is a grid of Python values; what it means is said here, by type: a row of three numbers is a row.
"""

import datetime as dt
import io
from collections.abc import Callable
from dataclasses import dataclass

import openpyxl
from fuzz_mutant import DOUBTS, Outcome, Random, WrongError, compare
from fuzz_seeds import FACTORS, UNITS_OF

from tissueid.errors import InputError
from tissueid.trial import Trial

Grid = list[list[object]]
Rows = list[tuple[float, float, float]]
#: Rows above the samples: test name, names, units.
HEAD = 3
N_ROWS = 40


@dataclass(frozen=True)
class WorkbookMutant:
    """A workbook, the rows that it holds by intent (``None``: it must be doubted), and how it was made."""

    kind: str
    data: bytes
    rows: Rows | None
    odd: bool = False


def grid() -> Grid:
    """A testXpert sheet: ramp and hold."""
    depth = [min(0.25 * i, 5.0) + 0.001 * i for i in range(N_ROWS)]
    body: Grid = [[0.1 * i, 2.0 * x**2 + 0.03125, x, f"s{i}"] for i, x in enumerate(depth)]
    return [
        ["A 1"] * 4,
        ["Test time", "Standard force", "Standard travel", "Remark"],
        ["s", "N", "mm", ""],
        *body,
    ]


def saved(cells: Grid) -> bytes:
    book = openpyxl.Workbook()
    sheet = book.active
    for row in cells:
        sheet.append(row)
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def meaning(cells: Grid, units: tuple[str, str, str] = ("s", "N", "mm")) -> tuple[Rows, bool]:
    """The rows of a grid in s, mm, N, and whether there is one that is neither a row nor blank."""
    rows, odd = [], False
    for row in cells[HEAD:]:
        values = row[:3]
        if len(values) == 3 and all(type(value) in (int, float) for value in values):
            time, force, travel = (value * FACTORS[u] for value, u in zip(values, units, strict=True))  # type: ignore[operator]
            rows.append((time, travel, force))
        elif any(value not in (None, "") for value in values):
            odd = True
    return rows, odd


def archive_spoilt(rng: Random) -> WorkbookMutant:
    data = bytearray(saved(grid()))
    how = rng.choice(("flip", "flip", "cut", "remove", "zero"))
    at = rng.randrange(len(data))
    if how == "flip":
        data[at] ^= 1 << rng.randrange(8)
    elif how == "cut":
        del data[at:]
    elif how == "remove":
        del data[at : at + rng.choice((1, 10, 300))]
    else:
        data[at : at + 8] = bytes(8)
    return WorkbookMutant(f"archive: {how}", bytes(data[:]), meaning(grid())[0])


def rows_spoilt(rng: Random) -> WorkbookMutant:
    cells, how = (
        grid(),
        rng.choice(("removed", "duplicated", "swapped", "blank", "moved up", "shorter", "remark")),
    )
    at = rng.randrange(HEAD, len(cells) - 2)
    if how == "removed":
        del cells[at : at + rng.choice((1, 5))]
    elif how == "duplicated":
        cells.insert(at, list(cells[at]))
    elif how == "swapped":
        cells[at], cells[at + 1] = cells[at + 1], cells[at]
    elif how == "blank":
        cells.insert(at, [])
    elif how == "moved up":
        moved = cells.pop(at)
        cells.insert(0, moved)
        return WorkbookMutant("rows: moved up", saved(cells), meaning(cells)[0], odd=True)
    elif how == "shorter":
        cells[-1] = cells[-1][: rng.randrange(1, 3)]
    else:
        cells.insert(at, ["paused by operator"])
    rows, odd = meaning(cells)
    return WorkbookMutant(f"rows: {how}", saved(cells), rows, odd)


def cell_edited(rng: Random) -> WorkbookMutant:
    cells = grid()
    at, k = rng.randrange(HEAD, len(cells)), rng.randrange(3)
    cells[at][k] = rng.choice(
        (
            0, 7, -3.25, 1e-300, 1e300, 123456789.5, cells[at][k], True, None, "", "text", "1,5", "1.5",
            "#N/A", dt.datetime(2020, 1, 1), dt.time(0, 1, 30), "=1+1", " ", "nan", "1e3",
        )
    )  # fmt: skip
    rows, odd = meaning(cells)
    return WorkbookMutant("cell edited", saved(cells), rows, odd)


def valid_unit(rng: Random) -> WorkbookMutant:
    cells, units = grid(), ["s", "N", "mm"]
    column = rng.randrange(3)
    channel = (0, 2, 1)[column]
    units[column] = rng.choice(UNITS_OF[channel])
    cells[2][column] = units[column]
    return WorkbookMutant(
        "another valid unit", saved(cells), meaning(cells, (units[0], units[1], units[2]))[0]
    )


def unit_spoilt(rng: Random) -> WorkbookMutant:
    cells = grid()
    cells[2][rng.randrange(3)] = rng.choice(("zork", "", None, "MPa", "Nn", "?", "mm/s", 7))
    return WorkbookMutant("unit spoilt", saved(cells), None)


def marks_spoilt(rng: Random) -> WorkbookMutant:
    """Numbers that a spreadsheet of another language took for text, in a few cells or a column."""
    cells, k, new = grid(), rng.randrange(3), rng.choice((",", "..", " ", ".0,"))
    rows = range(HEAD, len(cells)) if rng.random() < 0.3 else rng.sample(range(HEAD, len(cells) - 1), 2)
    for at in rows:
        cells[at][k] = f"{cells[at][k]:.3f}".replace(".", new)
    return WorkbookMutant("numbers as text", saved(cells), None)


WORKBOOK_MUTATIONS: dict[str, tuple[Callable[[Random], WorkbookMutant], ...]] = {
    "a": (archive_spoilt, archive_spoilt, rows_spoilt, rows_spoilt),
    "b": (cell_edited, cell_edited, valid_unit),
    "c": (unit_spoilt, marks_spoilt),
}


def judge_workbook(mutant: WorkbookMutant, item: Trial | InputError) -> Outcome:
    """As for text: equal to what is meant, or refused; a lost row is told."""
    if isinstance(item, InputError):
        return "refused"
    codes = {flag.code for flag in item.flags}
    if mutant.rows is None:
        if not codes & DOUBTS:
            raise WrongError("read without a doubt")
        return "flagged"
    if mutant.odd and not codes & {"rows_skipped", "cut_row"}:
        raise WrongError("a row that is none was passed over")
    compare(item, mutant.rows)
    return "flagged" if codes else "read"
