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
from tissueid.ingest.vocabulary import rank_of

__all__ = ["SpecimenColumns", "shifted", "specimen_columns"]


@dataclass(frozen=True, slots=True)
class SpecimenColumns:
    """The columns ``[start, stop)`` of one specimen, and the name above them."""

    name: str
    start: int
    stop: int


def specimen_columns(
    above: Sequence[str], names: Sequence[str], units: Sequence[str], options: ReadOptions
) -> list[SpecimenColumns]:
    """The specimens of a table, each beginning at a column of time.

    Parameters
    ----------
    above, names, units : sequence of str
        The row with the specimens' names, and the two below it.
    options : ReadOptions

    Returns
    -------
    list of SpecimenColumns
        Empty where a group has no name of its own above it, or lacks a channel.
    """
    times = [
        index
        for index, name in enumerate(names)
        if rank_of(split_name(name.strip())[0], "time", loose=False) is not None
    ]
    if not times or any(name.strip() for name in names[: times[0]]):
        return []
    found = []
    for start, stop in pairwise([*times, len(names)]):
        cells = {cell.strip() for cell in above[start:stop] if cell.strip()}
        named = len(cells) == 1 and above[start].strip() in cells
        if not named or not has_channels(names[start:stop], units[start:stop], options):
            return []
        found.append(SpecimenColumns(above[start].strip(), start, stop))
    return found


def shifted(error: InputError, columns: int) -> InputError:
    """A refusal that points at the column of the file, not of the specimen."""
    column = None if error.column is None else error.column + columns
    return InputError(
        error.code, error.message, path=error.path, sheet=error.sheet, line=error.line, column=column
    )
