"""Stop and speed of a move: stop, braking and speed of a crosshead.

The straight line through 20 to 80 % of the travel gives the speed; where it meets the level of the standstill
lies the nominal corner.  A crosshead brakes for 0.1 to 0.4 s after it and may settle by micrometres for much
longer: the stop is the first sample whose travel lies within 0.1 % of the step, or within noise, of the level
reached once as much time again as has passed since the corner brings no more than that.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.segment.edges import straight_line
from tissueid.segment.motion import Piece, path_noise
from tissueid.trial import Event, Phase

#: Shares of the travel between which the line of a move is laid.
FROM_SHARE, TO_SHARE = 0.2, 0.8
#: Travel left at the stop, as a share of the step.
STOP_SHARE = 1e-3
#: Noise that the line passes through within this part of a sample doesn't hide a stop.
BLIND_SAMPLES = 0.5
#: Fewest samples, and times that the line takes for what is left, over which a level must stand.
LEVEL_SAMPLES = 3
LEVEL_TIMES = 5.0
#: Travel after the stop that is said, as a share of the step.
SETTLING_SHARE = 5e-4
#: Share of a hold whose end tells what it settles to.
LATE_SHARE = 0.1
#: Difference from the stated speed that is said, as a share of it.
SPEED_SHARE = 0.05
#: Fewest samples within the shares that lay a line.
FEWEST_ON_LINE = 3


def travel_line(time_s: FloatArray, depth_mm: FloatArray, start: int, stop: int) -> tuple[float, float]:
    """Straight line through 20 to 80 % of the travel of a move.

    ``time_s``, ``depth_mm`` (n,); ``start``, ``stop``: first and last sample of the move.  Returns
    ``slope_mm_s, level_mm``: speed, and displacement of the line at t = 0.
    """
    t, x = time_s[start : stop + 1], depth_mm[start : stop + 1]
    share = (x - x[0]) / (x[-1] - x[0]) if x[-1] != x[0] else np.zeros(x.size)
    inside = np.flatnonzero((share >= FROM_SHARE) & (share <= TO_SHARE))
    if inside.size >= FEWEST_ON_LINE:
        first, last = int(inside[0]), int(inside[-1]) + 1
        if t[last - 1] > t[first]:
            return straight_line(t[first:last], x[first:last], flat=False)
    # fewer samples: the two between which the middle of the travel lies
    after = int(np.argmax(share >= 0.5)) or 1
    first, last = max(after - 1, 0), min(after + 1, t.size)
    if t[last - 1] <= t[first]:
        first, last = 0, t.size
    return straight_line(t[first:last], x[first:last], flat=False)


def placed_stops(time_s: FloatArray, depth_mm: FloatArray, found: list[Piece]) -> list[Piece]:
    """Pieces whose moves end, and standstills begin, at the stop.

    ``time_s``, ``depth_mm`` (n,); ``found``: settled moves and standstills that cover the recording.
    """
    noise = path_noise(time_s, depth_mm)
    result = list(found)
    for k in range(1, len(result)):
        before, after = result[k - 1], result[k]
        if before.direction == 0 or after.direction != 0:
            continue
        at = _stop(time_s, before.direction * depth_mm, (before, after), noise)
        if at is not None and before.start < at < after.stop:
            result[k - 1] = Piece(before.direction, before.start, at)
            result[k] = Piece(0, at, after.stop)
    return result


def _stop(
    time_s: FloatArray, travel_mm: FloatArray, around: tuple[Piece, Piece], noise_mm: float
) -> int | None:
    """The first sample at the level that a move ends at, ``None`` where noise hides it."""
    before, after = around
    speed, level_0 = travel_line(time_s, travel_mm, before.start, before.stop)
    plateau = float(np.median(travel_mm[after.start : after.stop + 1]))
    share = STOP_SHARE * (plateau - float(travel_mm[before.start]))
    step_s = float(np.median(np.diff(time_s[before.start : before.stop + 1])))
    if speed <= 0.0 or noise_mm > max(share, BLIND_SAMPLES * speed * step_s):
        return None
    left = max(share, noise_mm)
    corner_s = (plateau - level_0) / speed
    low = (before.start + before.stop) // 2
    first = max(int(np.searchsorted(time_s, corner_s)) - 1, low)
    last = after.start + (after.stop - after.start) // 2
    for k in range(first, last):
        span = max(float(time_s[k]) - corner_s, LEVEL_TIMES * left / speed)
        end = max(int(np.searchsorted(time_s, time_s[k] + span)), k + LEVEL_SAMPLES)
        if end > after.stop:
            break
        if abs(float(np.median(travel_mm[k : end + 1])) - float(travel_mm[k])) <= left:
            level = float(np.median(travel_mm[k : end + 1]))
            reached = np.flatnonzero(travel_mm[low : k + 1] >= level - left)
            at = low + int(reached[0]) if reached.size else k
            # a move that has not braked by then goes on to its level
            braked = level_0 + speed * float(time_s[at]) - float(travel_mm[at]) > 0.5 * left
            meets = at + int(np.argmin(np.abs(time_s[at : after.stop] - (level - level_0) / speed)))
            return at if braked else meets
    return None


def with_braking(time_s: FloatArray, depth_mm: FloatArray, phases: tuple[Phase, ...]) -> tuple[Phase, ...]:
    """Phases whose ramps know for how long they brake before they stop.

    ``time_s``, ``depth_mm`` (n,).
    """
    noise = path_noise(time_s, depth_mm)
    result = list(phases)
    for k, (ramp, after) in enumerate(pairwise(phases)):
        if ramp.kind != "ramp" or after.kind not in ("hold", "rest"):
            continue
        last = ramp.stop - 1
        slope, level = travel_line(time_s, depth_mm, ramp.start, last)
        off = np.abs(depth_mm[ramp.start : last + 1] - level - slope * time_s[ramp.start : last + 1])
        within = max(STOP_SHARE * float(depth_mm[last] - depth_mm[ramp.start]), noise)
        leaves = ramp.start + int(np.flatnonzero(off <= within)[-1]) if (off <= within).any() else last
        result[k] = replace(ramp, braking_s=ramp.end_s - float(time_s[leaves]))
    return tuple(result)


def settlings(time_s: FloatArray, depth_mm: FloatArray, phases: tuple[Phase, ...]) -> list[Event]:
    """Travel of holds after their stop, as events of kind ``settling``.

    ``time_s``, ``depth_mm`` (n,).
    """
    noise = path_noise(time_s, depth_mm)
    events = []
    for ramp, hold in pairwise(phases):
        if ramp.kind != "ramp" or hold.kind != "hold":
            continue
        late = max(hold.start, hold.stop - max(1, int(LATE_SHARE * (hold.stop - hold.start))))
        rest = float(np.median(depth_mm[late : hold.stop])) - float(depth_mm[hold.start])
        step = float(depth_mm[hold.start] - depth_mm[ramp.start])
        if abs(rest) > max(SETTLING_SHARE * step, noise):
            events.append(Event("settling", hold.start, hold.start_s, {"settles_mm": rest}))
    return events


def speed_flags(phases: tuple[Phase, ...], stated_mm_s: float | None) -> list[Flag]:
    """``speed_differs`` where no ramp runs at the speed that the file states.

    ``stated_mm_s``: of the file's header.
    """
    speeds = [phase.speed_mm_s for phase in phases if phase.kind == "ramp"]
    if not stated_mm_s or not speeds:
        return []
    nearest = min(speeds, key=lambda speed: abs(speed - abs(stated_mm_s)))
    off = nearest / abs(stated_mm_s) - 1.0
    if abs(off) <= SPEED_SHARE:
        return []
    message = (
        f"the ramp runs at {nearest:.4g} mm/s, {100 * off:+.0f} % off the {abs(stated_mm_s):.4g} mm/s stated"
    )
    return [Flag("speed_differs", message, {"speed_mm_s": nearest, "stated_mm_s": abs(stated_mm_s)})]
