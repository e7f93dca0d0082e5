"""Loading moves: where they begin and stop, the peak of the force, the loading that is fitted, its surface.

The stop is where segmentation begins the hold.  The peak is the largest force from max(0.5 s, braking) before
the stop to 0.1 s after it: crossheads brake, and the force may fall while they do.
"""

from __future__ import annotations

from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.trial import Event, Phase, Segmentation

#: The peak is looked for from so long before the stop, at least, to so long after it [s].
BEFORE_S, AFTER_S = 0.5, 0.1
#: The largest of many samples is high by their noise: above this share of it, means over a few are taken ...
NOISY_SHARE = 0.005
#: ... no longer than this, nor than this share of the ramp.
MEAN_S, MEAN_SHARE = 0.05, 0.02
#: Phases that begin with a stop.
HELD = ("hold", "creep")
#: An approach slower than this share of the ramp stands still.
STANDS = 0.05


class Move(NamedTuple):
    """One loading move as phases: an approach that moves, and the ramps after it."""

    #: Phases: where the motion begins, the first ramp, and the last one.
    moving: int
    first: int
    last: int
    stop: int  # sample of the stop


def usable_until(segmentation: Segmentation, size: int) -> int:
    """One past the last sample that may be fitted at all: the first rupture, or the end of the phases."""
    end = segmentation.phases[-1].stop if segmentation.phases else size
    ruptures = (event.index + 1 for event in segmentation.events if event.kind == "rupture")
    return min([end, *ruptures])


def after_rupture(segmentation: Segmentation, phase: Phase) -> bool:
    """True of a phase that is not over at the first rupture."""
    return phase.stop > usable_until(segmentation, phase.stop)


def move_before(phases: tuple[Phase, ...], number: int) -> Move | None:
    """The loading that ends where a phase begins; ``None`` where another move, or none, comes before it."""
    first = number
    while first > 0 and phases[first - 1].kind == "ramp":
        first -= 1
    if first == number:
        return None
    moving, least = first, STANDS * abs(phases[first].speed_mm_s)
    while moving > 0 and phases[moving - 1].kind == "approach" and abs(phases[moving - 1].speed_mm_s) > least:
        moving -= 1
    stop = phases[number].start if number < len(phases) else phases[number - 1].stop - 1
    return Move(moving, first, number - 1, stop)


def moves(phases: tuple[Phase, ...]) -> list[Move]:
    """Every loading move, in time order; cycles are loops and no moves."""
    kinds = [phase.kind for phase in phases]
    neighbours = enumerate(zip_longest(kinds, kinds[1:]), 1)
    ends = (number for number, (kind, after) in neighbours if kind == "ramp" and after != "ramp")
    found = (move_before(phases, number) for number in ends)
    return [one for one in found if one is not None]


def braking_before(segmentation: Segmentation, move: Move) -> float | None:
    """From the corner of a move to its stop [s]; ``None`` where it has no corner."""
    corner = next((one for one in segmentation.corners if one.phase == move.last), None)
    if corner is None:
        return None
    phases = segmentation.phases
    stop = phases[move.last + 1].start_s if move.last + 1 < len(phases) else phases[move.last].end_s
    return max(stop - corner.time_s, 0.0)


class Peak(NamedTuple):
    """Sample of a peak, and the force there [N]: a mean over a few samples where they are noisy."""

    at: int
    force_N: float


def peak_of(
    time_s: FloatArray,
    force_N: FloatArray,
    segmentation: Segmentation,
    number: int,
    broke: Event | None = None,
) -> Peak:
    """The peak before a phase: its first sample where no loading comes before it; ``broke``: not after it."""
    phases = segmentation.phases
    move = move_before(phases, number)
    if move is None:
        return Peak(phases[number].start, float(force_N[phases[number].start]))
    begin = phases[move.first].start
    if broke is not None:
        whole, took_s = slice(begin, broke.index + 1), broke.time_s - float(time_s[begin])
        force = _smoothed(time_s[: whole.stop], force_N[: whole.stop], whole, segmentation, took_s)
        at, last = int(np.argmax(force)), broke.values["force_before_N"]
        return Peak(broke.index, last) if last > force[at] else Peak(begin + at, float(force[at]))
    stop_s = float(time_s[move.stop])
    held = number < len(phases) and phases[number].kind in HELD
    # without a standstill the tissue may give way long before the end of the move
    before = max(BEFORE_S, braking_before(segmentation, move) or 0.0) if held else np.inf
    low = max(int(np.searchsorted(time_s, stop_s - before)), begin)
    high = max(int(np.searchsorted(time_s, stop_s + AFTER_S, "right")), move.stop + 1)
    if held:
        high = min(high, phases[number].stop)
    ramp_s = stop_s - float(time_s[begin])
    force = _smoothed(time_s, force_N, slice(low, high), segmentation, ramp_s)
    at = int(np.argmax(force))
    return Peak(low + at, float(force[at]))


