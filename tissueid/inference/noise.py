"""Noise of the observations: white, or an AR(1) beside white noise, whitened exactly through blocks.

A Kalman filter of one state, whose gains do not depend on the data: one banded solve for all columns.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain as chain_of
from itertools import repeat

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from tissueid.arrays import FloatArray

#: Least variance of an innovation, of the noise's: one that lasts for ever leaves none but rounding.
LEAST_INNOVATION = 1e-12
#: Change of the filter's variance below which it has settled.
SETTLED = 1e-13


@dataclass(frozen=True, slots=True)
class Memory:
    """Correlation of the noise."""

    time_s: float = 0.0  # correlation time of the AR(1) part; 0 for white noise
    white: float = 0.0  # share of the white part in the variance

    def phi(self, step_s: float) -> float:
        """Correlation over a step."""
        return float(np.exp(-step_s / self.time_s)) if self.time_s > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """Linear map to observations of unit variance; ``log_det`` is that of their covariance."""

    scale: FloatArray
    log_det: float
    state: FloatArray | None = None
    band: FloatArray | None = None
    gain: FloatArray | None = None

    def __call__(self, columns: FloatArray) -> FloatArray:
        """Whitened columns, shape as given: (k,) or (k, c)."""
        two = columns.reshape(columns.shape[0], -1)
        if self.band is not None and self.gain is not None and self.state is not None:
            after, _ = dtbtrs(self.band, self.gain[:, None] * two, uplo="L", diag="U")
            before = np.vstack([np.zeros((1, two.shape[1])), after[:-1]])
            two = two - self.state[:, None] * before
        return np.asarray((two * self.scale[:, None]).reshape(columns.shape))


def _block_moments(r: FloatArray, n: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of n samples of an AR(1): weight of the state before in the mean, variance, covariance, decay."""
    decay = r**n
    rest = np.maximum(1.0 - r, 1e-15)
    alpha = r * (1.0 - decay) / rest / n
    square = np.maximum(1.0 - r * r, 1e-15)
    inner = n - 2.0 * r * (1.0 - decay) / rest + r * r * (1.0 - decay**2) / square
    variance = square * inner / (n * rest) ** 2
    cross = square * ((1.0 - decay) / rest - r * (1.0 - decay**2) / square) / (n * rest)
    single = n == 1.0
    variance, cross = (np.where(single, square, one) for one in (np.maximum(variance, 0.0), cross))
    return np.where(single, r, alpha), variance, cross, decay


def whitener(
    count: FloatArray, step_s: FloatArray, gap_s: FloatArray, chain: NDArray[np.bool_], memory: Memory
) -> Whitener:
    """Prepare whitening under noise of unit variance.

    ``count``, ``step_s`` (k,): samples of each observation and their interval; ``gap_s`` (k,): time since
    the one before; ``chain`` (k,): starts of chains.
    """
    if memory.time_s <= 0.0 or memory.white >= 1.0:
        return Whitener(np.sqrt(count), -float(np.log(count).sum()))
    rate = 1.0 / memory.time_s
    r = np.exp(-np.maximum(step_s, 1e-12) * rate)
    # a gap longer or shorter than a step changes the state before the first sample
    extra = np.exp(-np.maximum(gap_s - step_s, 0.0) * rate)
    alpha, variance, cross, decay = _block_moments(r, count)
    q = 1.0 - memory.white
    white = memory.white / count
    k = count.size
    rows = np.column_stack([alpha, q * variance, q * cross, decay, q * (1.0 - decay**2), white, extra])
    state, gain, total, inner = _gains(rows, chain, q)
    inner[chain] = 0.0
    state[chain] = 0.0
    band = np.empty((2, k))
    band[0] = 1.0
    band[1, :-1] = -inner[1:]
    return Whitener(1.0 / np.sqrt(total), float(np.log(total).sum()), state, band, gain)


def _gains(
    rows: FloatArray, chain: NDArray[np.bool_], q: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Weight of the state before, gain, innovation variance and decay of the filter at each observation."""
    k = len(rows)
    inner_rows = rows[~chain]
    alike = bool((np.ptp(rows[:, :6], axis=0) <= 1e-9).all()) and bool(
        inner_rows.size == 0 or (np.ptp(inner_rows[:, 6]) <= 1e-9 and inner_rows[0, 6] >= 1.0 - 1e-9)
    )
    if alike:
        # one filter for all chains: it settles after some correlation times
        starts = np.flatnonzero(chain)
        longest = int(np.diff(np.append(starts, k)).max())
        one = repeat(rows[0].tolist(), longest)
        table = _recursion(one, chain_of([True], repeat(False, longest - 1)), q, settle=True)
        since = np.arange(k) - np.repeat(starts, np.diff(np.append(starts, k)))
        out = table[np.minimum(since, len(table) - 1)]
    else:
        out = _recursion(rows.tolist(), chain.tolist(), q, settle=False)
    return out[:, 0], out[:, 1], out[:, 2], out[:, 3]


def _recursion(rows: Iterable[list[float]], starts: Iterable[bool], q: float, *, settle: bool) -> FloatArray:
    """Riccati recursion of the filter, one row an observation; stops where it has settled, if allowed."""
    p, out = q, []
    for (a, v, c, d, e, w, x), opens in zip(rows, starts, strict=True):
        if opens:
            p, x = q, 1.0
        elif x < 1.0:
            p = x * x * p + q * (1.0 - x * x)
        s = max(a * a * p + v + w, LEAST_INNOVATION)
        g = (a * d * p + c) / s
        out.append((a * x, g, s, (d - g * a) * x))
        after = max(d * d * p + e - g * g * s, 0.0)
        if settle and abs(after - p) <= SETTLED and not opens:
            break
        p = after
    return np.array(out)
