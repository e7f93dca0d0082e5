"""Summary of one log's residual at its full rate, as frozen data: a decimated curve can't tell it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ResidualSummary:
    """Measured less modelled force of one log, over the samples that take part in the likelihood."""

    start_s: float  # clock of the recording where the time of its kept curve is zero [s]
    step_s: float  # median sampling interval [s]
    edges_N: FloatArray  # (b + 1,), edges of the bins of its histogram [N]
    #: (b + 2,): samples below the first edge, in every bin, and from the last edge on.
    counts: NDArray[np.int64]
    lags: NDArray[np.int64]  # (k,), in samples, ascending
    correlation: FloatArray  # (k,), autocorrelation at these lags
    #: (m,): middle (geometric) of a block of a hold, in time since the corner, and mean residual over it.
    hold_since_s: FloatArray
    hold_mean_N: FloatArray  # (m,)
    hold_count: NDArray[np.int64]  # (m,), samples of each
