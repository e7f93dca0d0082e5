"""Stop or turn of a ramp: nominal corner, duration, overshoot, ringing.

A straight line is laid through the middle of the ramp and another through the phase after it (level, where
that stands).  They meet at the nominal corner; the corner lasts from where the displacement leaves the first
line to where it stays on the second, both within noise and resolution.  What noise hides of a gentle
corner its area tells: a speed that falls evenly by V within the time r leaves the area V r^2 / 24 between the
path and its two lines (derived).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.segment.edges import straight_line
from tissueid.segment.stop import travel_line
from tissueid.trial import Corner, Phase

#: Overshoot beyond this share of the ramp is said.
OVERSHOOT_SAID = 0.002
#: A crosshead that brakes for longer is said [s]: relaxation begins while it does.
SLOW_STOP_S = 0.1
#: ... where it is also longer than this share of the ramp: slow ramps end slowly.
SLOW_SHARE = 0.02
#: Area of an evenly slowing stop, in units of speed times squared time, is one over this.
EVEN_STOP = 24.0
#: Kinds in which the tool stands.
STANDING = ("hold", "rest")
#: What a ramp stops or turns into.  Another move the same way is no stop: a standstill is its own phase.
STOPPED = (*STANDING, "creep", "retract")


def corners_of(
    time_s: FloatArray, depth_mm: FloatArray, phases: tuple[Phase, ...], *, tolerance_mm: float
) -> tuple[Corner, ...]:
    """The corner at the end of each ramp that stops or turns.

    ``time_s``, ``depth_mm`` (n,): displacement growing into the tissue; ``tolerance_mm``: what noise and
    resolution explain, > 0.
    """
    return tuple(
        _corner(time_s, depth_mm, (k, before, after), tolerance_mm)
        for k, (before, after) in enumerate(pairwise(phases))
        if before.kind == "ramp" and after.kind in STOPPED
    )


def _corner(
    time_s: FloatArray, depth_mm: FloatArray, at: tuple[int, Phase, Phase], tolerance_mm: float
) -> Corner:
    number, before, after = at
    low, high = (before.start + before.stop - 1) // 2, after.stop - 1
    slope_1, level_1 = travel_line(time_s, depth_mm, before.start, before.stop - 1)
    slope_2, level_2 = _middle_line(time_s, depth_mm, after, flat=after.kind in STANDING)
    edge = float(time_s[before.stop - 1])
    meet = (level_2 - level_1) / (slope_1 - slope_2) if slope_1 != slope_2 else edge
    if not time_s[low] <= meet <= time_s[high]:
        meet = edge
    index = low + int(np.argmin(np.abs(time_s[low : high + 1] - meet)))
    t, x = time_s[low : high + 1], depth_mm[low : high + 1]
    off_ramp = np.abs(x - level_1 - slope_1 * t) > tolerance_mm
    beyond = x - level_2 - slope_2 * t
    off_next = np.flatnonzero(np.abs(beyond) > tolerance_mm)
    leaves = max(int(np.argmax(off_ramp)) - 1, 0) if off_ramp.any() else index - low
    settles = min(int(off_next[-1]) + 1, t.size - 1) if off_next.size else index - low
    # a phase that is no straight line does not tell where the corner begins or ends: its edge does
    edge_at = before.stop - 1 - low
    leaves = leaves if leaves >= edge_at // 2 else min(index - low, edge_at)
    settles = settles if settles <= edge_at + (high - low - edge_at) // 2 else max(index - low, edge_at)
    overshoot, swings, period = 0.0, 0, None
    if after.kind in STANDING:
        later = t >= meet
        overshoot = float(beyond.max()) if beyond.max() > tolerance_mm else 0.0
        swings, period = _ringing(t[later], beyond[later], tolerance_mm)
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


def _middle_line(
    time_s: FloatArray, depth_mm: FloatArray, phase: Phase, *, flat: bool
) -> tuple[float, float]:
    """Slope and level at t = 0 of the middle half of a phase; of a standing one its late median."""
    count = phase.stop - phase.start
    if flat:
        return 0.0, float(np.median(depth_mm[phase.start + count // 2 : phase.stop]))
    part = slice(phase.start + count // 4, phase.stop - count // 4)
    return straight_line(time_s[part], depth_mm[part], flat=False)


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


def corner_flags(
    depth_mm: FloatArray, phases: tuple[Phase, ...], corners: tuple[Corner, ...], *, tolerance_mm: float
) -> list[Flag]:
    """The first stop that overshoots its hold, and the slowest one."""
    flags: list[Flag] = []
    stops = [corner for corner in corners if phases[corner.phase + 1].kind == "hold"]
    for corner in stops:
        ramp = phases[corner.phase]
        travel = float(depth_mm[ramp.stop - 1] - depth_mm[ramp.start])
        if corner.overshoot_mm > max(OVERSHOOT_SAID * travel, tolerance_mm):
            message = (
                f"displacement overshoots its hold by {corner.overshoot_mm:.3g} mm and settles in "
                f"{corner.duration_s:.3g} s"
            )
            values = {"overshoot_mm": corner.overshoot_mm, "duration_s": corner.duration_s}
            flags.append(Flag("corner_overshoot", message, values))
            break
    slow = max((_braking(phases[corner.phase], corner) for corner in stops), default=(0.0, 0.0, 0.0))
    braking_s, time_s, ramp_s = slow
    if braking_s > max(SLOW_STOP_S, SLOW_SHARE * ramp_s):
        message = f"the crosshead brakes for {braking_s:.3g} s before its stop at {time_s:.4g} s"
        flags.append(Flag("corner_slow", message, {"duration_s": braking_s, "time_s": time_s}))
    return flags


def _braking(ramp: Phase, corner: Corner) -> tuple[float, float, float]:
    """Braking of a ramp, and when and after how long a ramp it stops [s]."""
    rounded = corner.duration_s if corner.ringing_swings < 2 else 0.0
    return max(ramp.braking_s, rounded), ramp.end_s, ramp.end_s - ramp.start_s
