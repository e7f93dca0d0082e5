"""Printed numbers: the grammar of a cell, and which mark is the decimal one.

::

    number  := [sign] digits [D [digits]] [exponent]  |  [sign] D digits [exponent]
    grouped := [sign] 1-3 digits, not 0 first {M 3 digits} D [digits] [exponent]

``D`` is the decimal mark of the file, ``M`` one thousands separator.  A grouped number must carry its
decimal mark: exports print fixed decimals, and ``361.639.800`` is a number whose decimal point a
spreadsheet destroyed, not 361 million.  Nothing is ever repaired.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, lru_cache

#: Thousands separators seen inside cells, besides the mark that is not the decimal one.
MARKS = "\u00a0\u202f '\u2019"
_SAME_MARK = {"\u00a0": " ", "\u202f": " ", "\u2019": "'"}

#: Cells of a line.
Row = tuple[str, ...]

#: Not the no-break space: it separates thousands, and may have lost the digits before it.
_PADDING = " \t\r\n"

_EXPONENT = r"(?:[eE][+-]?\d+)?"
#: Anything meant as a number, sound or damaged.
_NUMERIC_LOOK = re.compile(rf"[+-]?(?:\d[\d.,{MARKS}]*|[.,]\d+){_EXPONENT}", re.ASCII)
#: Longest cell of which the look is remembered.
_LONGEST_KEPT = 32
_NOT_FINITE = re.compile(
    r"[+-]?(?:nan|inf|infinity|1\.#(?:inf|ind|qnan)\d*|#n/a|#div/0!|n/?a)", re.IGNORECASE
)


@dataclass(frozen=True, slots=True)
class CellFault:
    """Why a cell is no number: a refusal code and a sentence with the text as printed."""

    code: str
    message: str


def quoted(text: str, most: int) -> str:
    """A text in quotes, cut to so many characters."""
    return repr(text if len(text) <= most else text[: most - 3] + "...")


def looks_numeric(text: str) -> bool:
    """True where a cell is meant as a number, be it sound or damaged."""
    # a head is looked over a dozen times; what is long is no number that comes again
    return _looks_numeric(text) if len(text) <= _LONGEST_KEPT else _looks_numeric.__wrapped__(text)


def is_word(text: str) -> bool:
    """True where a cell holds letters and is meant as no number, not even as a missing one."""
    return any(map(str.isalpha, text)) and not looks_numeric(text) and not _NOT_FINITE.fullmatch(text.strip())


@lru_cache(maxsize=8192)
def _looks_numeric(text: str) -> bool:
    return _NUMERIC_LOOK.fullmatch(text.strip()) is not None


@cache
def _grammar(decimal: str) -> tuple[re.Pattern[str], re.Pattern[str]]:
    point = re.escape(decimal)
    marks = MARKS + (",.".replace(decimal, ""))
    plain = re.compile(rf"[+-]?(?:\d+(?:{point}\d*)?|{point}\d+){_EXPONENT}", re.ASCII)
    grouped = re.compile(
        rf"[+-]?[1-9]\d{{0,2}}(?P<mark>[{re.escape(marks)}])\d{{3}}(?:(?P=mark)\d{{3}})*{point}\d*{_EXPONENT}",
        re.ASCII,
    )
    return plain, grouped


def parse_number(text: str, decimal: str) -> float | CellFault:
    """The value of a cell, or why it has none."""
    stripped = text.strip(_PADDING)
    plain, grouped = _grammar(decimal)
    if plain.fullmatch(stripped):
        value = float(stripped.replace(decimal, "."))
    elif match := grouped.fullmatch(stripped):
        value = float(stripped.replace(match["mark"], "").replace(decimal, "."))
    else:
        return _fault(text, stripped, decimal)
    if not math.isfinite(value):
        return CellFault("not_finite", f"{text!r} is too large for a number; correct or remove the row")
    return value


def grouping_mark(text: str, decimal: str) -> str | None:
    """The thousands separator of a sound number, ``None`` where it has none; all spaces are one kind."""
    match = _grammar(decimal)[1].fullmatch(text.strip(_PADDING))
    if match is None:
        return None
    return _SAME_MARK.get(match["mark"], match["mark"])


def _fault(text: str, stripped: str, decimal: str) -> CellFault:
    shown = quoted(text, 40)
    other = "." if decimal == "," else ","
    if not stripped.strip():
        return CellFault("empty_cell", "the cell is empty; fill or remove the row, or export the file again")
    if _NOT_FINITE.fullmatch(stripped):
        return CellFault("not_finite", f"{shown} is not a finite number; correct or remove the row")
    if not looks_numeric(stripped):
        return CellFault(
            "text_in_numbers", f"{shown} stands where a number must be; correct or remove the row"
        )
    if _grammar(other)[0].fullmatch(stripped) and decimal not in stripped:
        if re.fullmatch(rf"[+-]?[1-9]\d{{0,2}}{re.escape(other)}\d{{3}}", stripped):
            return CellFault(
                "ambiguous_decimal",
                f"{shown} may be a decimal number or a thousand and more: the decimal mark of this file is"
                f" {decimal!r}; export the file again with one decimal mark",
            )
        return CellFault(
            "inconsistent_decimal",
            f"{shown} has the decimal mark {other!r}, the rows before it have {decimal!r};"
            " export the file again with one decimal mark",
        )
    return CellFault(
        "damaged_number",
        f"{shown} is no number with decimal mark {decimal!r}: its marks were lost or doubled, as by a"
        " spreadsheet of another language; go back to the original export",
    )


def decimal_evidence(cells: Iterable[str]) -> tuple[int, int, int]:
    """Count of cells that speak for the point, for the comma, and for neither though they have a mark.

    A mark is decimal for certain where it stands once and what follows it is not a group of three, or what
    precedes it can't be a leading group (``0.500``); or where it is the last of two kinds.
    """
    votes = {".": 0, ",": 0, "": 0}
    for cell in cells:
        points, commas = cell.count("."), cell.count(",")
        if not points and not commas:
            continue
        text = cell.strip().lstrip("+-").partition("e")[0].partition("E")[0]
        last = "." if text.rfind(".") > text.rfind(",") else ","
        if points and commas:
            votes[last if text.count(last) == 1 else ""] += 1
        elif points + commas > 1:
            votes[""] += 1
        else:
            before, after = text.split(last)
            grouping = len(after) == 3 and re.fullmatch(r"[1-9]\d{0,2}", before)
            votes["" if grouping else last] += 1
    return votes["."], votes[","], votes[""]