def _smoothed(
    time_s: FloatArray, force_N: FloatArray, window: slice, segmentation: Segmentation, ramp_s: float
) -> FloatArray:
    """The force of a window, or its means over a few samples where noise would choose the largest."""
    force = force_N[window]
    bias = segmentation.force_noise_N * np.sqrt(2.0 * np.log(max(force.size, 2)))
    if bias <= NOISY_SHARE * float(np.abs(force).max()):
        return force
    time, half_s = time_s[window], 0.5 * min(MEAN_S, MEAN_SHARE * ramp_s)
    left = np.searchsorted(time_s, time - half_s, "left")
    right = np.searchsorted(time_s, time + half_s, "right")
    first = int(left[0])
    total = np.concatenate([[0.0], np.cumsum(force_N[first : int(right[-1])])])
    return np.asarray((total[right - first] - total[left - first]) / (right - left))


#: Measured force, over the peak and in standard deviations of its noise, below which the tool is in air.
AIR_SHARE, AIR_SD = 0.01, 3.0
#: Samples of the running mean that is compared with it; shorter stays in air or contact are noise.
SMOOTHED = 5
#: Depth, over the largest, that a surface is back at.
LEAST_BACK = 1e-3


def first_of_test(segmentation: Segmentation) -> int:
    """The first sample of the test proper; 0 without preconditioning, or where it broke the tissue."""
    if not segmentation.test:
        return 0
    start = segmentation.phases[segmentation.test].start
    return start if usable_until(segmentation, start + 1) > start else 0


def first_turn(segmentation: Segmentation, depth: FloatArray, first: int) -> int:
    """One past the last sample before the tool first turns back, or the tissue breaks."""
    stop = usable_until(segmentation, depth.size)
    begins = first_of_test(segmentation)
    last = first
    for phase in segmentation.phases:
        if phase.stop <= first + 1 or phase.stop <= begins + 1:
            continue
        if phase.kind == "cycle":
            peak = phase.start + int(np.argmax(depth[phase.start : phase.stop]))
            return min(max(last, peak + 1), stop)
        if phase.kind == "retract":
            return min(max(last, phase.start + 1), stop)
        last = phase.stop
    return min(last, stop) if last > first else stop


def mean_speed(time_s: FloatArray, depth_mm: FloatArray) -> float:
    """Mean speed up to the deepest sample [mm/s]."""
    peak = int(np.argmax(depth_mm))
    span = float(time_s[peak] - time_s[0])
    return float((depth_mm[peak] - depth_mm[0]) / span) if span > 0.0 else 0.0


def air_limit(force_N: FloatArray, noise_N: float) -> float:
    """Mean force over :data:`SMOOTHED` samples below which the tool counts as in air [N]."""
    return max(AIR_SHARE * float(force_N.max()), AIR_SD * noise_N / float(np.sqrt(SMOOTHED)))


def measured_surface(
    time_s: FloatArray, tool_mm: FloatArray, *, force_N: FloatArray, turn: int, noise_N: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The first path: in air where the force says so, the surface coming back as an exponential does."""
    # imported here because a command that fits nothing never needs it
    from scipy.ndimage import find_objects, label, median_filter

    mean = np.convolve(force_N, np.ones(SMOOTHED) / SMOOTHED, mode="same")
    air = (mean < air_limit(force_N, noise_N)) & (np.arange(force_N.size) >= turn)
    air = median_filter(air, 2 * SMOOTHED - 1, mode="nearest")
    surface, least = tool_mm.copy(), LEAST_BACK * float(np.abs(tool_mm).max())
    for (run,) in find_objects(label(air)[0]):
        ends = np.array([max(run.start - 1, 0), min(run.stop, tool_mm.size - 1)])
        ends_mm = tool_mm[[ends[0], ends[0] if run.stop == tool_mm.size else ends[1]]]
        ln_mm = np.interp(time_s[run], time_s[ends], np.log(np.maximum(ends_mm, least)))
        surface[run] = np.maximum(np.exp(ln_mm), tool_mm[run])
    return surface, ~air
