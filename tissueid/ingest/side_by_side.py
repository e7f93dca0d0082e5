"""Specimens side by side in one table: each with a time of its own, or all beside one."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, takewhile
from typing import Any

from tissueid.errors import InputError
from tissueid.ingest.columns import has_channels
from tissueid.ingest.numbers import Row
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.refusals import moved
from tissueid.ingest.vocabulary import CHANNELS, Channel, plain_words, rank_of, split_name


@dataclass(frozen=True, slots=True)
class SpecimenColumns:
    """The columns of one specimen, the time that it shares, and its name: that above them, or its number."""

    name: str
    columns: tuple[int, ...]
    is_named: bool
    time: int | None = None

    def of(self, row: Sequence[Any]) -> tuple[Any, ...]:
        """The cells of the specimen in a row; fewer where the row is short, empty where it has ended."""
        own = tuple(row[k] for k in self.columns if k < len(row))
        if self.time is None:
            return own
        return (row[self.time], *own) if any(str(cell).strip() for cell in own) else ("",)

    def placed(self, error: InputError) -> InputError:
        """A refusal that points at the column of the file, not of the specimen."""
        columns = self.columns if self.time is None else (self.time, *self.columns)
        if error.column is None or error.column > len(columns):
            return error
        return moved(error, column=columns[error.column - 1] + 1)


def specimen_columns(
    above: Sequence[str], names: Sequence[str], units: Sequence[str], options: ReadOptions
) -> list[SpecimenColumns]:
    """The specimens of a table, each beginning under its name, or else at a column of time or beside one."""
    by_name = [index for index, name in enumerate(above[: len(names)]) if name.strip()]
    spans, repeats = _spans(by_name, names), _repeats(names, len(CHANNELS))
    # names that stand elsewhere than above what repeats are not those of specimens
    above_all = not repeats or by_name == [start for start, _ in repeats]
    if (
        above_all
        and len(spans) > 1
        and all(_holds_force(names[start:stop], units[start:stop], options) for start, stop in spans)
    ):
        return _named_by(above, spans)
    spans = repeats or _spans([i for i, name in enumerate(names) if _is(name, "time")], names)
    own_time = bool(spans) and all(has_channels(names[a:b], units[a:b], options) for a, b in spans)
    if own_time and all(_named(above[start:stop]) for start, stop in spans):
        return _named_by(above, spans)
    groups = {tuple(name.strip() for name in names[start:stop] if name.strip()) for start, stop in spans}
    if own_time and len(spans) > 1 and (repeats or len(groups) == 1):
        return [SpecimenColumns(str(k), tuple(range(*span)), False) for k, span in enumerate(spans, 1)]
    return _beside_one_time(above, names, units, options)


def _named_by(above: Sequence[str], spans: Sequence[tuple[int, int]]) -> list[SpecimenColumns]:
    return [SpecimenColumns(above[span[0]].strip(), tuple(range(*span)), is_named=True) for span in spans]


def _beside_one_time(
    above: Sequence[str], names: Sequence[str], units: Sequence[str], options: ReadOptions
) -> list[SpecimenColumns]:
    """Specimens of a displacement and a force each behind one time; none where they may be more sensors.

    ``Extension`` and ``Compressive extension`` are of one specimen, and so are ``Force X`` and ``Force Y``.
    """
    first = next((index for index, name in enumerate(names) if name.strip()), 0)
    rest = ["" if index <= first else name for index, name in enumerate(names)]
    units = (*units, *[""] * len(names))
    if not names or not _is(names[first], "time") or any(_is(name, "time") for name in rest):
        return []
    spans = _repeats(rest, 2)
    if not spans:
        return []
    words = [tuple(plain_words(split_name(names[k].strip())[0]) for k in range(*span)) for span in spans]
    filled = [index for index, cell in enumerate(above[: len(names)]) if cell.strip() and index > first]
    named = filled == [start for start, _ in spans]
    if not (named or len(set(words)) == 1 or _told_apart(words)) or not all(
        has_channels((names[first], *names[a:b]), (units[first], *units[a:b]), options) for a, b in spans
    ):
        return []
    return [
        SpecimenColumns(above[a].strip() if named else str(k), tuple(range(a, b)), named, first)
        for k, (a, b) in enumerate(spans, 1)
    ]


def _told_apart(groups: Sequence[Row]) -> bool:
    """True where a number tells each group apart (``Force``, ``Force.1``), or a word each of three."""
    numbers = [{number for name in group for number in re.findall(r"\d+", name)} for group in groups]
    counted = [next(iter(one)) for one in numbers if len(one) == 1]
    by_spreadsheet = not numbers[0] and counted == [str(k) for k in range(1, len(groups))]
    if by_spreadsheet or len(set(counted)) == len(groups):
        return True
    words = [_difference(tuple(groups[0][0].split()), tuple(group[0].split())) for group in groups[1:]]
    return len(words) > 1 and all(min(len("".join(one)), len("".join(other))) > 1 for one, other in words)


#: Where a word of letters goes on as a number: ``F2``.
_GLUED_NUMBER = re.compile(r"(?<=[^\W\d_])(?=\d+\b)")


def _is(name: str, channel: Channel) -> bool:
    return rank_of(split_name(name.strip())[0], channel, loose=False) is not None


def _repeats(names: Sequence[str], fewest: int) -> list[tuple[int, int]]:
    """Columns of groups that repeat the same names in the same order, but for one word or number a group."""
    filled = [i for i, name in enumerate(names) if name.strip()]
    words = [tuple(_GLUED_NUMBER.sub(" ", plain_words(names[i])).split()) for i in filled]
    for size in range(fewest, len(filled) // 2 + 1):
        groups = [words[at : at + size] for at in range(0, len(words), size)]
        if len(filled) % size == 0 and all(_same_but_for_a_word(groups[0], group) for group in groups[1:]):
            return list(pairwise([*filled[::size], len(names)]))
    return []


def _same_but_for_a_word(one: Sequence[Row], other: Sequence[Row]) -> bool:
    """True where names are equal, differ by the number of the group, or each by its word."""
    differences = [_difference(a, b) for a, b in zip(one, other, strict=True)]
    found = {difference for difference in differences if difference != ((), ())}
    numbers = all(word.isdecimal() for pair in found for side in pair for word in side)
    return not found or (len(found) == 1 and (numbers or len(set(differences)) == 1))


def _difference(one: Row, other: Row) -> tuple[Row, Row]:
    """Words of both names without those that they begin and end with alike."""
    head = _alike(one, other)
    one, other = one[head:], other[head:]
    tail = _alike(one[::-1], other[::-1])
    return one[: len(one) - tail], other[: len(other) - tail]


def _alike(one: Row, other: Row) -> int:
    """Number of words that two names begin with alike."""
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(one, other, strict=False)))


def _spans(starts: Sequence[int], names: Sequence[str]) -> list[tuple[int, int]]:
    """Columns from each start to the next; none where named columns stand before the first."""
    if not starts or any(name.strip() for name in names[: starts[0]]):
        return []
    return list(pairwise([*starts, len(names)]))


def _holds_force(names: Sequence[str], units: Sequence[str], options: ReadOptions) -> bool:
    """Columns of a recording, its time apart."""
    return has_channels(names, units, options) or (
        sum(bool(name.strip()) for name in names) == 2
        and any(_is(name, "force") for name in names)
        and any(_is(name, "displacement") for name in names)
    )


def _named(above: Sequence[str]) -> bool:
    """True where one name stands above a group: over its first column, or over each."""
    cells = {cell.strip() for cell in above if cell.strip()}
    return len(cells) == 1 and above[0].strip() in cells
