"""Tell a displacement that the machine was told from one that it did.

A commanded displacement lies on straight lines that meet in perfect corners, and a fit of it takes the lag
and the rounding of the real motion for tissue.  It is suspected where all of this holds:

* the samples are regularly spaced, at most :data:`LONGEST_INTERVAL_S` apart;
* outside the corners the displacement is straight to the last printed digit, over the whole recording;
* every corner is over within two intervals, and at least one is so strong that a crosshead that stops in
  :data:`SHORTEST_STOP_S` would have been seen to round it;
* the force beside it is noisy: the recording is a measurement, not a computation.

A channel that is coarser than its print (an encoder's steps) is not straight to the last digit; one that is
printed so coarsely that no rounding could be seen fails the third rule.  Neither is suspected.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.ingest.levels import is_noisy

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
    return Flag(
        "commanded_displacement",
        f"displacement is straight to its last digit ({digit:.0e} mm); {fastest:.3g} mm/s change within"
        f" {SHARP_BEND * step_s:.3g} s",
        {
            "corners": count,
            "speed_change_mm_s": fastest,
            "within_s": SHARP_BEND * step_s,
            "last_digit_mm": digit,
            "off_line_mm": worst,
        },
    )


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
