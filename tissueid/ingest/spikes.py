"""Single samples far off their neighbours: glitches of a converter or a cable, typing errors.

A corner, a step, a rupture or the ringing of a stop is no spike: without the sample in question the channel
must go on smoothly, and for the force the machine must move evenly around it.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag

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
AT_MOST = 0.005
#: Corners and changes of the sampling look like spikes at first sight; so many are judged in any recording.
FEW_CANDIDATES = 40
_NORMAL_SD_OVER_MEDIAN = 1.4826
#: Standard deviation of a sample's distance from the mean of its neighbours, over that of the sample.
_CHORD_SD = 1.5**0.5
_SAMPLED = 20_000


def spike(time_s: FloatArray, displacement_mm: FloatArray, force_N: FloatArray) -> Flag | None:
    """Samples of displacement or force that stand alone, with the largest of them."""
    found: list[tuple[str, str, list[tuple[int, float]], FloatArray]] = []
    for name, unit, channel in (("displacement", "mm", displacement_mm), ("force", "N", force_N)):
        motion = displacement_mm if name == "force" else None
        alone = _alone(time_s, channel, motion)
        if alone:
            found.append((name, unit, alone, channel))
    if not found:
        return None
    parts: list[str] = []
    values: dict[str, float] = {}
    for name, unit, alone, _ in found:
        at, off = max(alone, key=lambda one: abs(one[1]))
        first = min(i for i, _ in alone)
        when = f" at {time_s[at]:g} s" if len(found) == 1 else ""
        parts.append(f"{len(alone)} of the {name}, by {abs(off):.3g} {unit}{when}")
        values |= {
            f"{name}_count": float(len(alone)),
            f"{name}_first_s": float(time_s[first]),
            f"{name}_largest_s": float(time_s[at]),
            f"{name}_off_{'mm' if name == 'displacement' else 'N'}": off,
        }
    return Flag("spike", f"samples far off their neighbours: {'; '.join(parts)}", values)


def _alone(time_s: FloatArray, values: FloatArray, motion: FloatArray | None) -> list[tuple[int, float]]:
    """Samples off the line between their neighbours, each with its distance."""
    span = float(np.ptp(values))
    if values.size < 2 * REACH or span == 0.0:
        return []
    off = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    sampled = np.abs(off[:: max(1, off.size // _SAMPLED)])
    noise = _NORMAL_SD_OVER_MEDIAN * float(np.median(sampled)) / _CHORD_SD
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
    steps = np.diff(t)
    if (steps <= 0.0).any():
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
    share = steps[:-1] / (steps[:-1] + steps[1:])
    rest = np.abs(y[1:-1] - (1.0 - share) * y[:-2] - share * y[2:])
    noise = _NORMAL_SD_OVER_MEDIAN * float(np.median(np.delete(rest, k - 1))) / _CHORD_SD
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
