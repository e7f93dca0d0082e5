"""Samples of a ramp averaged in bins that are narrow near a centre and wide far from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray

#: Bins of equal width next to the centre, on each side, and the growth of those further out.
NEAR_BINS = 24
BIN_GROWTH = 1.25


@dataclass(frozen=True, slots=True)
class Bins:
    """Means over bins of successive samples."""

    #: (m,): means [mm], [N].
    depth_mm: FloatArray
    variance_mm2: FloatArray  # (m,), variance of depth within each bin [mm2]
    force_N: FloatArray  # (m,)
    count: FloatArray  # (m,), samples in each bin
    fine_mm: float  # how far from the centre the bins are narrow [mm]
    spacing_mm: float  # mean distance of two samples [mm]


def bin_samples(depth_mm: FloatArray, force_N: FloatArray, *, centre_mm: float, balance: float) -> Bins:
    """Average samples in bins along the record.

    ``depth_mm``, ``force_N`` (n,): one loading ramp; ``centre_mm``: where the bins are narrow; ``balance``:
    (noise / slope)^(2/3): the sd of a bin mean falls as 1/sqrt(m), what m samples blur grows as m, and the
    two balance at m^(3/2) = noise / (slope x spacing).
    """
    n = depth_mm.size
    at = int(np.searchsorted(np.maximum.accumulate(depth_mm), centre_mm))
    step = max(float(np.ptp(depth_mm)) / max(n - 1, 1), 1e-300)
    width = max(1, int(min(balance / step ** (2.0 / 3.0), float(n))))
    width = min(width, max(1, n // (4 * NEAR_BINS)))
    growing = np.full(NEAR_BINS, float(width))
    while growing.sum() < n:
        growing = np.append(growing, growing[-1] * BIN_GROWTH)
    side = np.unique(np.concatenate([[0.0], np.cumsum(growing)]).round()).astype(int)
    edges = np.unique(np.clip(np.concatenate([at - side, at + side, [0, n]]), 0, n))[:-1]
    count = np.diff(np.append(edges, n)).astype(float)
    mean = np.add.reduceat(depth_mm, edges) / count
    off = depth_mm - np.repeat(mean, count.astype(int))
    variance = np.add.reduceat(off * off, edges) / count
    force = np.add.reduceat(force_N, edges) / count
    return Bins(mean, variance, force, count, fine_mm=NEAR_BINS * width * step, spacing_mm=step)
