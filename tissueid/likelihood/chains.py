"""Where the chain of a log's noise is broken: the first sample, gaps in time, and event rows.

Between neighbouring samples of a chain the correlation of the noise is a power of its value over one
reference step.  That says nothing useful across a gap, and it is wrong at an event row: an extra sample that
machines write at a segment change, close beside its neighbours, carries the same filter output or a new one.
Both sides of an event row are broken; a few links of thousands are lost.

A step is told from the median of the steps around it, so that a change of the sampling rate breaks nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.sums import LogData

__all__ = ["chain_breaks", "linked_samples"]

FloatArray = NDArray[np.float64]

#: Steps whose median a step is compared with: the first step of a new rate sees five of its own nine.
AROUND = 9
#: A regular clock keeps its step to this factor (time stamps are printed with more digits than that) ...
REGULAR = 1.0 + 1e-4
#: ... but for this part of its steps, which are gaps and event rows.
IRREGULAR_SHARE = 0.05
#: Of any other clock a step is a gap that is so many medians long, an event row one as many times shorter.
GAP = 10.0


def chain_breaks(time_s: FloatArray) -> NDArray[np.bool_]:
    """Samples that start a new chain of noise.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Non-decreasing [s].

    Returns
    -------
    ndarray of bool, shape (n,)
        True for the first sample, after a gap, at and after an event row, and where a time is repeated.
    """
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


def linked_samples(data: LogData) -> NDArray[np.bool_]:
    """Samples whose noise continues a chain: they and the sample before take part, no break between.

    Parameters
    ----------
    data : LogData

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    breaks = chain_breaks(data.time_s) if data.breaks is None else data.breaks
    linked = data.include & ~breaks
    linked[1:] &= data.include[:-1] & (data.time_s[1:] > data.time_s[:-1])
    linked[:1] = False
    return linked
