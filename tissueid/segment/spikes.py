"""Single samples that stand far off their neighbours: taken out, or passed over by a running median."""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray

#: A spike stands off the line between its neighbours by so many noise sd ...
SPIKE_SD = 8.0
#: ... and by so many times the steps that lead to it and away from it: the peak of a ramp does not.
SPIKE_STEPS = 4.0
#: Samples of the running median; up to two neighbouring outliers are passed over.
MEDIAN_SAMPLES = 5


def without_spikes(values: FloatArray, *, noise: float) -> FloatArray:
    """The values with each single spike replaced by the mean of its neighbours.

    ``values`` (n,); ``noise``: standard deviation of the white noise, in the unit of the values.  Returns
    (n,), the values themselves where there is no spike.
    """
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


def running_median(values: FloatArray) -> FloatArray:
    """Median of :data:`MEDIAN_SAMPLES` samples about each; ends are repeated.

    ``values`` (n,).  Returns (n,).
    """
    half = MEDIAN_SAMPLES // 2
    padded = np.pad(values, half, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, MEDIAN_SAMPLES)
    result: FloatArray = np.median(windows, axis=1)
    return result
