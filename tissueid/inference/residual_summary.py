"""One log's residual in numbers that a picture needs: histogram, autocorrelation, means over its holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.inference.residual_blocks import HOLD_BLOCKS_PER_DECADE, ResidualBlocks
from tissueid.inference.window import FittedLog
from tissueid.residuals import ResidualSummary

#: Bins of the histogram, and half its width in standard deviations of the noise.
BINS = 40
HALF_WIDTH_SD = 5.0
#: Lags grow geometrically, the same for every log, to a quarter of it.
LAGS_PER_DECADE = 6
LARGEST_LAG_SHARE = 0.25


def _correlation(residual: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Lags in samples and the autocorrelation there; none for fewer than eight samples."""
    largest = int(LARGEST_LAG_SHARE * residual.size)
    centred = residual - residual.mean() if residual.size else residual
    power = float(centred @ centred)
    if largest < 2 or power == 0.0:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    places = np.arange(int(LAGS_PER_DECADE * np.log10(largest)) + 1) / LAGS_PER_DECADE
    lags = np.unique((10.0**places).round().astype(np.int64))
    found = [float(centred[lag:] @ centred[: centred.size - lag]) / power for lag in lags.tolist()]
    return lags, np.array(found)


def residual_summary(
    log: FittedLog, fitted: FloatArray, blocks: ResidualBlocks, *, sigma_N: float
) -> ResidualSummary:
    """Summarise what the model leaves of one log.

    ``fitted`` (n,): force of the specimen's model along it [N]; ``blocks``: of the same log; ``sigma_N``:
    standard deviation of the specimen's noise: the scale of the histogram [N].
    """
    data = log.data
    residual = (data.force_N - fitted)[data.include]
    # a fit without noise has no scale but the residual's own
    scale = sigma_N if sigma_N > 0.0 else float(np.abs(residual).max(initial=0.0)) or 1.0
    edges = np.linspace(-HALF_WIDTH_SD * scale, HALF_WIDTH_SD * scale, BINS + 1)
    places = np.searchsorted(edges, residual, side="right")
    lags, correlation = _correlation(residual)
    held = blocks.hold
    return ResidualSummary(
        start_s=float(data.time_s[0]),
        step_s=log.step_s,
        edges_N=edges,
        counts=np.bincount(places, minlength=BINS + 2).astype(np.int64),
        lags=lags,
        correlation=correlation,
        hold_since_s=10.0 ** ((blocks.place[held] + 0.5) / HOLD_BLOCKS_PER_DECADE),
        hold_mean_N=blocks.mean_N[held],
        hold_count=blocks.count[held].astype(np.int64),
    )
