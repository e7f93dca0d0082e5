"""What the numbers of a recording show at first sight: time stamps, levels, clipping.

Only what is cheap and certain is said, each with its numbers; nothing is removed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.flags import Flag
from tissueid.trial import FloatArray

__all__ = ["quality_flags"]

#: An event row stands nearer to its neighbour than this part of the intervals around it.
_EVENT_FRACTION = 0.25
#: Event rows mark segment changes; were they more than this part of all rows they would be the sampling.
_EVENTS_AT_MOST = 0.05
#: A gap is this many times longer than the intervals around it.
_GAP_FACTOR = 10.0
_GAP_NEIGHBOURS = 5
_GAPS_AT_MOST = 0.01
_INTERVALS_SAMPLED = 10_000
_FEW_LEVELS = 64
_SAMPLES_PER_LEVEL = 10
_REPEATED_SHARE = 0.8
_CLIPPED_RUN = 5
#: Rows from which whole numbers alone are worth a remark.
_WHOLE_FROM = 20


def quality_flags(time_s: FloatArray, displacement_mm: FloatArray, force_N: FloatArray) -> tuple[Flag, ...]:
    """Flags ``zero_dt``, ``event_rows``, ``gap``, ``quantised_force``, ``clipped_force``, ``no_decimals``.

    Parameters
    ----------
    time_s, displacement_mm, force_N : ndarray, shape (n,)
        As recorded.
    """
    dt = np.diff(time_s)
    found = (
        _zero_dt(time_s, dt),
        _event_rows(time_s, dt),
        _gap(time_s, dt),
        *_force_levels(displacement_mm, force_N),
        _no_decimals(time_s, displacement_mm, force_N),
    )
    return tuple(flag for flag in found if flag is not None)


def _no_decimals(*channels: FloatArray) -> Flag | None:
    if channels[0].size < _WHOLE_FROM or any((values[:_WHOLE_FROM] % 1.0).any() for values in channels):
        return None
    if any((values % 1.0).any() for values in channels):
        return None
    return Flag(
        "no_decimals",
        "time, displacement and force are whole numbers in every row: if decimal marks were lost on the way,"
        " every number here is wrong",
        {"count": int(channels[0].size)},
    )


def _zero_dt(time_s: FloatArray, dt: FloatArray) -> Flag | None:
    at = np.flatnonzero(dt == 0.0)
    if not at.size:
        return None
    first = float(time_s[at[0]])
    return Flag(
        "zero_dt", f"{at.size} rows repeat the time of the row before, first at {first:g} s",
        {"count": int(at.size), "first_s": first},
    )  # fmt: skip


def _event_rows(time_s: FloatArray, dt: FloatArray) -> Flag | None:
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


def _gap(time_s: FloatArray, dt: FloatArray) -> Flag | None:
    if dt.size < 2 * _GAP_NEIGHBOURS + 1:
        return None
    # a sample of the intervals says what is usual; the candidates are judged by their neighbours
    usual = float(np.median(dt[:: max(1, dt.size // _INTERVALS_SAMPLED)]))
    at = np.flatnonzero(dt > _GAP_FACTOR * usual) if usual > 0 else np.empty(0, dtype=np.intp)
    # many long intervals are another sampling rate, not gaps
    if not at.size or at.size > max(3.0, _GAPS_AT_MOST * dt.size):
        return None
    gaps = [i for i in at.tolist() if _is_gap(dt, i)]
    if not gaps:
        return None
    longest = max(gaps, key=lambda i: dt[i])
    return Flag(
        "gap",
        f"{len(gaps)} gaps in the log, the longest of {dt[longest]:.3g} s at {time_s[longest]:g} s"
        f" where samples are {usual:.3g} s apart",
        {"count": len(gaps), "longest_s": float(dt[longest]), "at_s": float(time_s[longest])},
    )


def _is_gap(dt: FloatArray, i: int) -> bool:
    """Long against both sides, so that the step from fast to slow sampling is none."""
    before, after = dt[max(i - _GAP_NEIGHBOURS, 0) : i], dt[i + 1 : i + 1 + _GAP_NEIGHBOURS]
    return all(side.size > 0 and dt[i] > _GAP_FACTOR * float(np.median(side)) for side in (before, after))


def _force_levels(displacement_mm: FloatArray, force_N: FloatArray) -> tuple[Flag | None, Flag | None]:
    repeats: NDArray[np.bool_] = np.diff(force_N) == 0.0
    share = float(np.mean(repeats))
    if share >= _REPEATED_SHARE:
        levels = np.unique(force_N)
        if 1 < levels.size <= _FEW_LEVELS and force_N.size >= _SAMPLES_PER_LEVEL * levels.size:
            step = float(np.diff(levels).min())
            message = (
                f"the force has {levels.size} levels, {step:.3g} N apart at least, and {share:.0%} of its"
                f" samples"
                " repeat the one before"
            )
            values = {"levels": int(levels.size), "repeated_fraction": share, "step_N": step}
            return Flag("quantised_force", message, values), None
    return None, _clipped(displacement_mm, force_N, repeats)


def _clipped(displacement_mm: FloatArray, force_N: FloatArray, repeats: NDArray[np.bool_]) -> Flag | None:
    """The force stands at its largest value to the last digit while the tool moves on."""
    peak = float(max(force_N.max(), -force_N.min()))
    if peak == 0.0 or not repeats.any():
        return None
    at_peak = np.flatnonzero(np.abs(force_N) == peak)
    if at_peak.size < _CLIPPED_RUN:
        return None
    breaks = np.flatnonzero(np.diff(at_peak) != 1)
    starts = np.concatenate(([0], breaks + 1))
    stops = np.concatenate((breaks, [at_peak.size - 1]))
    for start, stop in zip(at_peak[starts].tolist(), at_peak[stops].tolist(), strict=True):
        travel = displacement_mm[start : stop + 1]
        moved = np.count_nonzero(np.diff(travel)) >= _CLIPPED_RUN - 1
        if stop - start + 1 >= _CLIPPED_RUN and moved:
            return Flag(
                "clipped_force",
                f"the force stands at {force_N[start]:g} N for {stop - start + 1} samples while the tool"
                f" moves",
                {"force_N": float(force_N[start]), "samples": int(stop - start + 1)},
            )
    return None
