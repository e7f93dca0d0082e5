"""Arrays by the type of their elements, and an even choice of their rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ByteArray = NDArray[np.uint8]
#: Of a structured type.
RecordArray = NDArray[Any]
#: Samples that are kept of a stretch, of two channels.
_KEPT_A_STRETCH = 4


def evenly(size: int, most: int) -> NDArray[np.intp]:
    """Indices of at most so many of ``size`` rows, evenly from the first to the last."""
    return np.linspace(0, size - 1, min(size, most)).astype(np.intp)


def kept_samples(
    channels: Sequence[FloatArray], most: int, share: int, fixed: Iterable[int] = ()
) -> NDArray[np.intp]:
    """Ascending indices that keep the shape: in every stretch the extremes of each channel; ends; ``fixed``.

    ``most``: samples up to which all are kept; ``share``: samples that stretches are made for.
    """
    size = channels[0].size
    if size <= most:
        return np.arange(size)
    edges = np.linspace(0, size, max(share // _KEPT_A_STRETCH, 1) + 1).astype(int)
    keep = {0, size - 1, *fixed}
    for start, stop in pairwise(edges.tolist()):
        for values in (channel[start:stop] for channel in channels):
            keep.update((start + int(values.argmin()), start + int(values.argmax())))
    return np.array(sorted(keep), dtype=np.intp)
