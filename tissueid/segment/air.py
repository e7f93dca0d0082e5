"""Drift of the load cell while the tool is in air: the force changes though nothing is touched.

The samples in air are averaged in blocks, whose scatter about a straight line tells how sure its slope is,
whatever the noise is correlated like.  A first touch that was found late bends the line at its end; drift
shows in the first half alone as well.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.trial import Contact, Phase

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
    """``baseline_drift``, where the force drifts in air by what would matter later.

    ``time_s``, ``force_N`` (n,).
    """
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
    return (
        Flag(
            "baseline_drift",
            f"force drifts by {slope:.3g} N/s in air: {slope * rest:.3g} N by the end, of {largest:.3g} N",
            {
                "slope_N_per_s": slope,
                "slope_sd_N_per_s": error,
                "in_air_s": float(time[-1] - time[0]),
                "by_the_end_N": slope * rest,
                "largest_N": largest,
            },
        ),
    )


def _line(time_s: FloatArray, force_N: FloatArray) -> tuple[float, float]:
    """Slope of the block means over time [N/s], and its standard error."""
    t, f = (
        np.array([part.mean() for part in np.array_split(values, BLOCKS)]) for values in (time_s, force_N)
    )
    off = t - t.mean()
    spread = float(off @ off)
    slope = float(off @ f) / spread
    rest = f - f.mean() - slope * off
    return slope, float(np.sqrt(rest @ rest / (BLOCKS - 2) / spread))
