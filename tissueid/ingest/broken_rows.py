"""Rows from which on a file can't be what it was: marks lost, columns exchanged, a row of something else.

Each number by itself is sound there; only the step to it gives it away.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.digits import clock_start
from tissueid.flags import Flag
from tissueid.ingest.columns import ColumnChoice
from tissueid.ingest.refusals import Place
from tissueid.ingest.vocabulary import CHANNELS, Channel

_Steps = tuple[FloatArray, FloatArray]

#: Rows needed to know the usual step, and rows before a break that show it.
FEWEST_ROWS, REACH = 20, 50
#: A lost mark multiplies by ten at least; the step to such a number is so many times the largest before.
LOST_TIMES, LOST_STEPS = 5.0, 20.0
#: Rows without decimals in a run, from which on the run is no accident of round numbers.
LOST_RUN = 3
#: Rows that are a tenth of both neighbours, as a share of all, from and to, and the share of the largest
#: value that these have at least; they agree within a share of themselves, the tenth within the digits left.
TENTHS_SHARE, TENTHS_MOST, TENTHS_HEIGHT, ALIKE, LEFT_DIGITS = 0.01, 0.25, 0.05, 0.1, 1e-3
#: A number whose mark is lost goes on within so many of the steps beside it.
GOES_ON = 4.0
#: Steps that exchanged columns continue crosswise within this share of what they jump by.
CROSSWISE = 0.05
#: Usual steps of travel, and of force, by which no sample stands off both its neighbours.
FOREIGN_TRAVEL, FOREIGN_FORCE = 1e4, 1e2
#: A jump that stays: so many times the steps beside it, and this share of the whole travel.
BESIDE_TIMES, JUMP_SHARE, BESIDE = 20.0, 0.05, 5
#: A force is at work beyond this share of its range, and the same after a leap within this share of itself.
AT_WORK, SAME_FORCE = 0.1, 0.02
#: A counter that starts again leaps by so many of the steps beside it.
RESTART_TIMES = 8.0
#: An interval so many times the usual is a gap in the log.
GAP_TIMES = 3.0


#: A number near the largest that there is may overflow in a comparison, and is refused behind it.
_overflowing = np.errstate(over="ignore", invalid="ignore")


class BrokenRow(NamedTuple):
    """Break of a table: row and channel, counted from 0, code and message of its refusal."""

    row: int
    channel: int
    code: str
    message: str


@_overflowing
def refuse_broken(
    columns: Sequence[FloatArray],
    fractional: Sequence[NDArray[np.bool_]],
    what: str,
    place: Place,
    cell: Callable[[int, int], tuple[int, int]],
) -> None:
    """Refuse a table of time, displacement and force that does not hold together, at its first sign.

    ``what``: what the table is in; ``cell``: line and column, from 1, of a row and a channel.
    """
    broken = _falling_time(columns[0], what) or _broken_row(columns, fractional)
    if broken is not None:
        line, column = cell(broken.row, broken.channel)
        place.refuse(broken.code, broken.message, line=line, column=column)


def _falling_time(time: FloatArray, what: str) -> BrokenRow | None:
    falls = np.flatnonzero(np.diff(time) < 0)
    if not falls.size:
        return None
    row = int(falls[0]) + 1
    message = (
        f"the time falls from {time[row - 1]:.10g} to {time[row]:.10g}: two recordings in one {what}, or a"
        f" damaged row; split the {what}, or name another time column with --columns time=NAME"
    )
    return BrokenRow(row, 0, "time_backwards", message)


def _broken_row(columns: Sequence[FloatArray], fractional: Sequence[NDArray[np.bool_]]) -> BrokenRow | None:
    if columns[0].size < FEWEST_ROWS:
        return _tenths(columns)
    travel, force = columns[1], columns[2]
    steps = np.abs(np.diff(travel)), np.abs(np.diff(force))
    return (
        _lost_marks(columns, fractional)
        or _thousands(columns)
        or _tenths(columns)
        or _exchanged(travel, force, steps)
        or _foreign(travel, force, steps)
    )


def _lost_marks(columns: Sequence[FloatArray], fractional: Sequence[NDArray[np.bool_]]) -> BrokenRow | None:
    """A run of numbers without decimals, far above the numbers before or behind it."""
    for k, (column, decimals) in enumerate(zip(columns, fractional, strict=True)):
        edges = np.flatnonzero(decimals[1:] != decimals[:-1]) + 1
        bounds = np.concatenate(([0], edges, [column.size]))
        runs = np.flatnonzero((np.diff(bounds) >= LOST_RUN) & ~decimals[bounds[:-1]])
        for start, stop in zip(bounds[runs].tolist(), bounds[runs + 1].tolist(), strict=True):
            if start > 0 and _leaps(column[max(0, start - REACH) : start], column[start]):
                row, sound = start, start - 1
            elif stop < column.size and _leaps(column[stop : stop + REACH][::-1], column[stop - 1]):
                row, sound = stop - 1, stop
            else:
                continue
            message = (
                f"the {CHANNELS[k]} is {column[row]:g} beside {column[sound]:g}, and {stop - start} rows have"
                " no decimals: decimal marks were lost; go back to the original export"
            )
            return BrokenRow(start, k, "damaged_number", message)
    return None


def _tenths(columns: Sequence[FloatArray]) -> BrokenRow | None:
    """Rows that are a tenth of their neighbours, again and again.

    A spreadsheet that takes points for thousands makes ``1.0114`` 10,114, but leaves ``1.063`` at 1,063.
    """
    for k, column in enumerate(columns):
        size = np.pad(np.abs(column), 2, mode="edge")
        two = np.maximum(size[1:], size[:-1])  # of which one may be a tenth itself
        before, here, after = two[:-3], size[2:-2], two[3:]
        mean, apart = (before + after) / 2.0, np.abs(after - before)
        tenth = np.abs(10.0 * here - mean) <= apart + LEFT_DIGITS * mean
        tenth &= (apart <= ALIKE * mean) & (mean > TENTHS_HEIGHT * size.max())
        rows = np.flatnonzero(tenth[1:-1]) + 1
        if max(LOST_RUN, TENTHS_SHARE * column.size) <= rows.size <= TENTHS_MOST * column.size:
            around = column[rows[0] - 1 : rows[0] + 2]
            message = (
                f"the {CHANNELS[k]} is {around[1]:g} between {around[0]:g} and {around[2]:g}, and {rows.size}"
                " rows are such a tenth: a spreadsheet took decimal marks for thousands; go back to the"
                " original export"
            )
            return BrokenRow(int(rows[0]), k, "damaged_number", message)
    return None


def _thousands(columns: Sequence[FloatArray]) -> BrokenRow | None:
    """The first number from 1 on that a spreadsheet grouped by thousands: it is left with three decimals."""
    for k, column in enumerate(columns):
        size = np.abs(column)
        below = size < 1.0
        coarse = np.abs(1e3 * size - np.rint(1e3 * size)) <= 1e-6 * np.maximum(size, 1.0)
        if not coarse[~below].all() or 2 * np.count_nonzero(coarse & below) >= np.count_nonzero(below):
            continue
        least, most = np.minimum(size[1:], size[:-1]), np.maximum(size[1:], size[:-1])
        for row in (np.flatnonzero((most >= 1.0) & (most >= LOST_TIMES * least)) + 1).tolist():
            up = size[row] > size[row - 1]
            at = row if up else row - 1
            towards = column[max(0, row - REACH) : row] if up else column[row : row + REACH][::-1]
            value = float(column[at])
            step = GOES_ON * float(np.abs(np.diff(towards[-4:])).max(initial=0.0))
            off = min(abs(value / times - float(towards[-1])) for times in (10.0, 100.0))
            if off <= step and _leaps(towards, value):
                message = (
                    f"the {CHANNELS[k]} is {value:g} beside {towards[-1]:g}, with three decimals from 1 on: a"
                    " spreadsheet took decimal marks for thousands; go back to the original export"
                )
                return BrokenRow(at, k, "damaged_number", message)
    return None


def _leaps(towards: FloatArray, value: float) -> bool:
    """A value several times larger than the last of those that lead to it, by far more than their steps."""
    last = float(towards[-1])
    if abs(value) < LOST_TIMES * abs(last):
        return False
    usual = float(np.abs(np.diff(towards)).max(initial=0.0))
    return 0.0 < LOST_STEPS * usual <= abs(value - last)


def _exchanged(travel: FloatArray, force: FloatArray, steps: _Steps) -> BrokenRow | None:
    """Displacement and force that go on in each other's column."""
    straight = np.minimum(*steps)
    row = int(np.argmax(straight)) + 1
    crosswise = max(abs(travel[row] - force[row - 1]), abs(force[row] - travel[row - 1]))
    if crosswise >= CROSSWISE * straight[row - 1]:
        return None
    message = (
        f"displacement and force go on in each other's column: {travel[row - 1]:g}, {force[row - 1]:g} is"
        f" followed by {travel[row]:g}, {force[row]:g}; export the file again"
    )
    return BrokenRow(row, 1, "mixed_tables", message)


