"""What the crosshead did, from measured displacement: moves in, moves out, standstills.

The displacement is reduced to a polyline within its noise (:mod:`tissueid.segment.polyline`); pieces become
moves and standstills; what is too short or too small to be either (rounded stops, overshoot, event rows)
belongs to the move before it.  A standstill is where the displacement is constant: drifting by more than
:data:`HOLD_DRIFT` of the move before is slow motion (creep under load control), not a hold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.segment.noise import quantum, white_noise_sd
from tissueid.segment.polyline import corners

__all__ = ["Corner", "Piece", "displacement_tolerance", "pieces"]

FloatArray = NDArray[np.float64]

#: Samples of white noise stay within this many standard deviations (1e5 samples: 4.4 expected).
NOISE_REACH = 5.5
#: Resolution of the polyline as a share of the whole excursion: finer motion is not a phase.
POLYLINE_RESOLUTION = 5e-4
#: A move covers at least this share of the whole excursion.
MOVE_SHARE = 0.02
#: A standstill drifts by at most this share of the move before it.
HOLD_DRIFT = 0.01
#: A standstill is slower than this share of the move before it.
STAND_SPEED = 0.03
#: Two moves in one direction are told apart where their speeds differ by this factor.
SPEED_RATIO = 2.0
#: Fewer samples than this at another speed are a start or a stop, not a move of their own.
MOVE_SAMPLES = 5
#: Samples on each side of a corner that place it.
CORNER_SAMPLES = 200
#: Passes that place a corner.
CORNER_PASSES = 6


@dataclass(frozen=True, slots=True)
class Piece:
    """One move (``direction`` +1 in, -1 out) or standstill (0) over samples ``[start, stop]``."""

    direction: int
    start: int
    stop: int


@dataclass(frozen=True, slots=True)
class Corner:
    """How a ramp came to its stop: time it took [s] and overshoot beyond the plateau [mm]."""

    duration_s: float
    overshoot_mm: float


def displacement_tolerance(time_s: FloatArray, depth_mm: FloatArray) -> float:
    """Largest distance from a straight line that noise and resolution explain [mm]."""
    noise = NOISE_REACH * white_noise_sd(time_s, depth_mm)
    return max(noise, 1.01 * quantum(depth_mm), POLYLINE_RESOLUTION * float(np.ptp(depth_mm)))


def pieces(time_s: FloatArray, depth_mm: FloatArray) -> list[Piece]:
    """Divide a recording into moves and standstills.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Non-decreasing.
    depth_mm : ndarray, shape (n,)
        Displacement, growing into the tissue.

    Returns
    -------
    list of Piece
        Neighbours share their corner sample; together they cover the recording.
    """
    tolerance = displacement_tolerance(time_s, depth_mm)
    if tolerance == 0.0:
        return [Piece(0, 0, depth_mm.size - 1)]
    knots = corners(time_s, depth_mm, tolerance=tolerance)
    found = _absorb(_classify(time_s, depth_mm, knots, tolerance=tolerance))
    found = _demote_drifting(depth_mm, found, tolerance=tolerance)
    return _place_corners(time_s, depth_mm, found, tolerance=tolerance)


def _classify(
    time_s: FloatArray, depth_mm: FloatArray, knots: NDArray[np.intp], *, tolerance: float
) -> list[tuple[Piece, float, bool]]:
    """Each stretch of the polyline with its speed, and whether it is large enough to stand for itself."""
    rise = np.diff(depth_mm[knots])
    span = np.diff(time_s[knots])
    speed = np.divide(rise, span, out=np.zeros(span.size), where=span > 0.0)
    large = np.abs(rise) >= max(MOVE_SHARE * float(np.ptp(depth_mm)), 2.0 * tolerance)
    # reference for "slow": the last large move before, else the first one
    order = np.where(large, np.arange(rise.size), -1)
    last = np.maximum.accumulate(order)
    first = int(np.argmax(large)) if large.any() else 0
    reference = np.abs(speed[np.where(last >= 0, last, first)])
    stands = (
        ~large
        & (np.abs(speed) <= STAND_SPEED * reference)
        & (np.abs(rise) <= 2.0 * tolerance + MOVE_SHARE * np.ptp(depth_mm))
    )
    direction = np.where(stands, 0, np.sign(rise)).astype(int)
    return [
        (
            Piece(int(direction[k]), int(knots[k]), int(knots[k + 1])),
            float(speed[k]),
            bool(large[k] or stands[k]),
        )
        for k in range(rise.size)
    ]


def _absorb(stretches: list[tuple[Piece, float, bool]]) -> list[Piece]:
    """Join neighbours that do the same, and give transients to the piece before them."""
    joined: list[tuple[Piece, float]] = []
    waiting: int | None = None
    for piece, speed, stands_alone in stretches:
        if not stands_alone:
            if joined:
                before, before_speed = joined[-1]
                joined[-1] = (replace(before, stop=piece.stop), before_speed)
            elif waiting is None:
                waiting = piece.start
            continue
        start = piece.start if waiting is None else waiting
        waiting = None
        if joined and _same(joined[-1], (replace(piece, start=start), speed)):
            before, before_speed = joined[-1]
            longer = max(
                (before, before_speed), (piece, speed), key=lambda entry: entry[0].stop - entry[0].start
            )
            joined[-1] = (replace(before, stop=piece.stop), longer[1])
        else:
            joined.append((Piece(piece.direction, start, piece.stop), speed))
    if not joined:
        return [Piece(0, stretches[0][0].start, stretches[-1][0].stop)]
    return [piece for piece, _ in joined]


def _same(before: tuple[Piece, float], after: tuple[Piece, float]) -> bool:
    """Whether two neighbouring stretches are one phase."""
    if before[0].direction != after[0].direction:
        return False
    slow, fast = sorted((abs(before[1]), abs(after[1])))
    few = min(piece.stop - piece.start for piece, _ in (before, after)) < MOVE_SAMPLES
    return before[0].direction == 0 or few or fast <= SPEED_RATIO * slow


def _demote_drifting(depth_mm: FloatArray, found: list[Piece], *, tolerance: float) -> list[Piece]:
    """Standstills that drift against the move before them become slow moves."""
    result: list[Piece] = []
    for k, piece in enumerate(found):
        if piece.direction == 0 and k > 0:
            before = found[k - 1]
            travel = abs(depth_mm[before.stop] - depth_mm[before.start])
            quarter = max(1, (piece.stop - piece.start) // 4)
            drift = float(
                np.median(depth_mm[piece.stop - quarter : piece.stop + 1])
                - np.median(depth_mm[piece.start : piece.start + quarter + 1])
            )
            if abs(drift) > max(HOLD_DRIFT * travel, tolerance):
                result.append(replace(piece, direction=int(np.sign(drift))))
                continue
        result.append(piece)
    return result


def _place_corners(
    time_s: FloatArray, depth_mm: FloatArray, found: list[Piece], *, tolerance: float
) -> list[Piece]:
    """Move each corner to where the lines of its two sides meet, or to where the standstill begins."""
    edges = [piece.start for piece in found] + [found[-1].stop]
    for k in range(1, len(found)):
        before, after = found[k - 1], found[k]
        low, high = (before.start + edges[k]) // 2, (edges[k] + after.stop) // 2
        low, high = max(low, edges[k - 1] + 1), min(high, after.stop - 1)
        if high - low < 4:
            continue
        edges[k] = _corner(
            time_s,
            depth_mm,
            edges[k],
            low,
            high,
            stands=(before.direction == 0, after.direction == 0),
            tolerance=tolerance,
        )
    return [replace(piece, start=edges[k], stop=edges[k + 1]) for k, piece in enumerate(found)]


def _corner(
    time_s: FloatArray,
    depth_mm: FloatArray,
    at: int,
    low: int,
    high: int,
    *,
    stands: tuple[bool, bool],
    tolerance: float,
) -> int:
    """The corner sample near ``at``, within ``[low, high]``."""
    reach = 1e-9 * (time_s[high] - time_s[low])
    guess = at
    for _ in range(CORNER_PASSES):  # a corner a few samples off tilts its lines; the next pass has it nearer
        left = slice(max(low, guess - CORNER_SAMPLES), guess + 1)
        right = slice(guess, min(high, guess + CORNER_SAMPLES) + 1)
        slope_1, level_1 = _line(time_s[left], depth_mm[left], flat=stands[0])
        slope_2, level_2 = _line(time_s[right], depth_mm[right], flat=stands[1])
        if slope_1 == slope_2:
            break
        meet = (level_2 - level_1) / (slope_1 - slope_2)
        if not time_s[low] <= meet <= time_s[high]:
            break
        both = slice(left.start, right.stop)
        t = time_s[both]
        fitted = np.where(t <= meet, level_1 + slope_1 * t, level_2 + slope_2 * t)
        moved = int(np.clip(np.searchsorted(time_s, meet - reach), low + 1, high - 1))
        if np.abs(depth_mm[both] - fitted).max() <= tolerance and abs(moved - guess) <= 1:
            return moved
        guess = moved
    if stands[1]:  # a rounded stop: the hold begins where the plateau is reached for good
        plateau = float(np.median(depth_mm[at : high + 1]))
        outside = np.flatnonzero(np.abs(depth_mm[low : high + 1] - plateau) > tolerance)
        return low + int(outside[-1]) + 1 if outside.size and outside[-1] + low < high else at
    if stands[0]:
        plateau = float(np.median(depth_mm[low : at + 1]))
        outside = np.flatnonzero(np.abs(depth_mm[low : high + 1] - plateau) > tolerance)
        return max(low, low + int(outside[0]) - 1) if outside.size else at
    return at


def _line(time_s: FloatArray, depth_mm: FloatArray, *, flat: bool) -> tuple[float, float]:
    """Slope and level at t = 0 of the straight line through one side of a corner."""
    if flat:
        return 0.0, float(np.median(depth_mm))
    centre = time_s.mean()
    off = time_s - centre
    spread = float(off @ off)
    slope = float(off @ depth_mm) / spread if spread > 0.0 else 0.0
    return slope, float(depth_mm.mean() - slope * centre)
