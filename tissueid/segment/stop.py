"""Stop of a move: its speed, braking, nominal corner, overshoot and ringing."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.digits import clock_start
from tissueid.flags import Flag
from tissueid.segment.motion import Line, Path, Piece, quickens, straight_line
from tissueid.trial import Corner, Event, Phase

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


def travel_line(time_s: FloatArray, depth_mm: FloatArray, start: int, stop: int) -> Line:
    """Speed, and level at t = 0, of the straight line through 20 to 80 % of the travel of a move."""
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


def placed_stops(path: Path, found: list[Piece]) -> list[Piece]:
    """Pieces whose moves end, and standstills begin, at the stop."""
    result = list(found)
    for k in range(1, len(result)):
        before, after = result[k - 1], result[k]
        if before.direction == 0 or after.direction != 0:
            continue
        at = _stop(path, before, after)
        if at is not None and before.start < at < after.stop:
            result[k - 1] = Piece(before.direction, before.start, at)
            result[k] = Piece(0, at, after.stop)
    return result


def _stop(path: Path, before: Piece, after: Piece) -> int | None:
    """The first sample at the level that a move ends at, ``None`` where noise hides it."""
    time_s, travel_mm, noise_mm = path.time_s, before.direction * path.depth_mm, path.noise_mm
    speed, level_0 = travel_line(time_s, travel_mm, quickens(path, before), before.stop)
    plateau = float(np.median(travel_mm[after.start : after.stop + 1]))
    began = float(travel_mm[before.start])
    share = STOP_SHARE * (plateau - began)
    step_s = float(np.median(np.diff(time_s[before.start : before.stop + 1])))
    if speed <= 0.0 or noise_mm > max(share, BLIND_SAMPLES * speed * step_s):
        return None
    left = max(share, noise_mm)
    corner_s = (plateau - level_0) / speed
    # half of the travel: half of the time lies behind the stop of a move that settles for longer than it took
    low = before.start + int(np.argmax(travel_mm[before.start : before.stop + 1] >= 0.5 * (began + plateau)))
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


def with_braking(path: Path, phases: tuple[Phase, ...]) -> tuple[Phase, ...]:
    """Phases whose ramps know for how long they brake before they stop."""
    time, depth = path.time_s, path.depth_mm
    result = list(phases)
    for k, (ramp, after) in enumerate(pairwise(phases)):
        if ramp.kind != "ramp" or after.kind not in ("hold", "rest"):
            continue
        last = ramp.stop - 1
        slope, level = travel_line(time, depth, ramp.start, last)
        off = np.abs(depth[ramp.start : last + 1] - level - slope * time[ramp.start : last + 1])
        within = max(STOP_SHARE * float(depth[last] - depth[ramp.start]), path.noise_mm)
        leaves = ramp.start + int(np.flatnonzero(off <= within)[-1]) if (off <= within).any() else last
        result[k] = replace(ramp, braking_s=ramp.end_s - float(time[leaves]))
    return tuple(result)


def settlings(path: Path, phases: tuple[Phase, ...]) -> list[Event]:
    """Travel of holds after their stop, as events of kind ``settling``."""
    events = []
    for ramp, hold in pairwise(phases):
        if ramp.kind != "ramp" or hold.kind != "hold":
            continue
        late = max(hold.start, hold.stop - max(1, int(LATE_SHARE * (hold.stop - hold.start))))
        rest = float(np.median(path.depth_mm[late : hold.stop])) - float(path.depth_mm[hold.start])
        step = float(path.depth_mm[hold.start] - path.depth_mm[ramp.start])
        if abs(rest) > max(SETTLING_SHARE * step, path.noise_mm):
            events.append(Event("settling", hold.start, hold.start_s, {"settles_mm": rest}))
    return events


def speed_flags(phases: tuple[Phase, ...], stated_mm_s: float | None) -> list[Flag]:
    """``speed_differs`` where no ramp runs at the speed that the file states."""
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


#: Overshoot beyond this share of the ramp is said.
OVERSHOOT_SAID = 0.002
#: A crosshead that brakes for longer is said [s]: relaxation begins while it does.
SLOW_STOP_S = 0.1
#: ... where it is also longer than this share of the ramp: slow ramps end slowly ...
SLOW_SHARE = 0.02
#: ... and than so many sampling intervals: every stop falls between two samples.
SLOW_STEPS = 1.5
#: Area of an evenly slowing stop, in units of speed times squared time, is one over this.
EVEN_STOP = 24.0
#: Kinds in which the tool stands.
STANDING = ("hold", "rest")
#: What a ramp stops or turns into.  Another move the same way is no stop: a standstill is its own phase.
STOPPED = (*STANDING, "creep", "retract")


def corners_of(path: Path, phases: tuple[Phase, ...]) -> tuple[Corner, ...]:
    """The corner at the end of each ramp that stops or turns."""
    return tuple(
        _corner(path, k, before, after)
        for k, (before, after) in enumerate(pairwise(phases))
        if before.kind == "ramp" and after.kind in STOPPED
    )


def _corner(path: Path, number: int, before: Phase, after: Phase) -> Corner:
    low, high = (before.start + before.stop - 1) // 2, after.stop - 1
    if after.kind in STANDING and after.stop < path.time_s.size:
        high -= 1  # the sample shared with the next move, in which that move may have begun
    slope_1, level_1 = travel_line(path.time_s, path.depth_mm, before.start, before.stop - 1)
    slope_2, level_2 = _middle_line(path, after, flat=after.kind in STANDING)
    edge = float(path.time_s[before.stop - 1])
    meet = (level_2 - level_1) / (slope_1 - slope_2) if slope_1 != slope_2 else edge
    if not path.time_s[low] <= meet <= path.time_s[high]:
        meet = edge
    index = low + int(np.argmin(np.abs(path.time_s[low : high + 1] - meet)))
    t, x = path.time_s[low : high + 1], path.depth_mm[low : high + 1]
    off_ramp = np.abs(x - level_1 - slope_1 * t) > path.tolerance_mm
    beyond = x - level_2 - slope_2 * t
    off_next = np.flatnonzero(np.abs(beyond) > path.tolerance_mm)
    leaves = max(int(np.argmax(off_ramp)) - 1, 0) if off_ramp.any() else index - low
    settles = min(int(off_next[-1]) + 1, t.size - 1) if off_next.size else index - low
    # a phase that is no straight line does not tell where the corner begins or ends: its edge does
    edge_at = before.stop - 1 - low
    leaves = leaves if leaves >= edge_at // 2 else min(index - low, edge_at)
    settles = settles if settles <= edge_at + (high - low - edge_at) // 2 else max(index - low, edge_at)
    overshoot, swings, period = 0.0, 0, None
    if after.kind in STANDING:
        later = t >= meet
        # a crosshead that creeps on in its hold ends beyond the level, and overshot nothing
        early = t <= 0.5 * (after.start_s + after.end_s)
        most, end = float(beyond[early].max()), float(beyond[~early].max(initial=0.0))
        overshoot = most if most > max(end, path.tolerance_mm) else 0.0
        swings, period = _ringing(t[later], beyond[later], path.tolerance_mm)
    duration = max(float(t[settles] - t[leaves]), 0.0)
    if swings < 2:
        lines = level_1 + slope_1 * t, level_2 + slope_2 * t
        even = _even_stop_s(t, x, lines, abs(slope_1 - slope_2), (leaves, settles))
        # longer than the move or what follows it: these are no straight lines, their area tells nothing
        if even <= min(before.end_s - before.start_s, after.end_s - after.start_s):
            duration = max(duration, even)
    if duration < float(np.median(np.diff(t))):  # nothing is seen between two samples
        duration = 0.0
    return Corner(number, index, float(meet), duration, overshoot, swings, period)


def _even_stop_s(
    time_s: FloatArray,
    depth_mm: FloatArray,
    lines: tuple[FloatArray, FloatArray],
    change_mm_s: float,
    span: tuple[int, int],
) -> float:
    """Time of an evenly slowing crosshead that leaves the same area between its path and the two lines."""
    first, last = span
    half = max(last - first, 2)
    near = slice(max(first - half, 0), last + half + 1)
    sharp = np.minimum(*lines) if lines[0][-1] > lines[1][-1] else np.maximum(*lines)
    area = abs(float(np.trapezoid((sharp - depth_mm)[near], time_s[near])))
    return float(np.sqrt(EVEN_STOP * area / change_mm_s)) if change_mm_s > 0.0 else 0.0


def _middle_line(path: Path, phase: Phase, *, flat: bool) -> Line:
    """Slope and level at t = 0 of the middle half of a phase; of a standing one its late median."""
    half, quarter = (phase.stop - phase.start) // 2, (phase.stop - phase.start) // 4
    part = (
        slice(phase.start + half, phase.stop) if flat else slice(phase.start + quarter, phase.stop - quarter)
    )
    return straight_line(path.time_s[part], path.depth_mm[part], flat=flat)


def _ringing(time_s: FloatArray, beyond: FloatArray, tolerance_mm: float) -> tuple[int, float | None]:
    """Excursions to alternate sides, and twice their mean spacing."""
    outside = np.flatnonzero(np.abs(beyond) > tolerance_mm)
    if outside.size == 0:
        return 0, None
    side = np.sign(beyond[outside])
    turns = np.flatnonzero(np.diff(side) != 0.0) + 1
    extremes = [float(time_s[run[int(np.argmax(np.abs(beyond[run])))]]) for run in np.split(outside, turns)]
    if len(extremes) < 2:
        return len(extremes), None
    return len(extremes), 2.0 * (extremes[-1] - extremes[0]) / (len(extremes) - 1)


def corner_flags(path: Path, phases: tuple[Phase, ...], corners: tuple[Corner, ...]) -> list[Flag]:
    """The first stop that overshoots its hold, and the slowest one."""
    flags: list[Flag] = []
    stops = [corner for corner in corners if phases[corner.phase + 1].kind == "hold"]
    for corner in stops:
        ramp = phases[corner.phase]
        travel = float(path.depth_mm[ramp.stop - 1] - path.depth_mm[ramp.start])
        if corner.overshoot_mm > max(OVERSHOOT_SAID * travel, path.tolerance_mm):
            message = (
                f"displacement overshoots its hold by {corner.overshoot_mm:.3g} mm and settles in "
                f"{corner.duration_s:.3g} s"
            )
            values = {"overshoot_mm": corner.overshoot_mm, "duration_s": corner.duration_s}
            flags.append(Flag("corner_overshoot", message, values))
            break
    slow = max((_braking(phases[corner.phase], corner) for corner in stops), default=(0.0, 0.0, 0.0))
    braking_s, time_s, ramp_s = slow
    step_s = float(np.median(np.diff(path.time_s)))
    if braking_s > max(SLOW_STOP_S, SLOW_SHARE * ramp_s, SLOW_STEPS * step_s):
        shown_s = time_s - clock_start(path.time_s[0])
        message = f"the crosshead takes {braking_s:.3g} s to come to its stop at {shown_s:.4g} s"
        flags.append(Flag("corner_slow", message, {"duration_s": braking_s, "time_s": time_s}))
    return flags


def _braking(ramp: Phase, corner: Corner) -> tuple[float, float, float]:
    """Braking of a ramp, and when and after how long a ramp it stops [s]."""
    rounded = corner.duration_s if corner.ringing_swings < 2 else 0.0
    return max(ramp.braking_s, rounded), ramp.end_s, ramp.end_s - ramp.start_s
