"""Signs of compression and of the recorded force, and the drift of the force in air.

The samples in air are averaged in blocks, whose scatter about a straight line tells how sure its slope is,
whatever the noise is correlated like.
"""

from __future__ import annotations

import re

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.segment.motion import slope_of
from tissueid.segment.options import SegmentOptions
from tissueid.signal_noise import white_noise_sd, without_spikes
from tissueid.trial import Contact, Phase, Trial

#: The other excursion reaches this share of the dominant one: the direction is doubtful.
DOUBTFUL_EXCURSION = 0.5
#: Share of the force's own change that its change over the travel must reach to have a sign, and that on
#: the other side of the start to count.
DOUBTFUL_FORCE = 0.3
#: A tool that has let go is under this share of its first force at the most.
LET_GO = 0.05
#: Names of what is left between the tools, or above the table: it falls as the tool goes in.
_CLOSES = re.compile(
    r"gap|separation|abstand|[ée]cartement|height|h(?:ö|oe)he|hauteur|tip ?position", re.IGNORECASE
)
#: Samples that tell the first level of the force.
FIRST_SAMPLES = 5


def signs(trial: Trial, options: SegmentOptions) -> tuple[int, int, list[Flag]]:
    """Signs of compression and of force, with what is doubtful about them."""
    flags: list[Flag] = []
    x, force = trial.displacement_mm, trial.force_N
    out, back = float(x.max() - x[0]), float(x[0] - x.min())
    # a specimen that broke, or relaxed after a fast start, may carry less at its deepest: where force leaves
    # its first level to one side only, that side tells
    calm = without_spikes(force, noise=white_noise_sd(trial.time_s, force))
    level, begins_deep = float(np.median(calm[:FIRST_SAMPLES])), _begins_deep(x, calm)
    compression = options.compression_sign
    if compression is None:
        loaded = _loaded_side(x, np.abs(calm - level)) * (-1 if begins_deep else 1)
        compression = loaded or (1 if out >= back else -1)
        minor, major = sorted((out, back))
        if not loaded and major > 0.0 and minor > DOUBTFUL_EXCURSION * major:
            message = f"displacement goes {out:.4g} mm one way, {back:.4g} mm the other; the larger was taken"
            values = {"positive_mm": out, "negative_mm": back, "compression_sign": compression}
            flags.append(Flag("sign_assumed", message, values))
    depth = compression * (x - x[0])
    if begins_deep:
        depth -= depth.min()
    force_sign = options.force_sign
    # force at the deepest part against force at the start of the travel
    deep, shallow = depth >= 0.8 * depth.max(), depth <= 0.2 * depth.max()
    change = float(np.median(force[deep]) - np.median(force[shallow])) if depth.max() > 0.0 else 0.0
    if force_sign is None:
        force_sign = -1 if change < 0.0 else 1
        rise, fall = float(calm.max()) - level, level - float(calm.min())
        doubtful = abs(change) < DOUBTFUL_FORCE * float(np.ptp(force))
        if doubtful or (min(rise, fall) < DOUBTFUL_FORCE * max(rise, fall) and not begins_deep):
            force_sign = 1 if rise >= fall else -1
        if doubtful:
            reach = float(np.ptp(force))
            message = (
                f"force changes by {change:.4g} N over the travel but by {reach:.4g} N in all; "
                f"force_sign {force_sign:+d} was taken"
            )
            values = {"change_N": change, "range_N": reach, "force_sign": force_sign}
            flags.append(Flag("sign_assumed", message, values))
    stated = (trial.protocol.kind or "").lower()
    if stated.startswith("tens"):
        message = f"the file says {trial.protocol.kind!r}: the specimen is pulled"
        flags.append(Flag("tension", message, {"kind": stated}))
    elif force_sign != compression and not _CLOSES.search(trial.source.columns.get("displacement", "")):
        message = "recorded force and displacement have opposite signs: force against the travel, or tension"
        flags.append(Flag("tension", message, {"compression_sign": compression, "force_sign": force_sign}))
    return compression, force_sign, flags


