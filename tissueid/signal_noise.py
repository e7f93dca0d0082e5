"""Noise of a signal from its successive differences, whatever it does slowly, and single samples far off.

A sample is compared with the line between its neighbours, at the shares w and 1 - w; white noise of sigma
differs by sigma sqrt(1 + w^2 + (1 - w)^2).  The median makes corners and steps harmless; a quantised signal
has step/sqrt(12).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, IntArray

#: One place among samples, or several.
Places = int | IntArray

#: Standard deviation of a normal variable over its median absolute value.
NORMAL_SD_OVER_MEDIAN = 1.482602218505602
#: Weights of the fourth difference have this sum of squares: 1 + 16 + 36 + 16 + 1.
FOURTH_DIFFERENCE_VARIANCE = 70.0
#: Share of repeated values above which a signal is taken for quantised.
QUANTISED_SHARE = 0.2
#: Fewer changes of a displacement show no step: the tool may have jumped.
FEWEST_CHANGES = 8
#: Changes that differ by less than this share are of one step.
ALIKE = 0.1
#: A crosshead stands where it has not moved for so many samples: between steps of one as slow it rests less.
STANDING = 4
#: Time steps that differ by less than this share of their median count as equal.
EQUAL_STEP = 0.01
#: Steps whose median a step is compared with: the first step of a new rate sees five of its own nine.
AROUND = 9
#: A regular clock keeps its step to this factor (time stamps are printed with more digits than that) ...
REGULAR = 1.0 + 1e-4
#: ... but for this part of its steps, which are gaps and event rows.
IRREGULAR_SHARE = 0.05
#: Of any other clock a step is a gap that is so many medians long, an event row one as many times shorter.
GAP = 10.0


def quantum(values: FloatArray, *, fewest: int = 1) -> float:
    """Step of a quantised signal, in its unit; 0 where values hardly repeat, or small changes differ.

    ``fewest``: changes that show one.
    """
    steps = np.abs(np.diff(values))
    changes = int(np.count_nonzero(steps))
    if not 0 < changes <= (1.0 - QUANTISED_SHARE) * steps.size:
        return 0.0
    moved = _steps_of_their_own(steps)
    if moved.size < max(fewest, 1):
        return 0.0
    count = min(max(1, changes // 10), moved.size)
    smallest = np.partition(moved, count - 1)[:count]
    step = float(np.median(smallest))
    # a crosshead that brakes to a standstill moves by less and less: no two changes are equal
    alike = np.abs(smallest - step) <= ALIKE * step
    return step if 2 * int(alike.sum()) >= count else 0.0


def _steps_of_their_own(steps: FloatArray) -> FloatArray:
    """Steps above 0, without those inside a straight ramp and at its corners, which are the speed's."""
    padded = np.pad(steps, STANDING)
    windows = sliding_window_view(padded, STANDING)
    stood, stands = windows[: steps.size].max(axis=1) == 0.0, windows[STANDING + 1 :].max(axis=1) == 0.0
    before, after = padded[STANDING - 1 : -STANDING - 1], padded[STANDING + 1 : padded.size - STANDING + 1]
    inside = (np.abs(before - steps) <= ALIKE * steps) & (np.abs(after - steps) <= ALIKE * steps)
    corner = (stood & (after > 0.0)) | (stands & (before > 0.0))
    return np.asarray(steps[(steps > 0.0) & ~inside & ~corner])


def robust_sd(values: FloatArray) -> float:
    """Standard deviation of normal values about 0, by their median size."""
    return NORMAL_SD_OVER_MEDIAN * float(np.median(np.abs(values)))


