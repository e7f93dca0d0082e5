"""Arrays by the type of their elements, and an even choice of their rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ByteArray = NDArray[np.uint8]
#: Of a structured type.
RecordArray = NDArray[Any]


def evenly(size: int, most: int) -> NDArray[np.intp]:
    """Indices of at most so many of ``size`` rows, evenly from the first to the last."""
    return np.linspace(0, size - 1, min(size, most)).astype(np.intp)
