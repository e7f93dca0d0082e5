"""Specimens whose columns stand side by side in one table, each under its name.

::

    1_1             1_2
    Time Force Stroke Time Force Stroke
    sec  N     mm     sec  N     mm
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from tissueid.errors import InputError
from tissueid.ingest.columns import has_channels, split_name
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.vocabulary import Channel, rank_of


@dataclass(frozen=True, slots=True)
class SpecimenColumns:
    """The columns ``[start, stop)`` of one specimen, and its name: that above them, or its number."""

    name: str
    start: int
    stop: int
    is_named: bool


def specimen_columns(
    above: Sequence[str], names: Sequence[str], units: Sequence[str], options: ReadOptions
) -> list[SpecimenColumns]:
    """The specimens of a table, each beginning under its name, or else at a column of time.

    ``above``, ``names``, ``units``: the row with the specimens' names, and the two below it.  Returns empty
    where the columns are not those of specimens.  A specimen may lack its time where others of the same names
    stand beside it: it is refused by itself.
    """
    by_name = [index for index, name in enumerate(above[: len(names)]) if name.strip()]
    spans = _spans(by_name, names)
    if len(spans) > 1 and all(
        _holds_force(names[start:stop], units[start:stop], options) for start, stop in spans
    ):
        return [SpecimenColumns(above[start].strip(), start, stop, is_named=True) for start, stop in spans]
    spans = _spans([i for i, name in enumerate(names) if _is(name, "time")], names)
    if not spans or not all(has_channels(names[a:b], units[a:b], options) for a, b in spans):
        return []
    if all(_named(above[start:stop]) for start, stop in spans):
        return [SpecimenColumns(above[start].strip(), start, stop, is_named=True) for start, stop in spans]
    groups = {tuple(name.strip() for name in names[start:stop] if name.strip()) for start, stop in spans}
    if len(spans) < 2 or len(groups) > 1:
        return []
    return [SpecimenColumns(str(k), *span, is_named=False) for k, span in enumerate(spans, 1)]


def _is(name: str, channel: Channel) -> bool:
    return rank_of(split_name(name.strip())[0], channel, loose=False) is not None


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


def shifted(error: InputError, columns: int) -> InputError:
    """A refusal that points at the column of the file, not of the specimen."""
    column = None if error.column is None else error.column + columns
    return InputError(
        error.code, error.message, path=error.path, sheet=error.sheet, line=error.line, column=column
    )
