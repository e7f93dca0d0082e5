"""Quality of a recording's numbers at first sight, each remark with its numbers; nothing is removed."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.digits import clock_start
from tissueid.flags import Flag
from tissueid.ingest.broken_rows import WHOLE_FROM, jump
from tissueid.ingest.header import stated
from tissueid.signal_noise import bridged, dropouts, off_chords, quantum, robust_sd, white_noise_sd

_FEW_LEVELS = 64
_SAMPLES_PER_LEVEL = 10
_REPEATED_SHARE = 0.8
_CLIPPED_RUN = 5
#: A clipped stretch is so many times longer than any other standstill of a force at work.
_CLIPPED_LONGER = 4
#: Share of the peak above which a force is at work.
_AT_WORK = 0.5
#: Steps over the test below which the resolution is said: a channel must be read to 1 % of its value to be
#: calibrated at all (ISO 7500-1 and ISO 9513, class 2, resolution at the lower limit of a range).
FEWEST_STEPS = 100
#: Rows from which the resolution of a channel can be told.
_RESOLUTION_FROM = 50
#: Places where a value repeats, as a share of all changes, from which repeating is the channel's nature.
_REPEATS_EVERYWHERE = 0.15
#: Second differences of white noise change their sign in 73 % of all places, those of a smooth curve hardly.
_NOISY_SHARE = 0.25
#: A noisy channel repeats its value in less than this share of all places.
_NOISY_REPEATS = 0.5
#: Differences between levels are whole steps within this share of a step (rounding of decimals).
_GRID_TOLERANCE = 0.01


def no_decimals(*channels: FloatArray) -> Flag | None:
    """Whole numbers in every row of every channel."""
    # the first rows rule most recordings out
    parts = [values[:WHOLE_FROM] for values in channels]
    if channels[0].size < WHOLE_FROM or any((values % 1.0).any() for values in (*parts, *channels)):
        return None
    message = f"time, displacement and force are whole numbers in all {channels[0].size} rows"
    return Flag("no_decimals", message, {"count": int(channels[0].size)})


def force_levels(displacement_mm: FloatArray, force_N: FloatArray) -> Flag | None:
    """``quantised_force`` or ``clipped_force``, where one of them holds."""
    repeats: NDArray[np.bool_] = np.diff(force_N) == 0.0
    # a force at the end of its range repeats however fine its steps are
    within = (force_N > force_N.min()) & (force_N < force_N.max())
    share = float(np.mean(repeats[within[1:]])) if within[1:].any() else float(np.mean(repeats))
    levels = np.unique(force_N) if share >= _REPEATED_SHARE else np.empty(0)
    if not 1 < levels.size <= _FEW_LEVELS or force_N.size < _SAMPLES_PER_LEVEL * levels.size:
        return _clipped(displacement_mm, force_N, repeats)
    count, step = int(levels.size), float(np.diff(levels).min())
    message = f"the force has {count} levels, {step:.3g} N apart; {share:.0%} of samples repeat the last"
    values = {"levels": count, "repeated_fraction": share, "step_N": step}
    return Flag("quantised_force", message, values)


def is_noisy(values: FloatArray) -> bool:
    """True where a channel varies from sample to sample as a measured one does, a computed one not."""
    if values.size < _CLIPPED_RUN or float(np.mean(np.diff(values) == 0.0)) >= _NOISY_REPEATS:
        return False
    bend = np.diff(values, n=2)
    rounding = 1e-9 * float(np.ptp(values))
    turns = (bend[:-1] * bend[1:] < 0.0) & (np.abs(bend[1:]) > rounding)
    return float(np.mean(turns)) >= _NOISY_SHARE


def _runs(repeats: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First samples and lengths of the stretches in which a value stands."""
    starts = np.concatenate(([0], np.flatnonzero(~repeats) + 1))
    return starts, np.diff(np.concatenate((starts, [repeats.size + 1])))


