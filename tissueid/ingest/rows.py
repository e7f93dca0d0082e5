"""The slow, exact reader of rows: the grammar, and the finger on the first bad cell.

It is used where the C parser met anything but whole rows of plain numbers, and it defines what a row
is; the fast path reads a subset of this grammar to the same values.

- A blank line, or one of empty cells, is nothing.
- A line without any number (a comment, a title) is left out and flagged; one made of digits that are no
  numbers, or that names other columns or units, is no comment.
- A last line with too few cells, or broken off inside a number, is left out and flagged.
- Everything else must have the cells of its neighbours and numbers in the three columns.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.ingest.columns import has_channels
from tissueid.ingest.layout import Layout, announced_results, is_units_row, results_flag, results_spans
from tissueid.ingest.numbers import CellFault, Row, grouping_mark, looks_numeric, parse_number, quoted
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import Text

_STARTS = re.compile(r"[\W_]*\d")
_EXPONENT = re.compile(r"(?<=\d)[eE][+-]?\d+")
#: Words with a letter: ``230403-FF1A`` is a specimen, not a number.
_NAMES = re.compile(r"[\w-]*[^\W\d_][\w-]*")
_NUMBERS = re.compile(r"\d+(?:[.,]\d+)?")
#: A clock or a date: remarks carry them.
_MOMENT = re.compile(r"(?<![\d.,])(?:\d{1,2}:\d{2}(?::\d{2})?|\d{1,4}([/.-])\d{1,2}\1\d{1,4})(?![\d.,])")
_GUID = re.compile(r"[0-9A-Fa-f]{8}-(?:[0-9A-Fa-f]{4}-){3}[0-9A-Fa-f]{12}")
#: Time, displacement and force.
_LEAST_NUMBERS = 3
#: Characters of a line that a refusal shows.
_SHOWN = 60
#: So many rows above the names are a table of their own, fewer may be results.
_TABLE_ROWS = 3


def row_like(line: str) -> bool:
    """True where a line is made of numbers, by whatever delimiter: a row, be it sound or damaged.

    >>> row_like("0.10&-2e-05&1.50"), row_like("13.11.2018 17:14"), row_like("2304-A1,2304-A1,2304-A1")
    (True, False, False)
    """
    bare = _NAMES.sub("", _EXPONENT.sub("", line))
    digits, letters = sum(map(str.isdecimal, bare)), sum(map(str.isalpha, line))
    return (
        _STARTS.match(line) is not None
        and len(_NUMBERS.findall(bare)) >= _LEAST_NUMBERS
        and digits >= letters
        and _MOMENT.search(line) is None
        and _GUID.search(line) is None
    )


def begins_a_table(cells: Sequence[str], names: Sequence[str], units: Sequence[str]) -> bool:
    """True where a line among the rows gives names or units other than those of the table."""
    filled = _stripped(cells)
    if filled in (_stripped(names), _stripped(units)):
        return False
    return (len(filled) > 1 and is_units_row(filled)) or has_channels(filled, (), ReadOptions())


def _stripped(cells: Sequence[str]) -> tuple[str, ...]:
    """The cells without padding and without empty ones at the end."""
    filled = [cell.strip() for cell in cells]
    while filled and not filled[-1]:
        filled.pop()
    return tuple(filled)


def flag_head(head: Sequence[Row], place: Place) -> tuple[Flag, ...]:
    """Flag of results and of rows of numbers above the names, which would pass for a header."""
    results = announced_results(head)
    said = tuple(results_flag(span.start + 1, span.stop) for span in results)
    inside = {index + 1 for span in results for index in span}
    found = [n for n, row in enumerate(head, 1) if n not in inside and row_like(" ".join(row))]
    if not found:
        return said
    named = any(has_channels(row, (), ReadOptions()) for row in head[: found[0] - 1])
    spans = {index + 1 for span in results_spans(head) for index in span}
    if named or len(set(found) - spans) >= _TABLE_ROWS:
        message = (
            f"{len(found)} lines of numbers stand above the names in line {len(head) + 1}: is this two"
            " files in one, or were lines moved? Export the file again, one recording a file"
        )
        place.refuse("mixed_tables", message, line=found[0], column=1)
    return (*said, skipped_flag(found, "lines of numbers above the names"))


def skipped_flag(lines: Sequence[int], what: str) -> Flag:
    """Lines that were left out."""
    shown = ", ".join(map(str, lines[:3])) + (" ..." if len(lines) > 3 else "")
    message = f"{len(lines)} {what} were left out: lines {shown}"
    return Flag("rows_skipped", message, {"count": len(lines), "lines": list(lines[:20])})


_CELL = r'"((?:[^"]|"")*)"|([^"{d}]*)'
#: Lines before the last one that say whether a column has fixed decimals.
_LOOK_BACK = 50


def _decimals(cell: str) -> int:
    """Digits after the last mark, -1 without a mark: equal for all cells of a fixed-decimals column."""
    match = re.search(r"[.,](\d*)$", cell.strip())
    return len(match[1]) if match else -1


class _Prints:
    """Print of the wanted columns' cells: one kind of thousands mark, and no mark lost.

    Where every other number of a column has the same two decimals or more, one without a mark that has
    more digits than these decimals lost its mark: ``1.23400`` became ``123400``.
    """

    def __init__(self, reader: RowReader) -> None:
        self._reader = reader
        self._groups: dict[str, int] = {}
        self._decimals: list[Counter[int]] = [Counter() for _ in reader.wanted]
        self._bare: list[list[tuple[int, str]]] = [[] for _ in reader.wanted]

    def add(self, cells: Sequence[str], number: int) -> None:
        """Look at one row; refuses a second kind of thousands mark."""
        reader = self._reader
        for k, index in enumerate(reader.wanted):
            cell = cells[index]
            mark = grouping_mark(cell, reader.layout.decimal)
            if mark is not None:
                self._groups.setdefault(mark, number)
                if len(self._groups) > 1:
                    first = next(iter(self._groups.items()))
                    message = (
                        f"{cell.strip()!r} is grouped by {mark!r}, the numbers from line {first[1]} on by"
                        f" {first[0]!r}; export the file again with one thousands separator"
                    )
                    reader.place.refuse("inconsistent_decimal", message, line=number, column=index + 1)
            places = _decimals(cell)
            self._decimals[k][places] += 1
            if places < 0:
                self._bare[k].append((number, cell.strip()))

    def refuse_lost_marks(self) -> None:
        """Refuse the first number that lost its mark."""
        for decimals, bare, index in zip(self._decimals, self._bare, self._reader.wanted, strict=True):
            places = max(decimals, default=-1)
            if set(decimals) != {-1, places} or places < 2 or decimals[places] <= decimals[-1]:
                continue
            if all(text.lstrip("+-").isdecimal() and len(text.lstrip("+-")) > places for _, text in bare):
                message = (
                    f"{bare[0][1]!r} has lost its decimal mark: the other numbers of the column have"
                    f" {places} decimals; go back to the original export"
                )
                self._reader.place.refuse("damaged_number", message, line=bare[0][0], column=index + 1)


@dataclass(frozen=True, slots=True)
class RowReader:
    """Reads the rows of one laid-out text."""

    text: Text
    layout: Layout
    wanted: tuple[int, ...]  # the columns of time, displacement and force, counted from 0
    place: Place

    @property
    def end(self) -> int:
        """End of the last line that has its line end."""
        return max(self.text.data.rfind(b"\n") + 1, self.layout.offset)

    def lines(self) -> Iterator[tuple[int, str]]:
        """One-based numbers and texts of the terminated lines that are not blank."""
        blank = f' \t"{self.layout.delimiter}'
        raw = self.text.data[self.layout.offset : self.end].splitlines()
        for number, line in enumerate(raw, start=self.layout.first_line):
            decoded = self.text.decode(line)
            if decoded.strip(blank):
                yield number, decoded

    def first_row(self) -> list[str]:
        """The wanted cells of the first line, as printed; empty where it is no row."""
        end = self.text.data.find(b"\n", self.layout.offset)
        line = self.text.data[self.layout.offset : end if end >= 0 else None]
        cells = self.cells(self.text.decode(line.rstrip(b"\r"))) or []
        return [cells[index] for index in self.wanted] if len(cells) == self.layout.n_columns else []

    def cells(self, line: str) -> list[str] | None:
        """The cells of a row, ``None`` where a quote is torn."""
        delimiter = self.layout.delimiter
        if '"' not in line:
            return line.split(delimiter)
        pattern = re.compile(_CELL.format(d=re.escape(delimiter)))
        cells, at = [], 0
        while match := pattern.match(line, at):
            cells.append(match[2] if match[1] is None else match[1].replace('""', '"'))
            at = match.end()
            if at == len(line):
                return cells
            if line[at] != delimiter:
                break
            at += 1
        return None

    def read(self) -> tuple[list[FloatArray], list[Flag]]:
        """Every terminated row, or a refusal of the first that can't be trusted."""
        values = [array("d") for _ in self.wanted]
        skipped: list[int] = []
        flags: list[Flag] = []
        print_check = _Prints(self)
        lines = list(self.lines())
        has_tail = bool(self.text.data[self.end :].strip())
        for number, line in lines:
            cells = self.cells(line)
            if cells is not None and not any(map(looks_numeric, cells)):
                self._refuse_if_no_remark(cells, line, number)
                skipped.append(number)
            elif number == lines[-1][0] and not has_tail and cells and 1 < len(cells) < self.layout.n_columns:
                flags.append(cut_flag(number, line))
            else:
                for store, value in zip(values, self.row(cells, line, number), strict=True):
                    store.append(value)
                print_check.add(cells or (), number)
        print_check.refuse_lost_marks()
        if skipped:
            flags.append(skipped_flag(skipped, "lines without numbers"))
        return [np.array(store, dtype=np.float64) for store in values], flags

    def _refuse_if_no_remark(self, cells: Sequence[str], line: str, number: int) -> None:
        """A line without numbers that is a damaged row, or heads another table."""
        shown = quoted(line, _SHOWN)
        if row_like(line):
            message = (
                f"{shown} is made of digits but is no row of this table; correct or remove it, or export the"
                " file again"
            )
            self.place.refuse("text_in_numbers", message, line=number, column=1)
        if begins_a_table(cells, self.layout.names, self.layout.units):
            message = (
                f"{shown} gives other names or units than line {self.layout.names_line or 1}: two recordings"
                " in one file; split it, one recording each"
            )
            self.place.refuse("ragged_rows", message, line=number, column=1)

    def row(self, cells: list[str] | None, line: str, number: int) -> list[float]:
        """The three values of a row; refuses anything else."""
        shown = quoted(line, _SHOWN)
        if cells is None:
            self.place.refuse(
                "damaged_number", f"a quote is torn in {shown}; export the file again", line=number, column=1
            )
        expected = self.layout.n_columns
        if self.layout.remarked and len(cells) == expected + 1 and not looks_numeric(cells[-1]):
            cells = cells[:-1]
        if len(cells) != expected:
            commas = self.layout.delimiter == "," and len(cells) == 2 * expected
            hint = " (a decimal comma can't be told from the delimiter)" if commas else ""
            message = (
                f"{len(cells)} cells where the other rows have {expected}: {shown}{hint};"
                " correct or remove the row, or export the file again"
            )
            self.place.refuse("ragged_rows", message, line=number, column=min(len(cells), expected) + 1)
        found = []
        for index in self.wanted:
            value = parse_number(cells[index], self.layout.decimal)
            if isinstance(value, CellFault):
                self.place.refuse(value.code, value.message, line=number, column=index + 1)
            found.append(value)
        return found

    def line_of_row(self, row: int) -> int:
        """One-based line of a row that was read, counted from 0."""
        numbered = (
            number for number, line in self.lines() if any(map(looks_numeric, self.cells(line) or ()))
        )
        for position, number in enumerate(numbered):
            if position == row:
                return number
        return self._last_line

    @property
    def _last_line(self) -> int:
        return self.layout.first_line + self.text.data.count(b"\n", self.layout.offset)

    def tail(self) -> tuple[list[float] | None, list[Flag]]:
        """The last line where it has no line end: its values if it is whole, and what to say of it.

        A number that was cut short is still a number.  In a column of fixed decimals it shows; elsewhere
        the row is kept and the doubt is flagged.
        """
        line = self.text.decode(self.text.data[self.end :])
        if not line.strip(f" \t{self.layout.delimiter}"):
            return None, []
        number = self._last_line
        cells = self.cells(line)
        verdict = self._tail_verdict(cells, line)
        if verdict == "cut":
            return None, [cut_flag(number, line)]
        row = self.row(cells, line, number)
        if verdict == "whole":
            return row, []
        message = f"line {number} is the last and has no line end: its number may be cut"
        return row, [Flag("cut_row", message, {"line": number, "kept": True})]

    def _tail_verdict(self, cells: list[str] | None, line: str) -> Literal["whole", "cut", "doubtful"]:
        if cells is None or len(cells) < self.layout.n_columns:
            return "cut"
        if len(cells) > self.layout.n_columns or line.rstrip().endswith('"'):
            return "whole"
        if isinstance(parse_number(cells[-1], self.layout.decimal), CellFault):
            return "cut" if len(cells) - 1 in self.wanted else "whole"
        if len(cells) - 1 not in self.wanted:
            return "whole"
        before = {_decimals(row[-1]) for row in self._rows_before_tail()}
        if len(before) != 1 or before == {-1}:
            # where zeros at the end are left off, this is all of a zero
            return "whole" if cells[-1].strip() in ("0.0", "-0.0") and max(before) > 1 else "doubtful"
        return "cut" if _decimals(cells[-1]) < before.pop() else "whole"

    def _rows_before_tail(self) -> Sequence[list[str]]:
        start = self.end
        for _ in range(_LOOK_BACK + 1):
            start = max(
                self.text.data.rfind(b"\n", self.layout.offset, max(start - 1, 0)), self.layout.offset
            )
        lines = self.text.data[start : self.end].splitlines()
        rows = (self.cells(self.text.decode(line)) for line in lines)
        return [row for row in rows if row is not None and len(row) == self.layout.n_columns]


def cut_flag(number: int, line: str) -> Flag:
    """The last row is incomplete and was left out."""
    message = f"line {number} is the last and incomplete: {line.strip()[-_SHOWN:]!r} was left out"
    return Flag("cut_row", message, {"line": number, "kept": False})
