"""Numbers that may have lost their decimal marks, where the print alone can't prove it.

A column of whole numbers beside columns with decimals, numbers padded with zeros (``0.50`` became
``050``), or single whole numbers several times larger than what stands around them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.ingest.vocabulary import CHANNELS, Channel

#: Rows from which a column of whole numbers is worth a remark.
_WHOLE_FROM = 20
#: A lost mark makes a number ten times larger or more; half of that stands out from a steep curve.
_TIMES = 5.0
_PADDED = re.compile(r"\s*[+-]?0\d+\s*")
#: Zeros behind a mark that groups no thousands: the numbers are whole, and their marks are there.
_MARKED = re.compile(r"\s*[+-]?(?:0[.,]\d+|[\d.,' ]*[.,](?:\d{1,2}|\d{4,}))\s*")


def lost_marks(
    columns: Sequence[FloatArray],
    fractional: Sequence[NDArray[np.bool_]],
    factors: Mapping[Channel, float],
    first_row: Sequence[str],
) -> Flag | None:
    """Flag ``no_decimals`` for the first of the three channels that looks as if marks were lost.

    ``columns`` (n,): time, displacement and force as printed; ``fractional`` (n,): numbers with decimals;
    ``factors``: what turns them into s, mm and N; ``first_row``: the cells of the first row, in the same
    order.
    """
    for channel, cell in zip(CHANNELS, first_row, strict=False):
        if _PADDED.fullmatch(cell):
            return _flag(channel, f"is padded with zeros, first {cell.strip()!r}")
    marked = [k < len(first_row) and bool(_MARKED.fullmatch(first_row[k])) for k in range(len(columns))]
    whole = [
        column.size >= _WHOLE_FROM and not decimals.any() and not has_marks
        for column, decimals, has_marks in zip(columns, fractional, marked, strict=True)
    ]
    for channel, column, is_whole in zip(CHANNELS, columns, whole, strict=True):
        if is_whole and _worth_a_remark(channel, column, factors[channel], all_whole=all(whole)):
            return _flag(channel, f"is a whole number in all {column.size} rows")
    for channel, column, decimals in zip(CHANNELS, columns, fractional, strict=True):
        at = _far_above_neighbours(column, decimals)
        if at is not None:
            return _flag(channel, f"is {column[at]:g} in row {at + 1}, far above its neighbours")
    return None


def _flag(channel: Channel, what: str) -> Flag:
    message = f"the {channel} as printed {what}: decimal marks lost?"
    return Flag("no_decimals", message, {"quantity": channel})


def _worth_a_remark(channel: Channel, column: FloatArray, factor: float, *, all_whole: bool) -> bool:
    """True where whole numbers surprise: not where a clock counts seconds, or small units."""
    if all_whole:
        return factor < 1.0  # whole in s, mm and N as well is said of the recording
    if channel != "time":
        return bool(column.any())
    steps = np.diff(column)
    return factor >= 1.0 and float(steps[steps > 0].min(initial=np.inf)) > 1.0


def _far_above_neighbours(column: FloatArray, decimals: NDArray[np.bool_]) -> int | None:
    """The first whole number several times larger than the nearest numbers with decimals around it."""
    count = int(np.count_nonzero(decimals))
    if 2 * count < column.size or count < _WHOLE_FROM or count == column.size:
        return None
    fractional, whole = np.flatnonzero(decimals), np.flatnonzero(~decimals)
    after = np.searchsorted(fractional, whole)
    size = np.abs(column[fractional])
    around = np.maximum(size[np.maximum(after - 1, 0)], size[np.minimum(after, fractional.size - 1)])
    far = np.flatnonzero(np.abs(column[whole]) >= _TIMES * around)
    return int(whole[far[0]]) if far.size else None