def _loaded_side(x: FloatArray, changed_N: FloatArray) -> int:
    """Side of the start on which the force works, 0 where it does on both: crossheads go home through air."""
    ahead, behind = (float(changed_N[side].max(initial=0.0)) for side in (x > x[0], x < x[0]))
    if min(ahead, behind) >= DOUBTFUL_FORCE * max(ahead, behind):
        return 0
    return 1 if ahead >= behind else -1


def _begins_deep(x: FloatArray, force_N: FloatArray) -> bool:
    """True where the tool stands under a force at first, and under hardly any at its furthest."""
    way = np.abs(x - x[0])
    first, far = (
        abs(float(np.median(part))) for part in (force_N[:FIRST_SAMPLES], force_N[way >= 0.8 * way.max()])
    )
    return first > DOUBTFUL_FORCE * float(np.abs(force_N).max()) and far < LET_GO * first


#: Fewest samples in air from which a drift is told, and blocks they are averaged in.
FEWEST_SAMPLES = 48
BLOCKS = 8
#: Last share of the time in air that is left out: contact is found where it shows, not where it begins.
LAST_SHARE = 0.2
#: Standard errors of the slope that make it sure: with 6 degrees of freedom, 1 in 5,000 by chance.
SURE = 8.0
#: The first half must show at least this share of the slope.
HALF_SHARE = 0.4
#: Drift over the rest of the record is said from this share of the largest force.
SAID_SHARE = 0.02
#: A drift is slower than this share of the mean rate of loading: what is faster is a specimen at work.
LOADING_SHARE = 0.2


def drift_in_air(
    time_s: FloatArray, force_N: FloatArray, phases: tuple[Phase, ...], contact: Contact | None
) -> tuple[Flag, ...]:
    """``baseline_drift``, where the force drifts in air by what would matter later."""
    if contact is None or not contact.in_record or not phases or phases[0].kind != "approach":
        return ()
    start, stop = phases[0].start, contact.index
    end = time_s[start] + (1.0 - LAST_SHARE) * (time_s[stop] - time_s[start])
    air = slice(start, start + int(np.searchsorted(time_s[start:stop], end)))
    time, force = time_s[air], force_N[air]
    if time.size < FEWEST_SAMPLES or time[-1] <= time[0]:
        return ()
    slope, error = _line(time, force)
    half, _ = _line(time[: time.size // 2], force[: time.size // 2])
    if abs(slope) <= SURE * error or half * slope < HALF_SHARE * slope**2:
        return ()
    rest = float(time_s[-1] - 0.5 * (time[0] + time[-1]))
    loaded = np.abs(force_N - contact.baseline_N)
    largest, peak = float(loaded.max()), int(np.argmax(loaded))
    loading = largest / max(float(time_s[peak] - time_s[stop]), float(time[-1] - time[0]) / time.size)
    if abs(slope) * rest <= SAID_SHARE * largest or abs(slope) > LOADING_SHARE * loading:
        return ()
    message = f"force drifts by {slope:.3g} N/s in air: {slope * rest:.3g} N by the end, of {largest:.3g} N"
    values = {
        "slope_N_per_s": slope,
        "slope_sd_N_per_s": error,
        "in_air_s": float(time[-1] - time[0]),
        "by_the_end_N": slope * rest,
        "largest_N": largest,
    }
    return (Flag("baseline_drift", message, values),)


def _line(time_s: FloatArray, force_N: FloatArray) -> tuple[float, float]:
    """Slope of the block means over time [N/s], and its standard error."""
    t, f = (
        np.array([part.mean() for part in np.array_split(values, BLOCKS)]) for values in (time_s, force_N)
    )
    slope, spread = slope_of(t, f)
    rest = f - f.mean() - slope * (t - t.mean())
    return slope, float(np.sqrt(rest @ rest / (BLOCKS - 2) / spread))
