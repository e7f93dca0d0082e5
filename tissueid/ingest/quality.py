"""Quality of a recording's numbers at first sight, of its time and its force's range; nothing is removed.

Only what is cheap and certain is said, each with its numbers: time stamps (:mod:`.timestamps`), levels
(:mod:`.levels`), single samples (:mod:`.spikes`), the origin of the displacement (:mod:`.commanded`), the
load cell (:mod:`.cell_range`).

The force against the range in which the load cell was verified.
A load cell is calibrated in a range (ISO 7500-1, ASTM E4), which ends well above zero: below it the force is
a number without a class.  The lower end stands in the calibration certificate, the capacity often in the
header of the export.

Time stamps of a recording: repeated times, event rows, gaps.
Different sampling in ramp and hold is neither a gap nor an event row: an interval counts only against the
intervals on both of its sides.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.ingest.broken_rows import jump
from tissueid.ingest.commanded import commanded_displacement
from tissueid.ingest.header import stated
from tissueid.ingest.levels import below_resolution, force_levels, no_decimals
from tissueid.ingest.spikes import spike

#: An event row stands nearer to its neighbour than this part of the intervals around it.
_EVENT_FRACTION = 0.25
#: Event rows mark segment changes; were they more than this part of all rows they would be the sampling.
_EVENTS_AT_MOST = 0.05
#: A gap is this many times longer than the intervals around it.
_GAP_FACTOR = 10.0
_GAP_NEIGHBOURS = 5
#: Gaps that are more than this part of all intervals are the sampling itself (bursts with pauses).
_GAPS_AT_MOST = 0.02
#: So few long intervals are gaps in any recording.
_GAPS_ALWAYS = 3


def zero_dt(time_s: FloatArray, dt: FloatArray) -> Flag | None:
    """Rows that repeat the time of the row before."""
    at = np.flatnonzero(dt == 0.0)
    if not at.size:
        return None
    first = float(time_s[at[0]])
    return Flag(
        "zero_dt", f"{at.size} rows repeat the time of the row before, first at {first:g} s",
        {"count": int(at.size), "first_s": first},
    )  # fmt: skip


def event_rows(time_s: FloatArray, dt: FloatArray) -> Flag | None:
    """Extra samples close beside their neighbours, as written at segment changes."""
    if dt.size < 4:
        return None
    inner = np.minimum(dt[:-2], dt[2:])
    inner *= _EVENT_FRACTION
    near = np.empty(dt.size, dtype=np.bool_)
    near[0], near[-1] = dt[0] < _EVENT_FRACTION * dt[1], dt[-1] < _EVENT_FRACTION * dt[-2]
    np.less(dt[1:-1], inner, out=near[1:-1])
    at = np.flatnonzero(near)
    at = at[dt[at] > 0.0]
    if not at.size or at.size > max(1.0, _EVENTS_AT_MOST * dt.size):
        return None
    first, least = float(time_s[at[0] + 1]), float(dt[at].min())
    return Flag(
        "event_rows",
        f"{at.size} extra samples stand close beside their neighbours, first at {first:g} s, down to"
        f" {least:.3g} s",
        {"count": int(at.size), "first_s": first, "least_interval_s": least},
    )


def gap(time_s: FloatArray, dt: FloatArray, force_N: FloatArray) -> Flag | None:
    """Stretches without samples, and how far the force went meanwhile."""
    if dt.size < 2 * _GAP_NEIGHBOURS + 1:
        return None
    gaps = [i for i in _long_intervals(dt).tolist() if _is_gap(dt, i)]
    if not gaps or len(gaps) > max(_GAPS_ALWAYS, _GAPS_AT_MOST * dt.size):
        return None
    longest = max(gaps, key=lambda i: dt[i])
    around = dt[max(longest - _GAP_NEIGHBOURS, 0) : longest + _GAP_NEIGHBOURS + 1]
    usual = float(np.median(around))
    change = max((float(force_N[i + 1] - force_N[i]) for i in gaps), key=abs)
    count = "1 gap" if len(gaps) == 1 else f"{len(gaps)} gaps"
    return Flag(
        "gap",
        f"{count}, the longest of {dt[longest]:.3g} s at {time_s[longest]:g} s; force moves"
        f" {abs(change):.3g} N unseen",
        {
            "count": len(gaps),
            "longest_s": float(dt[longest]),
            "at_s": float(time_s[longest]),
            "usual_interval_s": usual,
            "force_change_N": change,
            "missing_s": float(sum(dt[i] for i in gaps)),
        },
    )


def _long_intervals(dt: FloatArray) -> NDArray[np.intp]:
    """Candidates, cheaply: long against the shorter of the two intervals on either side."""
    before = np.minimum(dt[1:-3], dt[:-4])
    after = np.minimum(dt[3:-1], dt[4:])
    inner = dt[2:-2] > _GAP_FACTOR * np.maximum(before, after)
    # near the ends fewer neighbours decide, in the exact test
    ends = np.array([1, dt.size - 2], dtype=np.intp)
    return np.unique(np.concatenate((np.flatnonzero(inner) + 2, ends)))


def _is_gap(dt: FloatArray, i: int) -> bool:
    """Long against both sides, so that the step from fast to slow sampling is none."""
    before, after = dt[max(i - _GAP_NEIGHBOURS, 0) : i], dt[i + 1 : i + 1 + _GAP_NEIGHBOURS]
    return all(
        side.size > 0 and dt[i] > _GAP_FACTOR * float(np.median(side)) > 0.0 for side in (before, after)
    )


#: Share of its capacity from which a load cell is taken as verified where nobody says: certificates reach
#: down to 1/100, some to 1/250 or 1/1000.
UNSTATED_RANGE = 0.01

_CELL = r"(?:load cell|force (?:transducer|sensor|cell)|kraft(?:aufnehmer|sensor|messdose)|capteur de force"
_CELL += r"|cellule de charge|celula de carga|cella di carico|czujnik sily|力传感器|载荷传感器)"
_SIZE = r"(?:capacity|rated capacity|rating|range|full scale|nominal (?:force|load)|maximum (?:force|load)"
_SIZE += r"|nennkraft|nennlast|messbereich|capacite|etendue|capacidad|capacita|zakres|量程|容量)"
_CAPACITY = re.compile(
    rf"(?:{_CELL} )?(?:{_CELL} {_SIZE}|{_SIZE} (?:of |de |du |der |della )?{_CELL})|{_CELL}"
)


def capacity_in(metadata: Mapping[str, str], *, decimal: str | None) -> float | None:
    """Capacity of the load cell [N], where the header states it with a unit.

    ``metadata``: entries of the header; ``decimal``: decimal mark of the file.
    """
    return stated(metadata, _CAPACITY, "force", decimal or ".")


def below_cell_range(
    force_N: FloatArray, capacity_N: float | None, *, verified_from_N: float | None = None
) -> Flag | None:
    """``below_cell_range``, where the largest force is below the verified range.

    ``force_N`` (n,): as recorded; ``capacity_N``: capacity of the load cell [N]; ``verified_from_N``: lower
    end of the verified range [N]; else :data:`UNSTATED_RANGE` of the capacity.
    """
    if verified_from_N is None and capacity_N is None:
        return None
    lowest = UNSTATED_RANGE * (capacity_N or 0.0) if verified_from_N is None else verified_from_N
    # the zero of a load cell is arbitrary: what counts is how far the force goes from where it began
    largest = float(np.abs(force_N - force_N[0]).max())
    if not 0.0 < largest < lowest:
        return None
    source = "as stated" if verified_from_N is not None else f"1 % of the {capacity_N:.4g} N cell"
    values = {"largest_N": largest, "verified_from_N": lowest}
    if capacity_N is not None:
        values["capacity_N"] = capacity_N
    return Flag(
        "below_cell_range",
        f"force changes by {largest:.3g} N, below the verified {lowest:.3g} N ({source})",
        values,
    )


def quality_flags(
    time_s: FloatArray, displacement_mm: FloatArray, force_N: FloatArray, *, capacity_N: float | None = None
) -> tuple[Flag, ...]:
    """Flags of the samples, in the order in which they are best read.

    ``zero_dt``, ``event_rows``, ``gap``, ``quantised_force``, ``clipped_force``, ``below_resolution``,
    ``jump``, ``spike``, ``no_decimals``, ``commanded_displacement``, ``below_cell_range``.

    ``time_s``, ``displacement_mm``, ``force_N`` (n,): as recorded; ``capacity_N``: capacity of the load cell,
    where it is known [N].
    """
    dt = np.diff(time_s)
    found = (
        zero_dt(time_s, dt),
        event_rows(time_s, dt),
        gap(time_s, dt, force_N),
        jump(time_s, displacement_mm),
        force_levels(displacement_mm, force_N),
        below_resolution(displacement_mm, force_N),
        spike(time_s, displacement_mm, force_N),
        no_decimals(time_s, displacement_mm, force_N),
        commanded_displacement(time_s, displacement_mm, force_N),
        below_cell_range(force_N, capacity_N),
    )
    return tuple(flag for flag in found if flag is not None)
