"""Summary of one log's residual at its full rate, as frozen data: a decimated curve can't tell it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["ResidualSummary"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ResidualSummary:
    """Measured less modelled force of one log, over the samples that take part in the likelihood.

    Attributes
    ----------
    start_s : float
        Clock of the recording where the time of its kept curve is zero [s].
    step_s : float
        Median sampling interval [s].
    edges_N : ndarray, shape (b + 1,)
        Edges of the bins of its histogram [N].
    counts : ndarray of int, shape (b + 2,)
        Samples below the first edge, in every bin, and from the last edge on.
    lags : ndarray of int, shape (k,)
        In samples, ascending.
    correlation : ndarray, shape (k,)
        Autocorrelation at these lags.
    hold_since_s, hold_mean_N : ndarray, shape (m,)
        Middle (geometric) of a block of a hold, in time since the corner, and mean residual over it.
    hold_count : ndarray of int, shape (m,)
        Samples of each.
    """

    start_s: float
    step_s: float
    edges_N: FloatArray
    counts: NDArray[np.int64]
    lags: NDArray[np.int64]
    correlation: FloatArray
    hold_since_s: FloatArray
    hold_mean_N: FloatArray
    hold_count: NDArray[np.int64]
