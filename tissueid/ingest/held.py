"""Rows in which a channel only repeats its last reading: it is read more slowly than rows are written.

A cell read ten times a second beside a travel written at 500 Hz is late by half a reading on average, and
steps where the tissue does not.  Such a channel changes at even intervals, by whatever it went meanwhile; one
of coarse steps changes by whole steps, at any interval.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray, IntArray
from tissueid.flags import Flag

#: Fewer changes show no rate.
FEWEST_CHANGES = 16
#: Rows that a reading lasts at the least; shorter ones are late by less than the rows are apart.
SHORTEST = 2.0
#: A reading lasts as many rows as the others within less than a row, or this share of them ...
UNEVEN_ROWS, UNEVEN_SHARE = 0.999, 0.1
#: ... or as several of them, where the channel stands; so many must.
EVENLY = 0.9
#: A tool that moves in steps moves the force with it: by so many times what it changed by a row before.
STEPPED = 4.0
#: Steps of a coarse channel are whole multiples of its smallest within this share of it; fewer are chance.
OFF_STEP, FEWEST_OFF = 0.2, 2


def _rows_a_reading(values: FloatArray) -> float:
    """Rows for which a held channel keeps a reading; 0 for any other."""
    changes = np.flatnonzero(np.diff(values) != 0.0) + 1
    if changes.size < FEWEST_CHANGES:
        return 0.0
    lasted = np.diff(changes).astype(np.float64)
    usual = np.abs(lasted - np.median(lasted)) <= 0.5 * np.median(lasted)
    rows = float(lasted[usual].mean()) if usual.any() else 0.0
    if rows < SHORTEST:
        return 0.0
    off = np.abs(lasted - rows * _readings(lasted, rows))
    if float(np.mean(off <= max(UNEVEN_ROWS, UNEVEN_SHARE * rows))) < EVENLY:
        return 0.0
    steps = np.abs(values[changes] - values[changes - 1])
    steps /= np.quantile(steps, 0.1)
    broken = np.abs(steps - np.maximum(np.rint(steps), 1.0)) > OFF_STEP
    return rows if int(np.count_nonzero(broken)) >= FEWEST_OFF else 0.0


def _readings(lasted: FloatArray, rows: float) -> FloatArray:
    """Readings in stretches in which a channel stands for so many rows, one at the least."""
    return np.maximum(np.rint(lasted / rows), 1.0)


def _read_at(values: FloatArray, rows: float) -> IntArray:
    """Rows at which a held channel was read, evenly spaced where several readings agree."""
    starts = np.concatenate(([0], np.flatnonzero(np.diff(values) != 0.0) + 1))
    lasted = np.diff(np.append(starts, values.size)).astype(np.float64)
    if lasted[0] < 0.5 * rows:
        # what the record begins with was read before it
        starts, lasted = starts[1:], lasted[1:]
    count = _readings(lasted, rows).astype(np.intp)
    within = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    return np.repeat(starts, count) + np.floor(within * np.repeat(lasted / count, count)).astype(np.intp)


def _stepped(held: FloatArray, other: FloatArray) -> bool:
    """True where the other channel changes with what looks held: the tool itself moves in steps."""
    changes, changed = np.flatnonzero(np.diff(held[1:]) != 0.0) + 1, np.abs(np.diff(other))
    return float(np.median(changed[changes])) > STEPPED * float(np.median(changed[changes - 1]))


def read_anew(
    time_s: FloatArray, displacement_mm: FloatArray, force_N: FloatArray
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], Flag | None]:
    """Rows of three channels (n,) at which the slower one was read, and ``held_channel`` where it is held."""
    channels = (time_s, displacement_mm, force_N)
    names = {"displacement": displacement_mm, "force": force_N}
    lasts = {name: _rows_a_reading(values) for name, values in names.items()}
    slower = max(lasts, key=lambda name: lasts[name])
    rows = lasts[slower]
    other = min(lasts, key=lambda name: lasts[name])
    if rows == 0.0 or (lasts[other] == 0.0 and _stepped(names[slower], names[other])):
        return channels, None
    at = _read_at(names[slower], rows)
    every_s = float(np.median(np.diff(time_s[at])))
    message = f"the {slower} is read anew each {every_s:.3g} s, {rows:.3g} rows; those between are left out"
    values = {"channel": slower, "rows": rows, "interval_s": every_s, "left_out": int(time_s.size - at.size)}
    return (time_s[at], displacement_mm[at], force_N[at]), Flag("held_channel", message, values)
