"""Cells that say themselves what they hold: ``t:0.10 F=1.25``, ``0.10 s;1.25 N``, or a column of units."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from tissueid.ingest.numbers import Row, is_word, looks_numeric
from tissueid.ingest.refusals import Place
from tissueid.ingest.vocabulary import CHANNELS, is_units_key
from tissueid.units import bare_unit, quantity_of

#: Rows that show how cells are written, and the share of lines with a number that are written so.
FEWEST_ROWS, ALIKE = 5, 0.9
_MARKS = (b"\t", b";", b"|", b",")
_LABEL = rb"(?:([A-Za-z_\x80-\xff][\w ()./\x80-\xff-]{0,39}?)[ ]*[:=][ ]*)?"
_UNIT = rb"([A-Za-z%\x80-\xff][\w/^*%\x80-\xff]{0,11})"
_NUMBER = rb"[+-]?(?:\d+(?:[.,]\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_CELL = re.compile(rb"[ \"]*" + _LABEL + rb"(%b)(?:[ ]*%b)?[ \"]*\r?" % (_NUMBER, _UNIT))
_SPACED = re.compile(_LABEL + rb"(%b)(?:[ ]?%b(?![ ]?[:=]))?(?:[ ]+|\r?$)" % (_NUMBER, _UNIT))
#: Letters beside a number, as no plain row has them but in an exponent.
_WORDED = re.compile(rb"[:=] ?[+-]?\.?\d|\d ?(?![eE][+-]?\d)[A-Za-z%\x80-\xff]")
_WORDED_LINE = re.compile(rb"^[^\n]*?(?:%b)[^\n]*" % _WORDED.pattern, re.MULTILINE)


class _Form(NamedTuple):
    """A row as it is written: the mark between its cells, their labels and units, empty where none is."""

    mark: bytes
    labels: tuple[bytes, ...]
    units: tuple[bytes, ...]

    def pattern(self) -> re.Pattern[bytes]:
        """Pattern of such a line, a group for each number."""
        number = _NUMBER.replace(b"[.,]", b"[.]") if self.mark == b"," else _NUMBER
        cells = (
            rb"[ \"]*"
            + (rb"%b[ ]*[:=][ ]*" % re.escape(label) if label else b"")
            + rb"(%b)[ ]*%b[ \"]*" % (number, re.escape(unit))
            for label, unit in zip(self.labels, self.units, strict=True)
        )
        between = rb"[ ]+" if self.mark == b" " else re.escape(self.mark)
        return re.compile(rb"^" + between.join(cells) + rb"[,;]?[ ]*(?=\r?$)", re.MULTILINE)


def bare_rows(
    data: bytes, lines: Sequence[bytes], place: Place
) -> tuple[bytes, tuple[bytes, ...], tuple[bytes, ...]]:
    """A text whose rows hold numbers alone, with the labels and units that stood in them; else as it is.

    ``lines``: its head.  A row in other units than the rest is refused.
    """
    worded = [line for line in lines if _WORDED.search(line)]
    forms = Counter(form for line in worded if (form := _form(line)) is not None)
    form, count = forms.most_common(1)[0] if forms else (None, 0)
    if form is None or count < FEWEST_ROWS or count < ALIKE * len(worded):
        return data, (), ()
    plain = form.mark.join(rb"\g<%d>" % k for k in range(1, len(form.labels) + 1))
    bare = form.pattern().sub(plain, data)
    for line in _WORDED_LINE.finditer(bare):
        other = _form(line[0])
        if other is not None and other.labels == form.labels:
            units = [b" ".join(one.units).decode("utf-8", "replace").strip() for one in (other, form)]
            number = bare.count(b"\n", 0, line.start()) + 1
            message = f"the cells are in {units[0]!r}, elsewhere in {units[1]!r}; export them in one unit"
            place.refuse("unit_conflict", message, line=number)
    return bare, form.labels, form.units


def _form(line: bytes) -> _Form | None:
    """Form of a row; None where it is no row, or its cells hold numbers alone."""
    for mark in _MARKS:
        cells = [_CELL.fullmatch(cell) for cell in line.rstrip(b"\r,; ").split(mark)]
        if len(cells) > 1 and all(cells):
            return _of(mark, [cell for cell in cells if cell])
    spaced = list(_SPACED.finditer(line.strip()))
    if len(spaced) > 1 and sum(len(cell[0]) for cell in spaced) == len(line.strip()):
        return _of(b" ", spaced)
    return None


def _of(mark: bytes, cells: Sequence[re.Match[bytes]]) -> _Form | None:
    labels, units = (tuple(cell[group] or b"" for cell in cells) for group in (1, 3))
    known = all(quantity_of(unit.decode("utf-8", "replace")) for unit in units if unit)
    return _Form(mark, labels, units) if known and (any(labels) or any(units)) else None


def _is_unit(before: str, cell: str) -> bool:
    return looks_numeric(before) and quantity_of(cell.strip()) in CHANNELS


def units_beside(names: Row, rows: Iterable[Row], place: Place) -> Row:
    """Units that a column of its own gives to the one before it: ``Load,Units`` over ``1.25,lbf``.

    ``names``: those of the columns; of a file without any, its first row.
    """
    printed: dict[int, set[str]] = {
        k: set() for k, name in enumerate(names) if k and (is_units_key(name) or _is_unit(names[k - 1], name))
    }
    for row in rows if printed else ():
        for k, units in printed.items():
            if len(row) > k and looks_numeric(row[k - 1]) and is_word(row[k]):
                units.add(row[k].strip())
    for k, units in printed.items():
        if len(units) > 1:
            one, other = sorted(units)[:2]
            message = f"column {names[k]!r} gives two units, {one!r} and {other!r}; export it in one"
            place.refuse("unit_conflict", message, column=k + 1)
    return tuple(next(iter(printed.get(k + 1, ())), "") for k in range(len(names)))


def with_units(names: Row, units: Row, own: Row, place: Place) -> Row:
    """Units of a head, and those that stand in the cells where it has none."""
    if not any(own):
        return units
    stated = tuple(unit.strip() for unit in (*units, *[""] * len(own)))
    for name, one, other in zip(names, stated, own, strict=False):
        if one and other and bare_unit(one) != other:
            message = f"column {name!r} is in {one!r} by its head and in {other!r} by its cells; correct one"
            place.refuse("unit_conflict", message)
    return tuple(one or other for one, other in zip(stated, own, strict=False))