def _clipped(displacement_mm: FloatArray, force_N: FloatArray, repeats: NDArray[np.bool_]) -> Flag | None:
    """The force stands at its largest value to the last digit, far longer than it stands anywhere else."""
    peak = float(max(force_N.max(), -force_N.min()))
    if peak == 0.0 or not repeats.any():
        return None
    starts, lengths = _runs(repeats)
    level = force_N[starts]
    # the zero of a load cell is set by hand: its two limits need not be equally far
    limits = [end for end in (float(force_N.max()), float(force_N.min())) if abs(end) >= _AT_WORK * peak]
    at_limit = np.isin(level, limits)
    usual = int(lengths[(np.abs(level) >= _AT_WORK * peak) & ~at_limit].max(initial=1))
    long = at_limit & (lengths >= max(_CLIPPED_RUN, _CLIPPED_LONGER * usual))
    if not long.any():
        return None
    first = int(np.argmax(np.where(long, lengths, 0)))
    start, count = int(starts[first]), int(lengths[first])
    total = int(lengths[level == level[first]].sum())
    moves = int(np.count_nonzero(np.diff(displacement_mm[start : start + count]))) >= _CLIPPED_RUN - 1
    # a computed force stands still in a hold; a measured one does not
    if not moves and not is_noisy(np.concatenate((force_N[:start], force_N[start + count :]))):
        return None
    limit, while_moving = float(force_N[start]), " while the tool moves" if moves else ""
    message = f"the force stands at {limit:g} N for {count} samples{while_moving}, elsewhere for {usual}"
    values = {"force_N": limit, "samples": count, "samples_in_all": total, "usual_samples": usual}
    return Flag("clipped_force", message, values)


def below_resolution(displacement_mm: FloatArray, force_N: FloatArray) -> Flag | None:
    """A channel that goes through few of its own steps in the whole test."""
    found = []
    values: dict[str, float] = {}
    for name, unit, channel in (("displacement", "mm", displacement_mm), ("force", "N", force_N)):
        step = resolution_step(channel)
        if step is None:
            continue
        steps = round(float(np.ptp(channel)) / step)
        found.append(f"{name} has {steps} steps of {step:.3g} {unit}")
        values |= {f"{name}_steps": float(steps), f"step_{name}_{unit}": step}
    message = f"{', '.join(found)}; {FEWEST_STEPS} are needed"
    return Flag("below_resolution", message, values) if found else None


