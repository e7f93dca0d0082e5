"""A sampled path as a polyline with as few corners as its noise allows (Ramer 1972, Douglas & Peucker 1973).

Every sample lies within the tolerance of the polyline; corners are samples.  Distance is measured along
the displacement axis, so that the time scale does not matter.  Linear in the samples for each level.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray

IndexArray = NDArray[np.intp]


def corners(time_s: FloatArray, values: FloatArray, *, tolerance: float) -> IndexArray:
    """Indices of the corners, first and last sample included.

    ``time_s``, ``values`` (n,): non-decreasing times; ``tolerance``: largest distance of a sample from the
    polyline, in the unit of the values, > 0.  Returns (k,), growing, k >= 2.
    """
    found = {0, values.size - 1}
    open_stretches = [(0, values.size - 1)]
    while open_stretches:
        first, last = open_stretches.pop()
        if last - first < 2:
            continue
        span = time_s[last] - time_s[first]
        rise = values[last] - values[first]
        inside = slice(first + 1, last)
        if span > 0.0:
            off = values[inside] - (time_s[inside] - time_s[first]) * (rise / span)
            off -= values[first]
        else:
            off = values[inside] - values[first]
        low, high = int(off.argmin()), int(off.argmax())
        worst = high if off[high] >= -off[low] else low
        if abs(off[worst]) > tolerance:
            at = first + 1 + worst
            found.add(at)
            open_stretches += [(first, at), (at, last)]
    return np.array(sorted(found), dtype=np.intp)
