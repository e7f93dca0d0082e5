"""Blocks of a log: stretches in which the measured travel is straight, each with its mean force.

A short log is kept sample by sample.  Blocks of a long one grow by :data:`GROWTH` behind every corner, so
that a relaxation is seen evenly in ln time, and are compared with the model's mean over their samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, IntArray
from tissueid.inference.window import LogData, SurfaceResponse
from tissueid.signal_noise import Lines, quantum, white_noise_sd

#: Samples up to which a log is kept sample by sample.
SAMPLED = 420
#: Growth of blocks behind a corner, share of the depth and of the duration that one block spans at the most.
GROWTH, TRAVEL_SHARE, TIME_SHARE = 1.25, 1.0 / 60.0, 1.0 / 25.0
#: Samples behind a corner that stand alone, as a relaxation as fast as they are is gone in them; and squared
#: distance from a line, over that of one that is straight, of what is a corner and no noise.
ALONE, SURE = 2, 9.0
#: Root mean square distance from a line that is straight, over the noise of the travel and over the depth.
STRAIGHT, STRAIGHT_SHARE = 1.3, 2e-6
#: Bend of a travel that is known exactly, over its fastest speed, that is one.
BEND_SHARE = 1e-10
#: Samples from which a block's own line says where its ends are.
LINE_FROM = 4
#: Median of the size of second differences over the standard deviation of white noise.
SECOND_DIFFERENCE = 0.6745 * 6.0**0.5
#: Samples of a straight line beside a corner; its tolerance in noise of the travel, and in depths.
LINE_SAMPLES, CORNER_SD, CORNER_SHARE = 4, 3.0, 1e-5
#: Bend over one step in tolerances, and share of a step at its ends, of a corner between samples.
CORNER_BEND, CORNER_EDGE = 20.0, 0.01
#: Steps of the digits over which neighbouring differences of force differ at a corner.
FEW_STEPS = 4.0
#: Contact standard deviations by which the path is continued before its contact.
LEAD_SD = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """One log as it is compared with a law."""

    time_s: FloatArray  # (m,), broken line of the tool's travel
    depth_mm: FloatArray  # (m,)
    #: (k, 3): points of that line of each observation: start, middle and end; thrice the sample of one.
    at: IntArray
    force_N: FloatArray  # (k,), measured mean force
    count: IntArray  # (k,), samples of each observation
    mid_s: FloatArray  # (k,), mean time of an observation
    step_s: FloatArray  # (k,), sampling interval within it
    chain: NDArray[np.bool_]  # (k,), true where an observation starts a chain of noise
    fold: IntArray  # (k,), held-out group
    within_N2: float  # sum of squares of the samples about lines in their blocks [N^2]
    within_freedom: int
    contact_sd_mm: float
    #: (k,): variance of the digits' error that no averaging takes off, over that of a sample.
    digits: FloatArray
    speed_ratio: FloatArray  # (m,), speed over that at which each contact began; zero where no law follows it
    response: SurfaceResponse | None = None  # of ``depth_mm`` where a surface is followed


def _digits(force: FloatArray, means: FloatArray) -> FloatArray:
    """Variance of rounding that the samples of a block share, over the variance of a sample's noise.

    Force that passes a step within a block is rounded up and down.  Noise before rounding of standard
    deviation s leaves exp(-(2 pi s / q)^2) of the correlation that the errors of a step q have in a slow
    signal (Widrow & Kollar 2008, doi 10.1017/CBO9780511754661).
    """
    step, none = quantum(force), np.zeros(means.size)
    if step == 0.0 or means.size < 2:
        return none
    bends = np.diff(force, 2)
    # most neighbours are alike: a mean of squares counts the others, and leaves corners out
    noise = float(np.mean(bends[np.abs(bends) <= FEW_STEPS * step] ** 2)) / 6.0
    rounding = step**2 / 12.0
    before = max(noise - rounding, 0.0)
    share = rounding * np.exp(-before * (2.0 * np.pi / step) ** 2) / max(noise, rounding)
    return np.where(np.abs(np.gradient(means)) < step, share, 0.0)


def _edges(time: FloatArray, depth: FloatArray, stops: Sequence[int]) -> IntArray:
    """First samples of all blocks, and the number of samples; no block runs across one of ``stops``."""
    n = time.size
    scale = max(float(np.ptp(depth)), 1e-300)
    t = (time - time[0]) / max(float(time[-1] - time[0]), 1e-300)
    x = (depth - depth[0]) / scale
    lines = Lines(t, x)
    # equal steps between standstills are one speed, and no digits
    still = np.diff(depth) == 0.0
    moving = ~(np.append(still, True) & np.append(True, still))
    noise = white_noise_sd(time[moving], depth[moving]) / scale
    limit = (STRAIGHT * noise) ** 2 + STRAIGHT_SHARE**2

    def straight(i: int, j: int, wide: float = 1.0) -> bool:
        """Samples i to j (without j) lie on a line, and their neighbours too: none of them is at a corner."""
        i, j = max(i - 1, 0), min(j + 1, n)
        return j - i < 3 or bool(lines.left(i, j) <= wide * limit * (j - i) + 1e-13)

    out, size, alone = [0], 1, ALONE + 1
    following = iter([*stops, n])
    stop, i = next(following), 0
    while i < n:
        while stop <= i:
            stop = next(following)
        alone = max(alone - 1, 0) if straight(i, i + 1, SURE) else ALONE + 1
        size = min(max(int(np.ceil(GROWTH * size)), size + 1), stop - i) if alone == 0 else 1
        # half a sample before the first and behind the last there is no path
        while size > 1 and not (
            0 < i < n - size
            and abs(x[i + size - 1] - x[i]) <= TRAVEL_SHARE
            and t[i + size - 1] - t[i] <= TIME_SHARE
            and straight(i, i + size)
        ):
            size = max(size // 2, 1)
        i += size
        out.append(i)
    return np.array(out, dtype=np.int64)


def _ends(time: FloatArray, depth: FloatArray, edges: IntArray) -> tuple[FloatArray, FloatArray]:
    """Times and depths of the ends of all blocks: a broken line."""
    first, last = edges[:-1], edges[1:]
    count = (last - first).astype(np.float64)
    base = time[first]
    since = time - np.repeat(base, last - first)
    sums = partial(np.add.reduceat, indices=first)
    mean_t, mean_x = sums(since) / count, sums(depth) / count
    spread = sums(since * since) - count * mean_t**2
    slope = np.divide(
        sums(since * depth) - count * mean_t * mean_x, spread, out=np.zeros(count.size), where=spread > 0.0
    )
    inner = 0.5 * (time[last[:-1] - 1] + time[last[:-1]])
    at = np.concatenate([[time[0]], inner, [time[-1]]])
    left = mean_x + slope * (at[1:] - base - mean_t)
    right = mean_x + slope * (at[:-1] - base - mean_t)
    out = np.empty(at.size)
    out[0], out[-1] = depth[0], depth[-1]
    plain = 0.5 * (depth[last[:-1] - 1] + depth[last[:-1]])
    weight = count[:-1] / (count[:-1] + count[1:])
    lines = weight * left[:-1] + (1.0 - weight) * right[1:]
    use = (count[:-1] >= LINE_FROM) & (count[1:] >= LINE_FROM)
    out[1:-1] = np.where(use, lines, plain)
    return at, out


def _corners(time: FloatArray, depth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times and depths of sharp corners that lie between two samples: where two straight lines meet."""
    if time.size < 2 * LINE_SAMPLES:
        return np.empty(0), np.empty(0)
    i = np.arange(LINE_SAMPLES - 1, time.size - LINE_SAMPLES)
    step = np.diff(time)
    # ramps and holds are straight nearly everywhere; what isn't fails as a line below
    noise = float(np.median(np.abs(np.diff(depth, n=2)))) / SECOND_DIFFERENCE
    tolerance = max(CORNER_SD * noise, CORNER_SHARE * float(np.ptp(depth)))

    def line(first: IntArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        last = first + LINE_SAMPLES - 1
        span = time[last] - time[first]
        # rows that share one instant are no line
        slope = np.divide(depth[last] - depth[first], span, out=np.zeros(first.size), where=span > 0.0)
        off = np.zeros(first.size)
        for k in range(1, LINE_SAMPLES - 1):
            straight = depth[first] + slope * (time[first + k] - time[first])
            off = np.maximum(off, np.abs(depth[first + k] - straight))
        return slope, (off <= tolerance) & (span > 0.0)

    left, left_straight = line(i - LINE_SAMPLES + 1)
    right, right_straight = line(i + 1)
    bend = left - right
    sharp = left_straight & right_straight & (np.abs(bend) * step[i] > CORNER_BEND * tolerance)
    i, right, bend, left = i[sharp], right[sharp], bend[sharp], left[sharp]
    after = (depth[i + 1] - depth[i] - right * step[i]) / bend
    inside = (after > CORNER_EDGE * step[i]) & (after < (1.0 - CORNER_EDGE) * step[i])
    return (time[i] + after)[inside], (depth[i] + left * after)[inside]


def _lead(time: FloatArray, depth: FloatArray, sd_mm: float, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Points before contact on the line that the first samples show, as close as blocks."""
    reach = min(time.size - 1, 4)
    speed = (depth[reach] - depth[0]) / max(time[reach] - time[0], 1e-300)
    if speed <= 0.0:
        return time[:1] - step_s, depth[:1]
    lead = LEAD_SD * sd_mm + float(depth[0])
    count = max(int(lead / (TRAVEL_SHARE * float(np.ptp(depth)))), 1)
    back = np.linspace(1.0, 0.0, count, endpoint=False)
    return time[0] - back * max(lead / speed, 1e-9), depth[0] - back * lead


def log_blocks(
    data: LogData, *, step_s: float, contact_sd_mm: float, leads: bool, whole: bool = False
) -> Blocks:
    """Reduce a log.

    ``leads``: the tool came down to the contact, which may lie before the log; ``whole``: keep every
    sample.
    """
    time, force, include = data.time_s, data.force_N, data.include
    single = data.exact or whole or time.size <= SAMPLED
    got = _single_samples(data, step_s=step_s, whole=whole) if single else _reduced(data, step_s=step_s)
    grid_t, grid_x, at = got.grid_s, got.grid_mm, got.at
    if not data.exact:
        corners_s, corners_mm = _corners(time, data.depth_mm)
        place = np.searchsorted(grid_t, corners_s)
        grid_t, grid_x = np.insert(grid_t, place, corners_s), np.insert(grid_x, place, corners_mm)
        at = at + np.searchsorted(place, at, side="right")
    if leads:
        before_s, before_mm = _lead(grid_t, grid_x, contact_sd_mm, step_s)
        grid_t, grid_x = np.concatenate([before_s, grid_t]), np.concatenate([before_mm, grid_x])
        at = at + before_s.size
    chain = got.opens.copy()
    chain[0] = True
    gap = np.diff(got.place, prepend=got.place[0] - 1) > 1
    ratio = np.zeros(time.size) if data.speed_ratio is None else data.speed_ratio
    response = data.response
    if response is not None:
        response = replace(response, by=np.array([np.interp(grid_t, time, one) for one in response.by]))
    return Blocks(
        time_s=np.ascontiguousarray(grid_t),
        depth_mm=np.ascontiguousarray(grid_x),
        at=at,
        force_N=np.ascontiguousarray(got.force_N),
        count=got.count,
        mid_s=got.mid_s,
        step_s=np.maximum(got.step_s, 1e-12),
        chain=chain | gap,
        fold=got.fold,
        within_N2=got.within_N2,
        within_freedom=got.freedom,
        contact_sd_mm=contact_sd_mm,
        digits=_digits(force[include], got.force_N),
        speed_ratio=np.interp(grid_t, time, ratio),
        response=response,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Observations:
    """Observations of a log on the broken line of its travel, before corners and lead."""

    grid_s: FloatArray
    grid_mm: FloatArray
    at: IntArray
    force_N: FloatArray
    count: IntArray
    mid_s: FloatArray
    step_s: FloatArray
    fold: IntArray
    opens: NDArray[np.bool_]
    #: Place of each among samples or blocks: neighbours without one between them are one chain of noise.
    place: IntArray
    within_N2: float = 0.0
    freedom: int = 0


def _breaks(data: LogData) -> NDArray[np.bool_]:
    return np.zeros(data.time_s.size, dtype=bool) if data.breaks is None else data.breaks


def _single_samples(data: LogData, *, step_s: float, whole: bool) -> _Observations:
    """Samples as they are: each, or of a travel that is known exactly the first of each block."""
    time, depth, breaks = data.time_s, data.depth_mm, _breaks(data)
    if data.exact:
        stops = [int(one) for one in _opened(data.include, breaks) if one > 0]
        first = np.arange(time.size) if whole else _edges(time, depth, stops)[:-1]
        used = first[data.include[first]]
        grid_t, grid_x, at = _followed(time, depth, used)
        place = np.arange(used.size)
    else:
        used = place = np.flatnonzero(data.include)
        grid_t, grid_x, at = time, depth, np.repeat(used[:, None], 3, axis=1)
    count, step = np.ones(used.size, dtype=np.int64), np.full(used.size, step_s)
    return _Observations(
        grid_t, grid_x, at, data.force_N[used], count, time[used], step, data.fold[used], breaks[used], place
    )


def _reduced(data: LogData, *, step_s: float) -> _Observations:
    """Blocks of a long log."""
    time, depth, force, include = data.time_s, data.depth_mm, data.force_N, data.include
    breaks = _breaks(data)
    opened = _opened(include, breaks)
    # a sample beside a gap is alone: half of the gap is not what its block was sampled over
    stops = np.unique(np.concatenate([opened - 1, opened, opened + 1]))
    if data.fold.any():
        stops = np.union1d(stops, np.flatnonzero(np.diff(data.fold, prepend=data.fold[0]) != 0))
    edges = _edges(time, depth, [int(one) for one in stops if 0 < one < time.size])
    ends_t, ends_x = _ends(time, depth, edges)
    grid_t, grid_x = np.empty((2, 2 * edges.size - 1))
    grid_t[::2], grid_x[::2] = ends_t, ends_x
    grid_t[1::2] = 0.5 * (ends_t[1:] + ends_t[:-1])
    grid_x[1::2] = 0.5 * (ends_x[1:] + ends_x[:-1])
    first, size = edges[:-1], np.diff(edges)
    single = np.flatnonzero(size == 1)
    grid_t[2 * single + 1], grid_x[2 * single + 1] = time[first[single]], depth[first[single]]
    kept = np.flatnonzero(include[first])
    count = size[kept]
    span = (time[edges[1:] - 1] - time[first])[kept]
    within, freedom = _within(time, force, edges, kept)
    return _Observations(
        grid_t,
        grid_x,
        2 * kept[:, None] + np.where(size[kept, None] == 1, 1, np.arange(3)),
        (np.add.reduceat(force, first) / size)[kept],
        count,
        (np.add.reduceat(time, first) / size)[kept],
        np.where(count > 1, span / np.maximum(count - 1, 1), step_s),
        data.fold[first[kept]],
        np.add.reduceat(breaks.astype(np.int64), first)[kept] > 0,
        kept,
        within,
        freedom,
    )


def _opened(include: NDArray[np.bool_], breaks: NDArray[np.bool_]) -> IntArray:
    """Samples at which what is fitted begins or ends, or a chain of noise begins."""
    return np.flatnonzero((np.diff(include.astype(np.int8), prepend=include[0]) != 0) | breaks)


def _followed(time: FloatArray, depth: FloatArray, used: IntArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Broken line of a travel that is known exactly, and the places of single samples on it."""
    step = np.diff(time)
    slope = np.divide(np.diff(depth), step, out=np.zeros(step.size), where=step > 0.0)
    bends = 1 + np.flatnonzero(np.abs(np.diff(slope)) > BEND_SHARE * np.abs(slope).max(initial=0.0))
    knots = np.union1d(np.union1d(bends, used), [0, time.size - 1])
    return time[knots], depth[knots], np.repeat(np.searchsorted(knots, used)[:, None], 3, axis=1)


def _within(time: FloatArray, force: FloatArray, edges: IntArray, kept: IntArray) -> tuple[float, int]:
    """Sum of squares about a line in each kept block, and its degrees of freedom."""
    first, size = edges[:-1], np.diff(edges)
    since = time - np.repeat(time[first], size)
    level = force - np.repeat(force[first], size)
    sums = partial(np.add.reduceat, indices=first)
    mean_t, mean_f = sums(since) / size, sums(level) / size
    tt = sums(since * since) - size * mean_t**2
    tf = sums(since * level) - size * mean_t * mean_f
    ff = sums(level * level) - size * mean_f**2
    rest = ff - np.divide(tf * tf, tt, out=np.zeros(tt.size), where=tt > 0.0)
    lines = np.zeros(size.size, dtype=bool)
    lines[kept] = True
    lines &= size > 2
    return float(np.maximum(rest[lines], 0.0).sum()), int((size[lines] - 2).sum())