def resolution_step(values: FloatArray) -> float | None:
    """Step of a channel that has fewer than :data:`FEWEST_STEPS` of them; ``None`` for a finer channel."""
    some = values[:: max(1, values.size // 2000)]
    if values.size < _RESOLUTION_FROM or np.unique(some).size > FEWEST_STEPS:
        return None
    levels = np.unique(values)
    if not 2 < levels.size <= FEWEST_STEPS or values.size < 2 * levels.size:
        return None
    apart = np.diff(levels)
    step = float(apart.min())
    whole = apart / step
    uneven = (np.abs(whole - np.rint(whole)) > _GRID_TOLERANCE).any()
    if uneven or levels[-1] - levels[0] >= FEWEST_STEPS * step:
        return None
    _, lengths = _runs(np.diff(values) == 0.0)
    # a ramp without noise goes through equally spaced values too, but never stands at them
    return step if float(np.mean(lengths > 1)) >= _REPEATS_EVERYWHERE else None


#: A spike is this many standard deviations of the noise around it off its neighbours: of 90,000 normal
#: values none is beyond 5, and of noise with heavy tails few.
FAR_SD = 10.0
#: ... and this share of the channel's range: what is smaller changes no result.
FAR_SHARE = 0.02
#: The neighbours go on as before within this share of the spike.
SMOOTH_SHARE = 0.2
#: Samples on each side that tell the noise.
REACH = 12
#: The machine moves evenly this long on each side: a crosshead takes up to 0.3 s to stop [s].
EVEN_S = 0.3
EVEN_SAMPLES = (6, 400)
#: An even motion leaves its straight line by at most this share of the travel around the sample, or of the
#: whole travel (noise of a standing crosshead).
EVEN_SHARE, STANDING_SHARE = 0.02, 1e-3
#: More than this share of all samples are no single samples but the noise itself.
AT_MOST = 0.02
#: Corners and changes of the sampling look like spikes at first sight; so many are judged in any recording.
FEW_CANDIDATES = 40
#: Standard deviation of a sample's distance from the mean of its neighbours, over that of the sample.
_CHORD_SD = 1.5**0.5
_SAMPLED = 20_000


def spike(time_s: FloatArray, displacement_mm: FloatArray, force_N: FloatArray) -> Flag | None:
    """Samples that stand alone, and dropouts of the force, with the largest of them."""
    lost = dropouts(force_N, displacement_mm, noise=white_noise_sd(time_s, force_N))
    off_N = force_N - bridged(force_N, lost)
    force = [one for one in _alone(time_s, force_N, displacement_mm) if not lost[one[0]]]
    by_channel = (
        ("displacement", "mm", _alone(time_s, displacement_mm, None)),
        ("force", "N", [*force, *((i, float(off_N[i])) for i in np.flatnonzero(lost).tolist())]),
    )
    found = [(name, unit, alone) for name, unit, alone in by_channel if alone]
    if not found:
        return None
    parts: list[str] = []
    values: dict[str, float] = {}
    for name, unit, alone in found:
        at, off = max(alone, key=lambda one: abs(one[1]))
        first = min(i for i, _ in alone)
        when = f" at {time_s[at] - clock_start(time_s[0]):g} s" if len(found) == 1 else ""
        parts.append(f"{len(alone)} of the {name}, by {abs(off):.3g} {unit}{when}")
        values |= {
            f"{name}_count": float(len(alone)),
            f"{name}_first_s": float(time_s[first]),
            f"{name}_largest_s": float(time_s[at]),
            f"{name}_off_{unit}": off,
        }
    return Flag("spike", f"samples far off their neighbours: {'; '.join(parts)}", values)


def _alone(time_s: FloatArray, values: FloatArray, motion: FloatArray | None) -> list[tuple[int, float]]:
    """Samples off the line between their neighbours, each with its distance."""
    span = float(np.ptp(values))
    if values.size < 2 * REACH or span == 0.0:
        return []
    off = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    noise = robust_sd(off[:: max(1, off.size // _SAMPLED)]) / _CHORD_SD
    np.abs(off, out=off)
    candidates = np.flatnonzero(off > max(FAR_SHARE * span, FAR_SD * noise)) + 1
    # a spike lifts its two neighbours' distances as well
    if candidates.size > max(FEW_CANDIDATES, 3 * AT_MOST * values.size):
        return []
    judged = ((i, _distance(time_s, values, i, FAR_SHARE * span)) for i in candidates.tolist())
    alone = [
        (i, off) for i, off in judged if off is not None and (motion is None or _even(time_s, motion, i))
    ]
    return alone if len(alone) <= max(1.0, AT_MOST * values.size) else []


def _distance(time_s: FloatArray, values: FloatArray, i: int, least: float) -> float | None:
    """Distance of a sample from its neighbours on both sides; ``None`` where the channel does not go on."""
    low, high = max(0, i - REACH), min(values.size, i + REACH + 1)
    if i - low < 3 or high - i < 4:
        return None
    t, y, k = time_s[low:high] - time_s[i], values[low:high].copy(), i - low
    if (np.diff(t) <= 0.0).any():
        return None

    def at(one: int, other: int) -> float:
        return float(y[one] - t[one] * (y[other] - y[one]) / (t[other] - t[one]))

    here = float(y[k])
    offs = np.array([here - at(k - 1, k + 1), here - at(k - 2, k - 1), here - at(k + 1, k + 2)])
    off = float(offs[np.argmin(np.abs(offs))])
    if abs(off) < least or abs(offs.sum()) < np.abs(offs).sum():
        return None
    # the sample replaced by its neighbours' word: is the rest smooth?
    y[k] = at(k - 1, k + 1)
    rest = np.abs(off_chords(t, y)[0])
    noise = robust_sd(np.delete(rest, k - 1)) / _CHORD_SD
    quiet = float(rest.max()) <= SMOOTH_SHARE * abs(off) and abs(off) > FAR_SD * noise
    return off if quiet else None


def _even(time_s: FloatArray, displacement_mm: FloatArray, i: int) -> bool:
    """True where the machine keeps its speed around a sample."""
    few, many = EVEN_SAMPLES
    low = min(max(int(np.searchsorted(time_s, time_s[i] - EVEN_S)), i - many), i - few)
    high = max(min(int(np.searchsorted(time_s, time_s[i] + EVEN_S)), i + many), i + few)
    low, high = max(low, 0), min(high, time_s.size - 1)
    t, x = time_s[low : high + 1] - time_s[low], displacement_mm[low : high + 1]
    line = x[0] + (x[-1] - x[0]) * t / t[-1]
    distance = np.abs(x - line)
    reach = max(EVEN_SHARE * abs(float(x[-1] - x[0])), STANDING_SHARE * float(np.ptp(displacement_mm)))
    return float(np.percentile(distance, 90)) <= reach


# A commanded displacement lies on straight lines that meet in perfect corners, and a fit of it takes the lag
# and the rounding of the real motion for tissue.  It is suspected where the samples are regularly spaced, the
# displacement is straight to its last printed digit outside the corners, every corner is over within two
# intervals, one is so strong that a real stop would have been seen to round it, and the force is noisy.
#: A crosshead takes 50 to 300 ms to stop [s].
SHORTEST_STOP_S = 0.05
#: Slower sampling does not see a stop [s].
LONGEST_INTERVAL_S = SHORTEST_STOP_S / 2.0
#: Corners are looked at in intervals of about this length [s]: of shorter ones rounding hides the bend.
CORNER_INTERVAL_S = SHORTEST_STOP_S / 4.0
#: A second difference of rounded numbers on a line is at most two last digits.
STRAIGHT_DIGITS = 2.0
#: ... of a curve: a bend of more digits than this is seen, whatever the rounding does.
SEEN_DIGITS = 3.0
#: A sharp corner bends two second differences at the most.
SHARP_BEND = 2
#: Share of the samples outside corners.
MOSTLY_STRAIGHT = 0.9
#: Positions of the samples against the stop that are tried.
ALIGNMENTS = 8
FEWEST_SAMPLES = 40
MOST_DECIMALS = 9
#: Intervals that agree with their median within this share are regular; so many must.
REGULAR_WITHIN, REGULAR_SHARE = 0.05, 0.97
#: Samples from which a stretch between corners shows a line.
STRETCH = 6
_EVENT_SHARE = 0.25
#: Samples of a stretch, and stretches, by which a long channel is judged.
LOOKED_AT, STRETCHES_LOOKED_AT = 4096, 8


def commanded_displacement(
    time_s: FloatArray, displacement_mm: FloatArray, force_N: FloatArray
) -> Flag | None:
    """``commanded_displacement``, where all rules above hold."""
    if time_s.size < FEWEST_SAMPLES or float(np.ptp(displacement_mm)) == 0.0 or not _is_noisy(force_N):
        return None
    step_s, x = _regular(time_s, displacement_mm)
    if x is None or not 0.0 < step_s <= LONGEST_INTERVAL_S:
        return None
    stride = max(1, round(CORNER_INTERVAL_S / step_s))
    x, step_s = x[::stride], step_s * stride
    digit = _last_digit(x)
    if digit is None or x.size < FEWEST_SAMPLES:
        return None
    bend = np.diff(x, n=2)
    bent = np.abs(bend) > STRAIGHT_DIGITS * digit * (1.0 + 1e-6)
    if float(np.mean(bent)) > 1.0 - MOSTLY_STRAIGHT or not bent.any():
        return None
    first, last = _stretches(bent)
    if (last - first >= SHARP_BEND).any():
        return None
    change = np.array([bend[i : j + 1].sum() for i, j in zip(first, last, strict=True)]) / step_s
    seen = np.abs(change) * step_s * _third_bend(step_s) > SEEN_DIGITS * digit
    worst = _off_line(x, first, last)
    if not seen.any() or worst > digit:
        return None
    count = int(np.count_nonzero(seen))
    fastest = float(np.abs(change).max())
    within = SHARP_BEND * step_s
    message = (
        f"displacement is straight to its last digit ({digit:.0e} mm); {fastest:.3g} mm/s change within"
        f" {within:.3g} s"
    )
    values = {"corners": count, "speed_change_mm_s": fastest, "within_s": within, "last_digit_mm": digit}
    return Flag("commanded_displacement", message, values | {"off_line_mm": worst})


def _is_noisy(force_N: FloatArray) -> bool:
    """The nature of a long channel is told by stretches of it."""
    starts = np.linspace(0, force_N.size - LOOKED_AT, STRETCHES_LOOKED_AT, dtype=np.intp)
    if force_N.size <= LOOKED_AT * STRETCHES_LOOKED_AT:
        return is_noisy(force_N)
    return is_noisy(np.concatenate([force_N[start : start + LOOKED_AT] for start in starts]))


def _third_bend(step_s: float) -> float:
    """Third largest second difference of a smooth stop, as a share of their sum, wherever it is sampled.

    With three bends in a row the stop is no sharp corner.  The speed falls with the curve of a raised
    cosine over :data:`SHORTEST_STOP_S`, which has the sharpest middle of the usual ones.
    """
    least = 1.0
    for shift in np.linspace(0.0, step_s, ALIGNMENTS, endpoint=False):
        time = shift + step_s * np.arange(-2, round(SHORTEST_STOP_S / step_s) + 4)
        phase = np.clip(time / SHORTEST_STOP_S, 0.0, 1.0)
        ramp = SHORTEST_STOP_S * (phase**2 / 2.0 + (np.cos(2.0 * np.pi * phase) - 1.0) / (4.0 * np.pi**2))
        travel = ramp + np.maximum(time - SHORTEST_STOP_S, 0.0)
        least = min(least, float(np.sort(np.diff(travel, n=2))[-3]) / step_s)
    return least


def _regular(time_s: FloatArray, x: FloatArray) -> tuple[float, FloatArray | None]:
    """Sampling interval and the displacement without event rows; ``None`` where sampling is not regular."""
    dt = np.diff(time_s)
    usual = float(np.median(dt[:: dt.size // LOOKED_AT + 1]))
    if float(dt.min()) < _EVENT_SHARE * usual:
        keep = np.concatenate(([True], dt >= _EVENT_SHARE * usual))
        dt, x = np.diff(time_s[keep]), x[keep]
    regular = float(np.mean(np.abs(dt - usual) <= REGULAR_WITHIN * usual))
    return usual, x if regular >= REGULAR_SHARE else None


def _are_whole(x: FloatArray, decimals: int) -> bool:
    scaled = x * 10.0**decimals
    return bool((np.abs(scaled - np.rint(scaled)) <= 1e-6 * np.maximum(1.0, np.abs(scaled) * 1e-6)).all())


def _last_digit(x: FloatArray) -> float | None:
    """The last printed digit [mm]: all values are whole multiples of it."""
    for decimals in range(MOST_DECIMALS + 1):
        # a few samples rule most out, so that all of them are seldom looked at
        if _are_whole(x[:: x.size // FEWEST_SAMPLES + 1], decimals) and _are_whole(x, decimals):
            return float(10.0**-decimals)
    # a computed displacement is straight to the rounding of its arithmetic
    return 1e-9 * float(np.ptp(x))


def _stretches(bent: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last second difference of every bend."""
    edges = np.diff(np.concatenate(([False], bent, [False])).astype(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1


def _off_line(x: FloatArray, first: NDArray[np.intp], last: NDArray[np.intp]) -> float:
    """Largest distance of a sample from the line of its stretch between two corners [mm]."""
    # the second difference i spans samples i to i + 2
    starts = np.concatenate(([0], last + 1))
    stops = np.concatenate((first + 2, [x.size]))
    worst = 0.0
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        if stop - start < STRETCH:
            continue
        # least squares about the middle, where slope and level do not know each other
        index = np.arange(stop - start, dtype=np.float64) - 0.5 * (stop - start - 1)
        off = x[start:stop] - float(x[start:stop].mean())
        off -= index * (float(index @ off) / float(index @ index))
        worst = max(worst, float(np.abs(off, out=off).max()))
    return worst


#: An event row stands nearer to its neighbour than this part of the intervals around it.
_EVENT_FRACTION = 0.25
#: Event rows mark segment changes; were they more than this part of all rows they would be the sampling.
_EVENTS_AT_MOST = 0.05
#: A gap is this many times longer than the intervals around it.
_GAP_FACTOR = 10.0
_GAP_NEIGHBOURS = 5
#: Gaps that are more than this part of all intervals are the sampling itself (bursts with pauses).
_GAPS_AT_MOST = 0.02
#: So few long intervals are gaps in any recording.
_GAPS_ALWAYS = 3


def zero_dt(time_s: FloatArray, dt: FloatArray, tick_s: float = 0.0) -> Flag | None:
    """Rows that repeat the time of the row before; ``tick_s``: of a clock, where they are spread between."""
    at = np.flatnonzero(dt == 0.0)
    if not at.size:
        return None
    first = float(time_s[at[0]])
    message = (
        f"{at.size} rows repeat the time of the row before, first at {first - clock_start(time_s[0]):g} s"
    )
    values = {"count": int(at.size), "first_s": first}
    if tick_s > 0.0:
        message = f"{at.size} rows share a tick of the clock, {tick_s:g} s: spread evenly between ticks"
        values["tick_s"] = tick_s
    return Flag("zero_dt", message, values)


def event_rows(time_s: FloatArray, dt: FloatArray) -> Flag | None:
    """Extra samples close beside their neighbours, as written at segment changes."""
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
    shown_s = first - clock_start(time_s[0])
    message = f"{at.size} extra samples stand close beside their neighbours, first at {shown_s:g} s, down to"
    values = {"count": int(at.size), "first_s": first, "least_interval_s": least}
    return Flag("event_rows", f"{message} {least:.3g} s", values)


def gap(time_s: FloatArray, dt: FloatArray, force_N: FloatArray) -> Flag | None:
    """Stretches without samples, and how far the force went meanwhile."""
    if dt.size < 2 * _GAP_NEIGHBOURS + 1:
        return None
    gaps = [i for i in _long_intervals(dt).tolist() if _is_gap(dt, i)]
    if not gaps or len(gaps) > max(_GAPS_ALWAYS, _GAPS_AT_MOST * dt.size):
        return None
    longest = max(gaps, key=lambda i: dt[i])
    around = dt[max(longest - _GAP_NEIGHBOURS, 0) : longest + _GAP_NEIGHBOURS + 1]
    usual = float(np.median(around))
    change = max((float(force_N[i + 1] - force_N[i]) for i in gaps), key=abs)
    shown_s = time_s[longest] - clock_start(time_s[0])
    count = "1 gap" if len(gaps) == 1 else f"{len(gaps)} gaps"
    return Flag(
        "gap",
        f"{count}, the longest of {dt[longest]:.3g} s at {shown_s:g} s; force moves"
        f" {abs(change):.3g} N unseen",
        {
            "count": len(gaps),
            "longest_s": float(dt[longest]),
            "at_s": float(time_s[longest]),
            "usual_interval_s": usual,
            "force_change_N": change,
            "missing_s": float(sum(dt[i] for i in gaps)),
        },
    )


def _long_intervals(dt: FloatArray) -> NDArray[np.intp]:
    """Candidates, cheaply: long against the shorter of the two intervals on either side."""
    before = np.minimum(dt[1:-3], dt[:-4])
    after = np.minimum(dt[3:-1], dt[4:])
    inner = dt[2:-2] > _GAP_FACTOR * np.maximum(before, after)
    # near the ends fewer neighbours decide, in the exact test
    ends = np.array([1, dt.size - 2], dtype=np.intp)
    return np.unique(np.concatenate((np.flatnonzero(inner) + 2, ends)))


def _is_gap(dt: FloatArray, i: int) -> bool:
    """Long against both sides, so that the step from fast to slow sampling is none."""
    before, after = dt[max(i - _GAP_NEIGHBOURS, 0) : i], dt[i + 1 : i + 1 + _GAP_NEIGHBOURS]
    return all(
        side.size > 0 and dt[i] > _GAP_FACTOR * float(np.median(side)) > 0.0 for side in (before, after)
    )


#: Share of its capacity from which a load cell is taken as verified where nobody says: certificates reach
#: down to 1/100, some to 1/250 or 1/1000.
UNSTATED_RANGE = 0.01

_CELL = r"(?:load cell|force (?:transducer|sensor|cell)|kraft(?:aufnehmer|sensor|messdose)|capteur de force"
_CELL += r"|cellule de charge|celula de carga|cella di carico|czujnik sily|力传感器|载荷传感器)"
_SIZE = r"(?:capacity|rated capacity|rating|range|full scale|nominal (?:force|load)|maximum (?:force|load)"
_SIZE += r"|nennkraft|nennlast|messbereich|capacite|etendue|capacidad|capacita|zakres|量程|容量)"
_CAPACITY = re.compile(
    rf"(?:{_CELL} )?(?:{_CELL} {_SIZE}|{_SIZE} (?:of |de |du |der |della )?{_CELL})|{_CELL}"
)


def capacity_in(metadata: Mapping[str, str], *, decimal: str | None) -> float | None:
    """Capacity of the load cell [N], where the header states it with a unit."""
    return stated(metadata, _CAPACITY, "force", decimal or ".")


def below_cell_range(
    force_N: FloatArray, capacity_N: float | None, *, verified_from_N: float | None = None
) -> Flag | None:
    """``below_cell_range``, where the largest force is below the verified range."""
    if verified_from_N is None and capacity_N is None:
        return None
    lowest = UNSTATED_RANGE * (capacity_N or 0.0) if verified_from_N is None else verified_from_N
    # the zero of a load cell is arbitrary: what counts is how far the force goes from where it began
    largest = float(np.abs(force_N - force_N[0]).max())
    if not 0.0 < largest < lowest:
        return None
    source = "as stated" if verified_from_N is not None else f"1 % of the {capacity_N:.4g} N cell"
    values = {"largest_N": largest, "verified_from_N": lowest}
    if capacity_N is not None:
        values["capacity_N"] = capacity_N
    message = f"force changes by {largest:.3g} N, below the verified {lowest:.3g} N ({source})"
    return Flag("below_cell_range", message, values)


#: Samples on either side over which a tool stands whose force leaps, within this share of the travel and so
#: many usual steps of it.
_STANDS, _STANDS_SHARE, _STANDS_STEPS = 10, 1e-3, 6.0
#: The leap: a share of the force's range, times the steps beside it and those of its digits, and what stays.
_LEAP_SHARE, _LEAP_TIMES, _LEAP_DIGITS, _LEAP_STAYS = 0.005, 8.0, 3.0, 0.7
#: The force of a tool in air keeps within this share of its leap.
_IN_AIR = 0.2
#: Leaps that are looked at, the largest first.
_MOST_LEAPS = 50


def zeroed(time_s: FloatArray, displacement_mm: FloatArray, force_N: FloatArray) -> Flag | None:
    """``jump``, where the force leaps between two samples and stays: of a tool that stands, or is in air."""
    steps, travel = np.diff(force_N), np.abs(np.diff(displacement_mm))
    moving = travel[travel > 0.0]
    if steps.size < 2 * _STANDS or moving.size == 0:
        return None
    still = min(_STANDS_SHARE * float(np.ptp(displacement_mm)), _STANDS_STEPS * float(np.median(moving)))
    least = max(_LEAP_SHARE * float(np.ptp(force_N)), _LEAP_DIGITS * quantum(force_N))
    leaps = np.flatnonzero(np.abs(steps) >= least)
    for at in leaps[np.argsort(-np.abs(steps[leaps]))][:_MOST_LEAPS].tolist():
        before, after = slice(max(at + 1 - _STANDS, 0), at + 1), slice(at + 1, at + 1 + _STANDS)
        stood = displacement_mm[before.start : after.stop]
        if stood.size < 2 * _STANDS:
            continue
        meanwhile = "while the tool stands"
        if float(np.ptp(stood)) > still:
            # what has met nothing since the record began, and moves on as it did, was zeroed on its way
            if np.ptp(force_N[: at + 1]) > _IN_AIR * abs(steps[at]) or not _goes_on(stood):
                continue
            meanwhile = "while the tool moves in air"
        beside = max(float(np.abs(np.diff(force_N[side])).max()) for side in (before, after))
        stays = float(np.median(force_N[after]) - np.median(force_N[before])) / steps[at]
        if abs(steps[at]) >= _LEAP_TIMES * beside and stays >= _LEAP_STAYS:
            when = float(time_s[at]) - clock_start(time_s[0])
            words = f"the force leaps by {steps[at]:.3g} N at {when:.4g} s, {meanwhile}: zeroed?"
            return Flag("jump", words, {"leap_N": float(steps[at]), "at_s": float(time_s[at])})
    return None


def _goes_on(travelled_mm: FloatArray) -> bool:
    """True where both halves of a way agree within a factor of two, and no gap lies between them."""
    halves = np.split(travelled_mm, 2)
    first, second = (float(half[-1] - half[0]) for half in halves)
    between = float(halves[1][0] - halves[0][-1])
    return 0.5 * first**2 <= first * second <= 2.0 * first**2 and abs(between) <= 0.5 * abs(first)


def quality_flags(
    time_s: FloatArray, displacement_mm: FloatArray, force_N: FloatArray, *, capacity_N: float | None = None
) -> tuple[Flag, ...]:
    """Flags of the samples, in the order in which they are best read."""
    dt = np.diff(time_s)
    found = (
        zero_dt(time_s, dt),
        event_rows(time_s, dt),
        gap(time_s, dt, force_N),
        jump(time_s, displacement_mm, force_N) or zeroed(time_s, displacement_mm, force_N),
        force_levels(displacement_mm, force_N),
        below_resolution(displacement_mm, force_N),
        spike(time_s, displacement_mm, force_N),
        no_decimals(time_s, displacement_mm, force_N),
        commanded_displacement(time_s, displacement_mm, force_N),
        below_cell_range(force_N, capacity_N),
    )
    return tuple(flag for flag in found if flag is not None)
