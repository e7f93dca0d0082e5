"""End of a move: the sample at which the lines of its two sides meet, or a plateau is reached.

A sharp corner is where two straight lines through its sides meet; they are laid through samples farther off
first, which know nothing of the corner's own shape, then through its neighbours.  A rounded turn keeps the
first meeting; a rounded or ringing stop ends where the plateau is reached for good.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray

#: Samples on each side of a corner that place it.
CORNER_SAMPLES = 200
#: Samples on each side that must lie on the lines of a sharp corner, and what share of them.
NEAR_SAMPLES = 25
SHARP_SHARE = 0.98
#: Lines that differ by this share of what they run through are the same.
ROUNDING = 1e-9
#: Passes that place a corner.
CORNER_PASSES = 16


def corner_near(
    time_s: FloatArray,
    depth_mm: FloatArray,
    at: int,
    within: tuple[int, int],
    *,
    stands: tuple[bool, bool],
    tolerance: float,
) -> int:
    """The corner between two moves or standstills.

    ``time_s``, ``depth_mm`` (n,); ``at``: sample near the corner; ``within``: first and last sample that may
    be looked at; ``stands``: whether the tool stands before and after it; ``tolerance``: what noise and
    resolution explain [mm].  Returns the first sample after the corner; of a rounded stop, the first on the
    plateau.
    """
    low, high = within
    # lines through what lies farther off: they know nothing of the corner's own shape
    far = slice(low, low + (at - low) // 2 + 1), slice(at + (high - at) // 2, high + 1)
    guess = _meeting(time_s, _two_lines(time_s, depth_mm, far, stands), low, high)
    guess = first = at if guess is None else guess
    for _ in range(CORNER_PASSES):  # a corner a few samples off tilts its lines; the next pass has it nearer
        near = (
            slice(max(low, guess - CORNER_SAMPLES), guess + 1),
            slice(guess, min(high, guess + CORNER_SAMPLES) + 1),
        )
        lines = _two_lines(time_s, depth_mm, near, stands)
        moved = _meeting(time_s, lines, low, high)
        if moved is None or abs(moved - first) > CORNER_SAMPLES:
            break
        if abs(moved - guess) <= 1:
            if _sharp(time_s, depth_mm, lines, moved, tolerance):
                return moved
            break
        guess = moved
    if not any(stands):
        return first
    if stands[1]:  # a rounded stop: the hold begins where the plateau is reached for good
        plateau = float(np.median(depth_mm[max(at, first) : high + 1]))
        outside = np.flatnonzero(np.abs(depth_mm[low : high + 1] - plateau) > tolerance)
        return low + int(outside[-1]) + 1 if outside.size and outside[-1] + low < high else at
    plateau = float(np.median(depth_mm[low : min(at, first) + 1]))
    outside = np.flatnonzero(np.abs(depth_mm[low : high + 1] - plateau) > tolerance)
    return max(low, low + int(outside[0]) - 1) if outside.size else at


def _two_lines(
    time_s: FloatArray, depth_mm: FloatArray, sides: tuple[slice, slice], stands: tuple[bool, bool]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Slope and level of the straight lines on both sides of a corner."""
    before, after = (
        straight_line(time_s[side], depth_mm[side], flat=flat)
        for side, flat in zip(sides, stands, strict=True)
    )
    return before, after


def _meeting(
    time_s: FloatArray, lines: tuple[tuple[float, float], tuple[float, float]], low: int, high: int
) -> int | None:
    """The first sample from which two lines have met, within ``(low, high)``; ``None`` where they do not."""
    (slope_1, level_1), (slope_2, level_2) = lines
    ends = time_s[[low, high]]
    one, other = level_1 + slope_1 * ends, level_2 + slope_2 * ends
    # two samples of one straight ramp lie on its line: where they part is rounding
    if float(np.abs(one - other).max()) <= ROUNDING * float(np.abs([one, other]).max()):
        return None
    if slope_1 == slope_2:
        return None
    meet = (level_2 - level_1) / (slope_1 - slope_2)
    if not time_s[low] <= meet <= time_s[high]:
        return None
    reach = 1e-9 * (time_s[high] - time_s[low])
    return int(np.clip(np.searchsorted(time_s, meet - reach), low + 1, high - 1))


def _sharp(
    time_s: FloatArray,
    depth_mm: FloatArray,
    lines: tuple[tuple[float, float], tuple[float, float]],
    at: int,
    tolerance: float,
) -> bool:
    """True where the samples near a corner lie on its two lines."""
    near = slice(max(at - NEAR_SAMPLES, 0), at + NEAR_SAMPLES + 1)
    t, x = time_s[near], depth_mm[near]
    (slope_1, level_1), (slope_2, level_2) = lines
    one, other = level_1 + slope_1 * t, level_2 + slope_2 * t
    # a path that slows down lies below both lines, one that speeds up above both
    fitted = np.minimum(one, other) if slope_1 > slope_2 else np.maximum(one, other)
    off = np.abs(x - fitted)
    return bool(
        np.mean(off <= tolerance) >= SHARP_SHARE and abs(float(np.mean(x - fitted))) <= tolerance / 3.0
    )


def straight_line(time_s: FloatArray, depth_mm: FloatArray, *, flat: bool) -> tuple[float, float]:
    """Slope and level at t = 0 of the straight line through samples; the median level where ``flat``."""
    if flat:
        return 0.0, float(np.median(depth_mm))
    centre = time_s.mean()
    off = time_s - centre
    spread = float(off @ off)
    slope = float(off @ depth_mm) / spread if spread > 0.0 else 0.0
    return slope, float(depth_mm.mean() - slope * centre)


def leaves_line(
    time_s: FloatArray, depth_mm: FloatArray, move: tuple[int, int], end: int, tolerance_mm: float
) -> int:
    """The sample up to which the path follows the straight line through the middle of a move.

    ``time_s``, ``depth_mm`` (n,); ``move``: first and last sample of the move; ``end``: sample towards which,
    from the middle, the path is followed.
    """
    first, last = move
    count = last - first
    middle = slice(first + count // 4, last - count // 4 + 1)
    slope, level = straight_line(time_s[middle], depth_mm[middle], flat=False)
    centre = (first + last) // 2
    way = np.arange(centre, end + 1) if end >= centre else np.arange(centre, end - 1, -1)
    off = np.abs(depth_mm[way] - level - slope * time_s[way]) > tolerance_mm
    return int(way[max(int(np.argmax(off)) - 1, 0)]) if off.any() else end