def _foreign(travel: FloatArray, force: FloatArray, steps: _Steps) -> BrokenRow | None:
    """One row off both its neighbours in travel and in force by what no machine does."""
    rows = np.flatnonzero(steps[0][:-1] > FOREIGN_TRAVEL * _usual(steps[0])) + 1
    for values, step, times in ((travel, steps[0], FOREIGN_TRAVEL), (force, steps[1], FOREIGN_FORCE)):
        if rows.size == 0:
            return None
        usual = np.maximum(_usual(step), np.abs(values[rows + 1] - values[rows - 1]))
        rows = rows[np.minimum(step[rows - 1], step[rows]) / times > usual]
    if rows.size == 0:
        return None
    row = int(rows[0])
    message = (
        f"displacement {travel[row]:g} and force {force[row]:g} stand alone between {travel[row - 1]:g},"
        f" {force[row - 1]:g} and {travel[row + 1]:g}, {force[row + 1]:g}: a row of another recording;"
        " remove it, or export again"
    )
    return BrokenRow(row, 1, "mixed_tables", message)


def _usual(steps: FloatArray) -> float:
    # a long channel is told by some of it
    some = steps[:: steps.size // 8192 + 1]
    moving = some[some > 0.0]
    return float(np.median(moving)) if moving.size else np.inf


@_overflowing
def restart(time: FloatArray, travel: FloatArray) -> int | None:
    """The row behind which a counter of travel starts again: the tool turns, and goes on at its speed."""
    if travel.size < FEWEST_ROWS:
        return None
    step, took = np.diff(travel), np.diff(time)
    leaps = np.abs(step) >= max(RESTART_TIMES * _usual(np.abs(step)), JUMP_SHARE * float(np.ptp(travel)))
    for row in np.flatnonzero(leaps[BESIDE:-BESIDE]) + BESIDE:
        leap, sides = step[row], (slice(row - BESIDE, row), slice(row + 1, row + 1 + BESIDE))
        came, goes_on = (float(step[side].sum() / max(took[side].sum(), 1e-300)) for side in sides)
        alike = came * leap < 0.0 < goes_on * leap and 0.5 <= abs(goes_on / came) <= 2.0
        beside = max(float(np.abs(step[side]).max()) for side in sides)
        if alike and abs(leap) >= max(RESTART_TIMES * beside, GAP_TIMES * abs(came) * took[row]):
            return int(row)
    return None


def jump(time_s: FloatArray, displacement_mm: FloatArray, force_N: FloatArray) -> Flag | None:
    """``jump``, where the travel leaps between two samples and stays there, far, or under a force at work."""
    if time_s.size < FEWEST_ROWS:
        return None
    steps = np.abs(np.diff(displacement_mm))
    if (row := restart(time_s, displacement_mm)) is not None:
        words = f"displacement leaps by {steps[row]:.3g} mm at a turn, as a counter does: export a position"
        return Flag("jump", words, {"leap_mm": float(steps[row]), "at_s": float(time_s[row])})
    at = int(np.argmax(steps))
    leap = float(steps[at])
    if leap < JUMP_SHARE * float(np.ptp(displacement_mm)):
        return None
    interval = np.diff(time_s)
    if interval[at] > GAP_TIMES * float(np.median(interval)):
        return None  # said as a gap
    beside = np.concatenate((steps[max(0, at - BESIDE) : at], steps[at + 1 : at + 1 + BESIDE]))
    if beside.size == 0 or leap < BESIDE_TIMES * float(beside.max()):
        return None
    before = float(np.median(force_N[max(0, at + 1 - BESIDE) : at + 1]))
    after = float(np.median(force_N[at + 1 : at + 1 + BESIDE]))
    at_work = abs(before - float(np.median(force_N[:BESIDE]))) > AT_WORK * float(np.ptp(force_N))
    foreign = leap >= FOREIGN_TRAVEL * _usual(steps)
    if not foreign and not (at_work and abs(after - before) <= SAME_FORCE * abs(before)):
        return None
    when = float(time_s[at])
    leapt = f"the travel leaps by {leap:.3g} mm between two samples at {when - clock_start(time_s[0]):.4g} s"
    why = "two recordings in one?" if foreign else "zeroed?"
    return Flag("jump", f"{leapt}: {why}", {"leap_mm": leap, "at_s": when})


#: Rows from which a column of whole numbers is worth a remark.
WHOLE_FROM = 20
#: Units below this share of mm and N are those in which instruments count: nm, µN.
FINEST = 2e-6
#: A lost mark makes a number ten times larger or more; half of that stands out from a steep curve.
_TIMES = 5.0
_PADDED = re.compile(r"\s*[+-]?0\d+\s*")
#: Zeros behind a mark that groups no thousands: the numbers are whole, and their marks are there.
_MARKED = re.compile(r"\s*[+-]?(?:0[.,]\d+|\d[.,]\d+[eE][+-]?\d+|[\d.,' ]*[.,](?:\d{1,2}|\d{4,}))\s*")


def lost_marks(
    columns: Sequence[FloatArray],
    fractional: Sequence[NDArray[np.bool_]],
    choice: ColumnChoice,
    first_row: Sequence[str],
) -> Flag | None:
    """Flag ``no_decimals`` for the first of the three channels, as printed, that may have lost its marks."""
    factors = choice.factors
    for channel, cell in zip(CHANNELS, first_row, strict=False):
        if _PADDED.fullmatch(cell):
            return _flag(channel, f"is padded with zeros, first {cell.strip()!r}")
    marked = [k < len(first_row) and bool(_MARKED.fullmatch(first_row[k])) for k in range(len(columns))]
    whole = [
        column.size >= WHOLE_FROM and not decimals.any() and not has_marks
        for column, decimals, has_marks in zip(columns, fractional, marked, strict=True)
    ]
    all_whole = all(whole)
    counts = all_whole and max(factors.values()) < 1.0  # of a logger in ms, µm and mN
    for channel, column, is_whole in zip(CHANNELS, columns, () if counts else whole, strict=False):
        if channel in choice.stated and factors[channel] < 1.0:
            continue  # in a finer unit, as the user says, it may well be whole
        if is_whole and _worth_a_remark(channel, column, factors[channel], all_whole=all_whole):
            return _flag(channel, f"is whole in all {column.size} rows")
    for channel, column, decimals in zip(CHANNELS, columns, fractional, strict=True):
        at = _far_above_neighbours(column, decimals)
        if at is not None:
            return _flag(channel, f"is {column[at]:g} in row {at + 1}, far above its neighbours")
    return None


def _flag(channel: Channel, what: str) -> Flag:
    unit = {"time": "ms", "displacement": "um", "force": "mN"}[channel]
    other = f", or {unit} (--units {channel}={unit})" if "whole" in what else ""
    message = f"the {channel} as printed {what}: marks lost{other}?"
    return Flag("no_decimals", message, {"quantity": channel})


def _worth_a_remark(channel: Channel, column: FloatArray, factor: float, *, all_whole: bool) -> bool:
    """True where whole numbers surprise: not where a clock counts seconds, or a channel nm or µN."""
    if all_whole:
        return factor < 1.0  # whole in s, mm and N as well is said of the recording
    if channel != "time":
        return bool(column.any()) and factor > FINEST
    steps = np.diff(column)
    return factor >= 1.0 and float(steps[steps > 0].min(initial=np.inf)) > 1.0


def _far_above_neighbours(column: FloatArray, decimals: NDArray[np.bool_]) -> int | None:
    """The first whole number several times larger than the nearest numbers with decimals around it."""
    count = int(np.count_nonzero(decimals))
    if 2 * count < column.size or count < WHOLE_FROM or count == column.size:
        return None
    fractional, whole = np.flatnonzero(decimals), np.flatnonzero(~decimals)
    after = np.searchsorted(fractional, whole)
    size = np.abs(column[fractional])
    around = np.maximum(size[np.maximum(after - 1, 0)], size[np.minimum(after, fractional.size - 1)])
    # about zero the noise is several times its neighbours as well
    least = np.maximum(_TIMES * around, LOST_STEPS * _usual(np.abs(np.diff(column))))
    # and several times the row before or behind it: a log that goes on in whole seconds has lost none
    beside = np.abs(np.pad(column, 1, constant_values=np.inf))
    least = np.maximum(least, _TIMES * np.minimum(beside[whole], beside[whole + 2]))
    far = np.flatnonzero(np.abs(column[whole]) >= least)
    return int(whole[far[0]]) if far.size else None
