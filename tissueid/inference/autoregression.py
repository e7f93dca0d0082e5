"""An autoregression of residuals, rows whitened by it, and the sandwich of what is left.

Samples come in stretches: a row that does not follow the one before it is marked, and nothing reaches over
it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Autoregression", "autoregression", "newey_west", "whiten"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Longest memory, in samples, and how many samples a lag of it takes.
MOST_ORDER = 10
FEWEST_A_LAG = 10
#: Sum of the coefficients above which whitening would take the signal too.
MOST_PERSISTENT = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class Autoregression:
    """Contributions of earlier samples, shape (order,), and the standard deviation of what is new."""

    phi: FloatArray
    sd: float

    def worth(self, variance: float) -> float:
        """Weight of a sample in the mean of many: 1 for white noise of that variance."""
        if self.sd == 0.0:
            return 1.0
        return min(variance * (1.0 - float(self.phi.sum())) ** 2 / self.sd**2, 1.0)


def autoregression(residual: FloatArray, breaks: BoolArray) -> Autoregression:
    """Fitted by least squares, of the order that Akaike's criterion prefers.

    Parameters
    ----------
    residual : ndarray, shape (n,)
    breaks : ndarray of bool, shape (n,)
        True where a sample does not follow the one before it.
    """
    rows = np.flatnonzero(_places(breaks) >= MOST_ORDER)
    if rows.size < FEWEST_A_LAG * MOST_ORDER:
        return Autoregression(np.zeros(0), float(residual.std()))
    earlier = np.column_stack([residual[rows - lag] for lag in range(1, MOST_ORDER + 1)])
    best, least = np.zeros(0), math.inf
    for order in range(MOST_ORDER + 1):
        phi = np.asarray(np.linalg.lstsq(earlier[:, :order], residual[rows], rcond=None)[0])
        left = residual[rows] - earlier[:, :order] @ phi
        power = max(float(left @ left) / rows.size, np.finfo(float).tiny)
        score = rows.size * math.log(power) + 2.0 * order
        if score < least and phi.sum() < MOST_PERSISTENT:
            best, least = phi, score
    return Autoregression(best, float(whiten(residual, breaks, best)[rows].std()))


def whiten(rows: FloatArray, breaks: BoolArray, phi: FloatArray) -> FloatArray:
    """Rows less what the rows before them predict; zero where a stretch has too few before.

    Parameters
    ----------
    rows : ndarray, shape (n,) or (n, p)
    breaks : ndarray of bool, shape (n,)
    phi : ndarray
        Of an :class:`Autoregression`.
    """
    whitened = rows.copy()
    for lag, share in enumerate(phi, 1):
        whitened[lag:] -= share * rows[:-lag]
    whitened[_places(breaks) < phi.size] = 0.0
    return whitened


def newey_west(scores: FloatArray) -> FloatArray:
    """Sum of the products of scores at all lags up to a bandwidth, with Bartlett's weights, shape (p, p).

    Newey & West 1987, doi 10.2307/1913610; the bandwidth is that of 1994, doi 10.2307/2297912.

    Parameters
    ----------
    scores : ndarray, shape (n, p)
    """
    total = scores.T @ scores
    lags = int(4.0 * (scores.shape[0] / 100.0) ** (2.0 / 9.0))
    for lag in range(1, min(lags, scores.shape[0] - 1) + 1):
        product = scores[lag:].T @ scores[:-lag]
        total += (1.0 - lag / (lags + 1.0)) * (product + product.T)
    return np.asarray(total)


def _places(breaks: BoolArray) -> NDArray[np.int64]:
    """Number of each sample within its stretch."""
    at = np.arange(breaks.size)
    return at - np.maximum.accumulate(np.where(breaks, at, 0))