def off_chords(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values off the lines between their neighbours, (n - 2,), and the shares of these lines passed there."""
    step = np.diff(time_s)
    span = step[:-1] + step[1:]
    share = np.divide(step[:-1], span, out=np.full(span.size, 0.5), where=span > 0.0)
    return values[1:-1] - values[:-2] * (1.0 - share) - values[2:] * share, share


def white_noise_sd(time_s: FloatArray, values: FloatArray, *, fewest: int = 1) -> float:
    """Standard deviation of the white part of a signal's noise, in its unit; 0 below three samples.

    ``fewest``: changes that show the step of a quantised signal.
    """
    if values.size < 3:
        return 0.0
    off, share = off_chords(time_s, values)
    off /= np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
    estimates = [robust_sd(off)]
    step = np.diff(time_s)
    typical = np.median(step)
    if values.size >= 12 and float(np.mean(np.abs(step - typical) <= EQUAL_STEP * typical)) > 0.9:
        # few samples on a curved ramp: the fourth difference is blind to a cubic
        estimates.append(robust_sd(np.diff(values, n=4) / np.sqrt(FOURTH_DIFFERENCE_VARIANCE)))
    return max(min(estimates), quantum(values, fewest=fewest) / float(np.sqrt(12.0)))


#: A spike stands off the line between its neighbours by so many noise sd ...
SPIKE_SD = 8.0
#: ... and by so many times the steps that lead to it and away from it: the peak of a ramp does not.
SPIKE_STEPS = 4.0
#: Samples of the running median; up to two neighbouring outliers are passed over.
MEDIAN_SAMPLES = 5


def without_spikes(values: FloatArray, *, noise: float) -> FloatArray:
    """The values (n,) with single spikes replaced by the mean of their neighbours; noise in their unit."""
    if values.size < 5:
        return values
    before, here, after = values[1:-3], values[2:-2], values[3:-1]
    off = np.abs(here - 0.5 * (before + after))
    steps = np.maximum(np.abs(before - values[:-4]), np.abs(values[4:] - after))
    apart = np.abs(after - before)
    spikes = (off > SPIKE_SD * noise) & (off > SPIKE_STEPS * np.maximum(steps, apart))
    if not spikes.any():
        return values
    at = np.flatnonzero(spikes) + 2
    result = values.copy()
    result[at] = 0.5 * (values[at - 1] + values[at + 1])
    return result


#: Samples that a lost signal lasts at the most, their spread over how far they are off, samples on each side
#: whose steps tell the course, and steps that they are off.
MOST_LOST, LOST_SPREAD, BESIDE, LOST_STEPS = 20, 0.05, 3, 2.5
#: Share of the force below which nothing is lost, and of the travel within which the tool moves on meanwhile.
LOST_SHARE, LOST_TRAVEL = 0.02, 0.02


def dropouts(force: FloatArray, travel: FloatArray, *, noise: float) -> NDArray[np.bool_]:
    """Samples (n,) of a force that jumps to a level and back onto its course, while the tool moves on."""
    lost = np.zeros(force.size, dtype=np.bool_)
    steps, slack = np.abs(np.diff(force)), SPIKE_SD * noise
    jumps = np.flatnonzero(steps > max(slack, LOST_SHARE * float(np.ptp(force))))
    for last, end in pairwise(jumps.tolist()):
        count, run = end - last, slice(last + 1, end + 1)
        if count > MOST_LOST or last < BESIDE or end + BESIDE >= steps.size:
            continue
        off = np.abs(_off_line(force, last, end + 1)).min()
        course = max(steps[last - BESIDE : last].max(), steps[end + 1 : end + 1 + BESIDE].max())
        goes_on = abs(force[end + 1] - force[last]) <= 2.0 * course * (count + 1) + slack
        level = np.ptp(force[run]) <= max(slack, LOST_SPREAD * off)
        moves_on = np.abs(_off_line(travel, last, end + 1)).max() <= LOST_TRAVEL * np.ptp(travel)
        lost[run] |= goes_on and level and moves_on and off > LOST_STEPS * course
    return lost


def _off_line(values: FloatArray, first: int, last: int) -> FloatArray:
    """Values between two samples off the line between them, (last - first - 1,)."""
    line = np.linspace(values[first], values[last], last - first + 1)
    return np.asarray(values[first + 1 : last] - line[1:-1])


def bridged(values: FloatArray, lost: NDArray[np.bool_]) -> FloatArray:
    """The values (n,), those that were lost on the lines between their neighbours."""
    if not lost.any():
        return values
    at = np.arange(values.size)
    return np.asarray(np.where(lost, np.interp(at, at[~lost], values[~lost]), values))


def running_median(values: FloatArray) -> FloatArray:
    """Median of :data:`MEDIAN_SAMPLES` samples about each; ends are repeated."""
    half = MEDIAN_SAMPLES // 2
    padded = np.pad(values, half, mode="edge")
    return np.asarray(np.median(sliding_window_view(padded, MEDIAN_SAMPLES), axis=1))


#: A clock is coarser than the sampling where so many rows repeat the time of the row before.
COARSE_SHARE = 0.2
#: Fewer rows show no sampling.
FEWEST_ROWS = 60
#: Rows are sampled evenly where a line leaves no tick by more than a step and this share of a tick.
EVEN_SLACK = 0.2
#: A step is two where it differs from them by less than this share of one.
STAMPED_SLACK = 0.2


def between_ticks(time_s: FloatArray) -> tuple[FloatArray, float]:
    """The times, those of rows that share a tick of a coarse clock spread up to the next, and the tick [s].

    Rows sampled evenly throughout lie on one line that stays within all ticks; where there is none, those of
    each tick are spread evenly.  Times of a clock that is fine enough stay as they are, with a tick of 0.
    """
    repeats = np.diff(time_s) == 0.0
    if time_s.size < FEWEST_ROWS or not repeats.any() or repeats.all():
        return time_s, 0.0
    if np.mean(repeats) < COARSE_SHARE:
        return _stamped_late(time_s, repeats)
    starts = np.flatnonzero(np.concatenate(([True], ~repeats)))
    count = np.diff(np.append(starts, time_s.size))
    ticks = np.diff(time_s[starts])
    shared = ticks[count[:-1] > 1]
    if shared.size < 2:
        return time_s, 0.0
    tick = float(np.median(shared))
    rows = np.arange(time_s.size)
    # the first tick and the last may be cut
    step = float(time_s[starts[-1]] - time_s[starts[1]]) / float(starts[-1] - starts[1])
    even = time_s[0] + step * rows
    even += float(np.max(time_s - even))
    # the first row of a tick may lie a step into it
    if float(np.max(even - time_s)) <= (1.0 + EVEN_SLACK) * tick + step:
        return np.asarray(even), tick
    # across a pause the rows were no slower
    reach = np.minimum(np.append(ticks, tick), tick)
    return np.asarray(time_s + (rows - np.repeat(starts, count)) * np.repeat(reach / count, count)), tick


def _stamped_late(time_s: FloatArray, repeats: NDArray[np.bool_]) -> tuple[FloatArray, float]:
    """The times, rows that repeat a stamp before two steps in one put between; one row more stays."""
    steps = np.diff(time_s)
    usual = float(np.median(steps[~repeats]))
    twice = np.abs(steps[1:] - 2.0 * usual) <= STAMPED_SLACK * usual
    at = np.flatnonzero(repeats[:-1] & twice) + 1
    if not at.size:
        return time_s, 0.0
    out = time_s.copy()
    out[at] = 0.5 * (time_s[at] + time_s[at + 1])
    return out, 2.0 * usual


def lag_one_correlation(residual: FloatArray) -> float:
    """Autocorrelation of a residual at one sample; 0 for fewer than three samples."""
    centred = np.asarray(residual) - np.mean(residual)
    power = float(centred @ centred)
    if centred.size < 3 or power == 0.0:
        return 0.0
    return float(centred[1:] @ centred[:-1]) / power


def chain_breaks(time_s: FloatArray) -> NDArray[np.bool_]:
    """Samples that start a chain of noise: the first, at gaps, event rows and repeated times, (n,)."""
    breaks = np.zeros(time_s.size, dtype=np.bool_)
    breaks[:1] = True
    step = np.diff(time_s)
    if step.size == 0 or 0.0 < float(step.max()) <= REGULAR * float(step.min()):
        return breaks
    # imported here because most clocks need no median, and a command that fits nothing never does
    from scipy.ndimage import median_filter

    median = median_filter(step, size=min(AROUND, step.size), mode="nearest")
    broken = _beyond(step, median, REGULAR)
    if broken.mean() > IRREGULAR_SHARE:
        broken = _beyond(step, median, GAP)
    breaks[1:] = broken | (step <= 0.0)
    return breaks


def _beyond(step: FloatArray, median: FloatArray, factor: float) -> NDArray[np.bool_]:
    return np.asarray((step > factor * median) | (factor * step < median))


#: A travel is read with noise that counts where it is worth more than this share of the noise of the force,
#: and the force does not follow it: by less than this share of the stiffness.
WORTH_SHARE, FOLLOWS_SHARE = 0.25, 0.5
#: Half widths of the windows a line is laid through, widest first [samples]; it is one where its halves bend
#: by at most so many standard errors, and it leaves at most so many sd of chi-square more than noise does.
HALF_WIDTHS, STRAIGHT_SD = (64, 45, 32, 22, 16, 11, 8, 5, 3, 2), 2.0
#: Second differences beyond so many sd of the noise are corners, not noise.
CORNER_SD = 6.0


def steadied(time_s: FloatArray, depth_mm: FloatArray, force_N: FloatArray, *, noise_N: float) -> FloatArray:
    """Travel (n,) of a tool on lines where it is straight, if the force knows nothing of its noise.

    A law that is driven by that noise answers to it with its stiffness, and is bent until it does not (errors
    in variables).  Each sample takes the widest window about it that noise alone keeps from being a line.
    """
    noise = white_noise_sd(time_s, depth_mm)
    stiffness = float(np.ptp(force_N)) / max(float(np.ptp(depth_mm)), 1e-300)
    if time_s.size < 5 or not stiffness * noise > WORTH_SHARE * noise_N:
        return depth_mm
    bends, answers = np.diff(depth_mm, 2), np.diff(force_N, 2)
    kept = np.abs(bends) <= CORNER_SD * np.sqrt(6.0) * noise
    if bends[kept] @ answers[kept] > FOLLOWS_SHARE * stiffness * (bends[kept] @ bends[kept]):
        return depth_mm
    lines, typical = Lines(time_s - time_s.mean(), depth_mm - depth_mm.mean()), float(depth_mm.mean())
    out, open_ = depth_mm.copy(), np.ones(depth_mm.size, dtype=np.bool_)
    for half in HALF_WIDTHS:
        at = np.flatnonzero(open_[half : depth_mm.size - half]) + half
        first, last = at - half, at + half + 1
        straight = lines.left(first, last) <= noise**2 * (2 * half - 1) * _chance(2 * half - 1)
        (before, error), (after, other) = lines.slope(first, at + 1), lines.slope(at, last)
        straight &= np.abs(after - before) <= STRAIGHT_SD * noise * np.hypot(error, other)
        out[at[straight]] = typical + lines.value(first, last, at)[straight]
        open_[at[straight]] = False
    return out


def _chance(freedom: int) -> float:
    """Chi-square over its degrees of freedom that noise alone hardly exceeds."""
    return 1.0 + STRAIGHT_SD * float(np.sqrt(2.0 / freedom))


class Lines:
    """Least squares lines through any stretch of a signal, samples first to last - 1, by running sums."""

    def __init__(self, time: FloatArray, values: FloatArray) -> None:
        self.time, t, x = time, time, values
        self.total = np.zeros((6, t.size + 1))
        np.cumsum(np.stack([np.ones(t.size), t, x, t * t, t * x, x * x]), axis=1, out=self.total[:, 1:])

    def _moments(self, first: Places, last: Places) -> tuple[FloatArray, ...]:
        """Means of time and value, slope, and squares of times and of values about their means."""
        n, t, x, tt, tx, xx = self.total[:, last] - self.total[:, first]
        spread, both = tt - t * t / n, tx - t * x / n
        # samples of one instant have no slope
        slope = np.divide(both, spread, out=np.zeros(np.shape(spread)), where=spread > 0.0)
        return t / n, x / n, slope, np.maximum(spread, 0.0), xx - x * x / n

    def slope(self, first: Places, last: Places) -> tuple[FloatArray, FloatArray]:
        """Slopes, and their standard errors for noise of one."""
        _, _, slope, spread, _ = self._moments(first, last)
        return slope, 1.0 / np.sqrt(np.maximum(spread, 1e-300))

    def value(self, first: Places, last: Places, at: Places) -> FloatArray:
        """Values of lines at samples."""
        t, x, slope, _, _ = self._moments(first, last)
        return np.asarray(x + slope * (self.time[at] - t))

    def left(self, first: Places, last: Places) -> FloatArray:
        """Sums of squares that lines leave."""
        _, _, slope, spread, squares = self._moments(first, last)
        return np.asarray(squares - slope * slope * spread)
