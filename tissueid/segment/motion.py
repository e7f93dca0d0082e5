"""Motion of the crosshead, from measured displacement: moves in, moves out, standstills.

The displacement is reduced to a polyline within its noise (Ramer 1972, Douglas & Peucker 1973); its pieces
become moves and standstills, whose ends are placed where the lines of their two sides meet.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.signal_noise import FEWEST_CHANGES, off_chords, quantum, robust_sd, white_noise_sd

#: Samples on each side of a corner that place it.
CORNER_SAMPLES = 200
#: Samples on each side that must lie on the lines of a sharp corner, and what share of them.
NEAR_SAMPLES = 25
SHARP_SHARE = 0.98
#: Lines that differ by this share of what they run through are the same.
ROUNDING = 1e-9
#: Passes that place a corner.
CORNER_PASSES = 16

Line = tuple[float, float]  # slope, and level at t = 0


@dataclass(frozen=True, slots=True)
class Path:
    """Recorded path, growing into the tissue, and what noise explains of it."""

    time_s: FloatArray
    depth_mm: FloatArray
    force_N: FloatArray
    noise_N: float
    #: Largest distance from a straight line that noise and steps of the displacement explain, and with what
    #: the polyline does not resolve [mm].
    noise_mm: float
    tolerance_mm: float
    #: The force swings by so much while the tool stands.
    swing_N: float = 0.0

    @classmethod
    def of(cls, time_s: FloatArray, depth_mm: FloatArray, force_N: FloatArray, noise_N: float) -> Path:
        """The path of these samples."""
        noise_mm = path_noise(time_s, depth_mm)
        return cls(time_s, depth_mm, force_N, noise_N, noise_mm, _tolerance(noise_mm, depth_mm))


def corner_near(path: Path, at: int, within: tuple[int, int], *, stands: tuple[bool, bool]) -> int:
    """First sample after the corner of two moves or standstills; the first on a rounded stop's plateau."""
    low, high = within
    # lines through what lies farther off: they know nothing of the corner's own shape
    far = slice(low, low + (at - low) // 2 + 1), slice(at + (high - at) // 2, high + 1)
    guess = _meeting(path, _two_lines(path, far, stands), low, high)
    guess = first = at if guess is None else guess
    for _ in range(CORNER_PASSES):  # a corner a few samples off tilts its lines; the next pass has it nearer
        near = (
            slice(max(low, guess - CORNER_SAMPLES), guess + 1),
            slice(guess, min(high, guess + CORNER_SAMPLES) + 1),
        )
        lines = _two_lines(path, near, stands)
        moved = _meeting(path, lines, low, high)
        if moved is None or abs(moved - first) > CORNER_SAMPLES:
            break
        if abs(moved - guess) <= 1:
            if _sharp(path, lines, moved):
                return moved
            break
        guess = moved
    if not any(stands):
        return first
    standing = slice(max(at, first), high + 1) if stands[1] else slice(low, min(at, first) + 1)
    plateau = float(np.median(path.depth_mm[standing]))
    outside = np.flatnonzero(np.abs(path.depth_mm[low : high + 1] - plateau) > path.tolerance_mm)
    if stands[1]:  # a rounded stop: the hold begins where the plateau is reached for good
        return low + int(outside[-1]) + 1 if outside.size and outside[-1] + low < high else at
    return max(low, low + int(outside[0]) - 1) if outside.size else at


def _two_lines(path: Path, sides: tuple[slice, slice], stands: tuple[bool, bool]) -> tuple[Line, Line]:
    """Slope and level of the straight lines on both sides of a corner."""
    before, after = (
        straight_line(path.time_s[side], path.depth_mm[side], flat=flat)
        for side, flat in zip(sides, stands, strict=True)
    )
    return before, after


def _meeting(path: Path, lines: tuple[Line, Line], low: int, high: int) -> int | None:
    """The first sample from which two lines have met, within ``(low, high)``; ``None`` where they do not."""
    (slope_1, level_1), (slope_2, level_2) = lines
    ends = path.time_s[[low, high]]
    one, other = level_1 + slope_1 * ends, level_2 + slope_2 * ends
    # two samples of one straight ramp lie on its line: where they part is rounding
    if float(np.abs(one - other).max()) <= ROUNDING * float(np.abs([one, other]).max()):
        return None
    if slope_1 == slope_2:
        return None
    meet = (level_2 - level_1) / (slope_1 - slope_2)
    if not path.time_s[low] <= meet <= path.time_s[high]:
        return None
    # a clock that counts from an epoch has fewer digits left
    reach = 1e-9 * (path.time_s[high] - path.time_s[low]) + 8.0 * np.spacing(path.time_s[high])
    return int(np.clip(np.searchsorted(path.time_s, meet - reach), low + 1, high - 1))


def _sharp(path: Path, lines: tuple[Line, Line], at: int) -> bool:
    """True where the samples near a corner lie on its two lines."""
    near = slice(max(at - NEAR_SAMPLES, 0), at + NEAR_SAMPLES + 1)
    t, x = path.time_s[near], path.depth_mm[near]
    (slope_1, level_1), (slope_2, level_2) = lines
    one, other = level_1 + slope_1 * t, level_2 + slope_2 * t
    # a path that slows down lies below both lines, one that speeds up above both
    fitted = np.minimum(one, other) if slope_1 > slope_2 else np.maximum(one, other)
    off = np.abs(x - fitted)
    return bool(
        np.mean(off <= path.tolerance_mm) >= SHARP_SHARE
        and abs(float(np.mean(x - fitted))) <= path.tolerance_mm / 3.0
    )


def straight_line(time_s: FloatArray, depth_mm: FloatArray, *, flat: bool) -> Line:
    """Slope and level at t = 0 of the straight line through samples; the median level where ``flat``."""
    if flat:
        return 0.0, float(np.median(depth_mm))
    slope, _ = slope_of(time_s, depth_mm)
    return slope, float(depth_mm.mean() - slope * time_s.mean())


def slope_of(places: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Least-squares slope of values over places, 0 over a single one, and the places' sum of squares."""
    off = places - places[:1]  # the mean of an epoch's seconds is rounded
    off -= off.mean()
    spread = float(off @ off)
    return (float(off @ values) / spread if spread > 0.0 else 0.0), spread


def leaves_line(path: Path, move: Piece, end: int) -> int:
    """The sample up to which the path follows the straight line through the middle of a move."""
    first, last = move.start, move.stop
    count = last - first
    middle = slice(first + count // 4, last - count // 4 + 1)
    slope, level = straight_line(path.time_s[middle], path.depth_mm[middle], flat=False)
    centre = (first + last) // 2
    way = np.arange(centre, end + 1) if end >= centre else np.arange(centre, end - 1, -1)
    off = np.abs(path.depth_mm[way] - level - slope * path.time_s[way]) > path.tolerance_mm
    return int(way[max(int(np.argmax(off)) - 1, 0)]) if off.any() else end


def quickens(path: Path, move: Piece) -> int:
    """The sample from which a move goes on faster than it began; its start where it does not."""
    span = slice(move.start, move.stop + 1)
    time_s, travel = path.time_s[span], move.direction * path.depth_mm[span]
    knots = corners(time_s, travel, tolerance=path.tolerance_mm)
    knots = knots[np.append(True, np.diff(knots) >= MOVE_SAMPLES)]
    rise, lasted = np.diff(travel[knots]), np.diff(time_s[knots])
    large = rise >= MOVE_SHARE * float(np.ptp(path.depth_mm))
    knots, speed = knots[:-1][large], rise[large] / np.maximum(lasted[large], 1e-300)
    faster = np.flatnonzero(speed[1:] > QUICKER_RATIO * speed[:-1]) + 1
    return move.start + int(knots[faster[-1]]) if faster.size else move.start


def corners(time_s: FloatArray, values: FloatArray, *, tolerance: float) -> NDArray[np.intp]:
    """Indices of the corners, first and last sample included."""
    found = {0, values.size - 1}
    open_stretches = [(0, values.size - 1)]
    while open_stretches:
        first, last = open_stretches.pop()
        if last - first < 2:
            continue
        span = time_s[last] - time_s[first]
        rate = (values[last] - values[first]) / span if span > 0.0 else 0.0
        inside = slice(first + 1, last)
        off = values[inside] - (time_s[inside] - time_s[first]) * rate
        off -= values[first]
        low, high = int(off.argmin()), int(off.argmax())
        worst = high if off[high] >= -off[low] else low
        if abs(off[worst]) > tolerance:
            at = first + 1 + worst
            found.add(at)
            open_stretches += [(first, at), (at, last)]
    return np.array(sorted(found), dtype=np.intp)


#: Longer recordings are averaged down to about so many blocks before their polyline is drawn.
BLOCKS = 10_000
#: Samples of white noise stay within this many standard deviations (1e5 samples: 4.4 expected).
NOISE_REACH = 5.5
#: Weights of the second difference have this sum of squares: 1 + 4 + 1.
SECOND_DIFFERENCE_VARIANCE = 6.0
#: Share of the squared second differences that is averaged, and the normal variance within that share.
TRIMMED = 0.9
TRIMMED_VARIANCE = 0.6230
#: ... of the change of the distance from a line, in the middle between neighbours: 1/4 + 9/4 + 9/4 + 1/4.
THIRD_DIFFERENCE_VARIANCE = 5.0
#: Travel is looked at over so many parts of a record, twice.
MOVING_WINDOWS = 50
#: A displacement is held between its samples where so many of its steps stand alone.
APART_SHARE = 0.8
#: Fewer samples are mostly corners.
FEWEST_FOR_SPREAD = 60
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
#: ... and the second half of one move is faster than the first by this one.
QUICKER_RATIO = 1.05
#: Fewer samples than this at another speed are a start or a stop, not a move of their own.
MOVE_SAMPLES = 5
#: ... and a slower stretch up to this long is a crosshead that stops or starts [s], as is ...
STOP_S = 0.3
#: ... one of less than this share of its neighbour's time and travel.
MINOR = 0.2
#: Fewer samples at rest are event rows or the turn of a move; a shorter time than the last move needs to
#: leave the tolerance so many times shows no rest at all.
STAND_SAMPLES = 4
STAND_TOLERANCES = 4.0


@dataclass(frozen=True, slots=True)
class Piece:
    """One move (``direction`` +1 in, -1 out) or standstill (0) over samples ``[start, stop]``."""

    direction: int
    start: int
    stop: int

    def travel_mm(self, path: Path) -> float:
        """Travel from its first to its last sample."""
        return float(path.depth_mm[self.stop] - path.depth_mm[self.start])

    def took_s(self, path: Path) -> float:
        """Time from its first to its last sample."""
        return float(path.time_s[self.stop] - path.time_s[self.start])

    def speed(self, path: Path) -> float:
        """Mean speed from its first to its last sample [mm/s]."""
        return self.travel_mm(path) / max(self.took_s(path), 1e-300)


def path_noise(time_s: FloatArray, depth_mm: FloatArray) -> float:
    """Largest distance from a straight line that noise and steps of the displacement explain [mm]."""
    noise = white_noise_sd(time_s, depth_mm, fewest=FEWEST_CHANGES)
    if depth_mm.size >= FEWEST_FOR_SPREAD:
        # the median of a quantised signal is one of its steps; a trimmed mean square knows no steps
        bend = np.diff(depth_mm, n=2) ** 2 / SECOND_DIFFERENCE_VARIANCE
        inner = bend[bend <= np.quantile(bend, TRIMMED)]
        noise = max(noise, float(np.sqrt(inner.mean() / TRIMMED_VARIANCE)))
    moving = _moving(depth_mm)
    noise = max(noise, _timing_noise(time_s, depth_mm, moving))
    return max(
        NOISE_REACH * noise,
        1.01 * quantum(depth_mm, fewest=FEWEST_CHANGES),
        1.01 * _held_step(depth_mm, moving),
    )


def _moving(depth_mm: FloatArray) -> NDArray[np.bool_]:
    """Samples about which the tool travels at least half as far as about any other."""
    reach = max(MOVE_SAMPLES, depth_mm.size // MOVING_WINDOWS)
    if depth_mm.size <= 2 * reach:
        return np.zeros(depth_mm.size, dtype=np.bool_)
    padded = np.pad(depth_mm, reach, mode="edge")
    far = np.abs(padded[2 * reach :] - padded[: -2 * reach])
    return np.asarray((far >= 0.5 * far.max()) & (far.max() > 0.0))


def _timing_noise(time_s: FloatArray, depth_mm: FloatArray, moving: NDArray[np.bool_]) -> float:
    """Standard deviation of the displacement while the tool moves, to which stamps that jitter add [mm].

    A change of the distance from the line between neighbours is blind to a bend.
    """
    if int(moving.sum()) < FEWEST_FOR_SPREAD or (time_s[2:] <= time_s[:-2]).any():
        return 0.0
    off, _ = off_chords(time_s, depth_mm)
    change = np.diff(off)[moving[1:-2] & moving[2:-1]]
    if change.size < FEWEST_FOR_SPREAD:
        return 0.0
    return robust_sd(change) / float(np.sqrt(THIRD_DIFFERENCE_VARIANCE))


def _held_step(depth_mm: FloatArray, moving: NDArray[np.bool_]) -> float:
    """Usual step of a displacement that was sampled slower than it was written, 0 where it was not [mm]."""
    stepped = np.diff(depth_mm) != 0.0
    apart = stepped[1:-1] & ~stepped[:-2] & ~stepped[2:]
    of_moves = stepped[1:-1] & moving[1:-2]
    if int(of_moves.sum()) < MOVE_SAMPLES or int((apart & of_moves).sum()) < APART_SHARE * int(
        of_moves.sum()
    ):
        return 0.0
    return float(np.median(np.abs(np.diff(depth_mm))[1:-1][of_moves]))


def _tolerance(noise_mm: float, depth_mm: FloatArray) -> float:
    """Largest distance from a straight line that noise and resolution explain [mm]."""
    return max(noise_mm, POLYLINE_RESOLUTION * float(np.ptp(depth_mm)))


def pieces(path: Path) -> list[Piece]:
    """Divide a recording into moves and standstills."""
    last = path.depth_mm.size - 1
    if path.tolerance_mm == 0.0:
        return [Piece(0, 0, last)]
    size = max(1, path.depth_mm.size // BLOCKS)
    held = 1.01 * _held_step(path.depth_mm, _moving(path.depth_mm))  # means of blocks hide it
    t, x = (_block_means(values, size) for values in (path.time_s, path.depth_mm))
    tolerance = _tolerance(max(path_noise(t, x), held), x)
    coarse = _absorb(_classify(t, x, corners(t, x, tolerance=tolerance), tolerance=tolerance))
    edges = [0, *(min(one.stop * size + size // 2, last) for one in coarse[:-1]), last]
    found = [Piece(one.direction, *span) for one, span in zip(coarse, pairwise(edges), strict=True)]
    return _place_corners(path, _demote_drifting(path, found))


def _block_means(values: FloatArray, size: int) -> FloatArray:
    """Means of neighbouring samples: a long noisy recording has outliers that would break its lines up."""
    if size == 1:
        return values
    starts = np.arange(0, values.size, size)
    return np.asarray(np.add.reduceat(values, starts) / np.diff(np.append(starts, values.size)))


def _classify(
    time_s: FloatArray, depth_mm: FloatArray, knots: NDArray[np.intp], *, tolerance: float
) -> list[tuple[_Stretch, bool]]:
    """Each stretch of the polyline, and whether it is large enough to stand for itself."""
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
        & (np.diff(knots) >= STAND_SAMPLES)
        & (span * reference >= STAND_TOLERANCES * tolerance)
        & (np.abs(speed) <= STAND_SPEED * reference)
        & (np.abs(rise) <= 2.0 * tolerance + MOVE_SHARE * np.ptp(depth_mm))
    )
    direction = np.where(stands, 0, np.sign(rise)).astype(int)
    columns = (direction, knots[:-1], knots[1:], span, rise, speed, span)
    stretches = (_Stretch(*row) for row in zip(*(column.tolist() for column in columns), strict=True))
    return list(zip(stretches, (large | stands).tolist(), strict=True))


@dataclass(frozen=True, slots=True)
class _Stretch(Piece):
    """A piece with the time and travel of all of it, and the speed of its longest straight part."""

    lasted_s: float
    moved_mm: float
    speed_mm_s: float
    longest_s: float

    def joined(self, after: _Stretch) -> _Stretch:
        """Both as one."""
        longer = max((self, after), key=lambda one: one.longest_s)
        lasted, moved = self.lasted_s + after.lasted_s, self.moved_mm + after.moved_mm
        return replace(longer, start=self.start, stop=after.stop, lasted_s=lasted, moved_mm=moved)


def _absorb(stretches: list[tuple[_Stretch, bool]]) -> list[_Stretch]:
    """Join neighbours that do the same, and give transients to the piece before them."""
    alone: list[_Stretch] = []
    waiting: int | None = None
    for stretch, stands_alone in stretches:
        if stands_alone:
            alone.append(replace(stretch, start=stretch.start if waiting is None else waiting))
            waiting = None
        elif alone and alone[-1].direction != 0:
            alone[-1] = replace(alone[-1], stop=stretch.stop)
        elif waiting is None:
            waiting = stretch.start  # a start from standstill belongs to what starts
    first, last = stretches[0][0], stretches[-1][0]
    if not alone:
        return [replace(first, direction=0, stop=last.stop)]
    alone[-1] = replace(alone[-1], stop=last.stop)
    count = 0
    while count != len(alone):  # parts of a rounded turn may be joined to each other before the move
        count = len(alone)
        joined = alone[:1]
        for stretch in alone[1:]:
            if _same(joined[-1], stretch):
                joined[-1] = joined[-1].joined(stretch)
            else:
                joined.append(stretch)
        alone = joined
    return alone


def _same(before: _Stretch, after: _Stretch) -> bool:
    """True where two neighbouring stretches are one phase."""
    if before.direction != after.direction:
        return False
    if before.direction == 0:
        return True
    few = min(one.stop - one.start for one in (before, after)) < MOVE_SAMPLES
    short, long = sorted((before, after), key=lambda one: one.lasted_s)
    slow, fast = sorted(abs(one.speed_mm_s) for one in (before, after))
    # of a crosshead that slows down evenly, the time below a share of its speed goes with the root of it
    stopping = abs(short.speed_mm_s) == slow and short.lasted_s <= STOP_S * np.sqrt(slow / max(fast, 1e-300))
    minor = short.lasted_s < MINOR * long.lasted_s and abs(short.moved_mm) < MINOR * abs(long.moved_mm)
    return bool(few or stopping or minor or fast <= SPEED_RATIO * slow)


def _demote_drifting(path: Path, found: list[Piece]) -> list[Piece]:
    """Standstills that drift against the move before them become slow moves."""
    result: list[Piece] = []
    for k, piece in enumerate(found):
        if piece.direction == 0 and k > 0:
            before = found[k - 1]
            travel = abs(before.travel_mm(path))
            quarter = max(1, (piece.stop - piece.start) // 4)
            drift = float(
                np.median(path.depth_mm[piece.stop - quarter : piece.stop + 1])
                - np.median(path.depth_mm[piece.start : piece.start + quarter + 1])
            )
            if abs(drift) > max(HOLD_DRIFT * travel, path.tolerance_mm):
                result.append(replace(piece, direction=int(np.sign(drift))))
                continue
        result.append(piece)
    return result


def _place_corners(path: Path, found: list[Piece]) -> list[Piece]:
    """Move each corner to where the lines of its two sides meet, or to where the standstill begins."""
    edges = [piece.start for piece in found] + [found[-1].stop]
    for k in range(1, len(found)):
        before, after = found[k - 1], found[k]
        low, high = (before.start + edges[k]) // 2, (edges[k] + after.stop) // 2
        low, high = max(low, edges[k - 1] + 1), min(high, after.stop - 1)
        if high - low < 4:
            continue
        edges[k] = corner_near(
            path, edges[k], (low, high), stands=(before.direction == 0, after.direction == 0)
        )
    return [replace(piece, start=edges[k], stop=edges[k + 1]) for k, piece in enumerate(found)]
