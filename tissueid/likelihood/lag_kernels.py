"""Compiled loops over correlated noise: sums over links, filters of rows and residuals, weights of sums."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numba.extending import is_jitted
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.gram_kernels import BLOCK, add_products

__all__ = [
    "add_link_grams",
    "filter_chain",
    "filter_rows",
    "lag_weights",
    "plain_link_grams",
    "split_links",
    "tiled_link_grams",
]

FloatArray = NDArray[np.float64]

#: The filter's gain has settled when its variance moves by less than this part, which is rounding.
SETTLED = 1e-15


@kernel()
def tiled_link_grams(
    rows: FloatArray,
    place: NDArray[np.int64],
    bound: NDArray[np.int64],
    plain: int,
    block: int,
    middle: FloatArray,
    difference: FloatArray,
) -> None:
    """:func:`add_link_grams`, compiled."""
    order = np.empty_like(place)
    for i in range(place.size):
        order[place[i]] = i
    means, changes = np.empty((BLOCK, rows.shape[1])), np.empty((BLOCK, rows.shape[1]))
    for k in range(middle.shape[0]):
        for begin in range(bound[k], bound[k + 1], BLOCK):
            n = min(BLOCK, bound[k + 1] - begin)
            for i in range(n):
                earlier, later = rows[order[begin + i]], rows[order[begin + i] + 1]
                mean, change = means[i], changes[i]
                for c in range(mean.size):
                    mean[c] = 0.5 * (earlier[c] + later[c])
                for c in range(mean.size):
                    change[c] = later[c] - earlier[c]
            add_products(means[:n], means[:n], 0, plain, block, middle[k])
            add_products(changes[:n], changes[:n], 0, 0, rows.shape[1], difference[k])


def plain_link_grams(
    rows: FloatArray,
    place: NDArray[np.int64],
    bound: NDArray[np.int64],
    plain: int,  # noqa: ARG001 # what may be left out is made, too
    block: int,  # noqa: ARG001
    middle: FloatArray,
    difference: FloatArray,
) -> None:
    """:func:`add_link_grams` as matrix products, for a run without compilation."""
    order = np.argsort(place)
    for k, (start, stop) in enumerate(pairwise(bound[: middle.shape[0] + 1])):
        later, earlier = rows[order[start:stop] + 1], rows[order[start:stop]]
        mean, change = 0.5 * (earlier + later), later - earlier
        middle[k] += mean.T @ mean
        difference[k] += change.T @ change


def add_link_grams(
    rows: FloatArray,
    place: NDArray[np.int64],
    bound: NDArray[np.int64],
    plain: int,
    block: int,
    middle: FloatArray,
    difference: FloatArray,
) -> None:
    """Add the Gram matrices of the means and of the differences of samples and those before them.

    Parameters
    ----------
    rows : ndarray, shape (chunk + 1, m)
        Design rows, m a multiple of :data:`~tissueid.likelihood.gram_kernels.LANES`; row ``i + 1`` belongs
        to ``place[i]``, row 0 ends the chunk before.
    place, bound : ndarray of int, shape (k,), (groups + 1 or more,)
        :func:`~tissueid.likelihood.gram_kernels.places` by group of link; those behind the last take no part.
    plain, block : int
        :func:`~tissueid.likelihood.gram_kernels.add_products`: what it leaves out of the sums of means,
        :func:`split_links` does not look at.
    middle, difference : ndarray, shape (groups, m, m)
        Right on and above the diagonal.
    """
    (tiled_link_grams if is_jitted(tiled_link_grams) else plain_link_grams)(
        rows, place, bound, plain, block, middle, difference
    )


@kernel()
def split_links(
    middle: FloatArray,
    change: FloatArray,
    excess: FloatArray,
    share: FloatArray,
    index: NDArray[np.int64],
    plain: int,
    block: int,
    later: FloatArray,
    earlier: FloatArray,
    difference: FloatArray,
) -> None:
    """Write the sums over later and earlier samples of links and over their differences, both halves of each.

    Blocks of columns are one set of columns times powers of a factor, so that the sum over both samples of
    all links, though not that over their means, is the same where two columns change blocks.

    Parameters
    ----------
    middle, change : ndarray, shape (groups, m, m)
        :func:`add_link_grams`.
    excess : ndarray, shape (columns, columns)
        By how much the sum over all later samples exceeds that over all earlier ones.
    share : ndarray, shape (groups,)
        Half the part of it that each group gets.
    index : ndarray of int, shape (columns,)
        Which of the m columns each of them is.
    plain, block : int
        As in :func:`add_link_grams`.
    later, earlier, difference : ndarray, shape (groups, columns, columns)
        Written.
    """
    for g in range(share.size):
        for k in range(later.shape[1]):
            for c in range(k, later.shape[1]):
                a, b = min(index[k], index[c]), max(index[k], index[c])
                back = (a - plain) % block - (b - plain) % block if a >= plain else 0
                u, v = a - max(back, 0), b + max(back, 0)
                square = middle[g, u, v] + 0.25 * change[g, u, v]
                more = share[g] * excess[k, c]
                later[g, k, c] = later[g, c, k] = square + more
                earlier[g, k, c] = earlier[g, c, k] = square - more
                difference[g, k, c] = difference[g, c, k] = change[g, a, b]


@kernel()
def filter_rows(
    group: NDArray[np.int64],
    rho: FloatArray,
    white: float,
    variance: float,
    left: float,
    mean: FloatArray,
    rows: FloatArray,
) -> float:
    """Turn white plus AR(1) noise into AR(1): design rows are filtered chain by chain, in place.

    With v_n and F_n the innovations of the scalar Kalman filter and their variances, the new rows are
    ``zeta_n = rho zeta_(n-1) + v_n sqrt(variance (1 - rho^2) / F_n)``: their AR(1) innovations are those of
    the filter, at the start of a chain as well as after it.

    Parameters
    ----------
    group : ndarray of int, shape (k,)
        Group of a sample's link, -1 where it starts a chain.
    rho : ndarray, shape (groups,)
        Correlation of the AR(1) part over the step of each group.
    white : float
        White part of the noise, whose variance is one.
    variance : float
        Variance of zeta.
    left : float
        Variance that the filter leaves after the sample before.
    mean : ndarray, shape (m,)
        The filter's state after the sample before; updated in place.
    rows : ndarray, shape (chunk + 1, m)
        Row ``i + 1`` belongs to ``group[i]``; row 0 is the last filtered one of the chunk before.

    Returns
    -------
    float
        Variance that the filter leaves after the last sample.
    """
    for i in range(group.size):
        r = rho[group[i]] if group[i] >= 0 else 0.0
        expected = r * r * left + (1.0 - white) * (1.0 - r * r)
        gain = expected / (expected + white)
        left = gain * white
        kept = r * white / (expected + white)
        scale = math.sqrt(variance * (1.0 - r * r) / (expected + white))
        earlier, later = rows[i], rows[i + 1]
        for c in range(mean.size):
            z = later[c]
            later[c] = scale * (z - r * mean[c]) + r * earlier[c]
            mean[c] = kept * mean[c] + gain * z
    return left


@kernel()
def filter_chain(
    residual: FloatArray, starts: NDArray[np.bool_], ratio: FloatArray, phi: float, white: float
) -> tuple[float, float]:
    """Innovations of white noise plus AR(1), of total variance one: the scalar Kalman filter.

    Exact for any steps and breaks.  Over equal steps the filter's gain settles, and from then on a sample
    costs two multiply-adds.

    Parameters
    ----------
    residual : ndarray, shape (n,)
    starts : ndarray of bool, shape (n,)
        True where a chain starts.
    ratio : ndarray, shape (n,)
        Step since the sample before over the reference step; unused at starts.
    phi : float
        Correlation of the AR(1) part over the reference step, in [0, 1).
    white : float
        White part of the variance, in [0, 1].

    Returns
    -------
    square, log_det : float
        ``r' R^-1 r`` and ``ln det R``.
    """
    square = 0.0
    log_det = 0.0
    slow = 1.0 - white
    decay = math.log(phi) if phi > 0.0 else -math.inf
    mean = 0.0
    left = slow
    last_ratio = -1.0
    rho = 0.0
    fresh = slow
    before = -1.0
    variance = 1.0
    gain = slow
    kept = 0.0
    # innovations of one variance are summed before they are divided by it
    pending = 0.0
    held = 0
    for n in range(residual.size):
        moving = starts[n] or ratio[n] != last_ratio or abs(left - before) > SETTLED * variance
        if moving:
            square += pending / variance
            log_det += held * math.log(variance)
            pending = 0.0
            held = 0
        if starts[n]:
            mean = 0.0
            variance = 1.0
            gain = slow
            kept = 0.0
            left = slow * white
            before = -1.0
        elif moving:
            if ratio[n] != last_ratio:
                last_ratio = ratio[n]
                rho = math.exp(decay * last_ratio)
                fresh = -slow * math.expm1(2.0 * decay * last_ratio)
            before = left
            expected = rho * rho * left + fresh
            variance = expected + white
            gain = expected / variance
            kept = rho * white / variance
            left = expected * (white / variance)
        innovation = residual[n] if starts[n] else residual[n] - rho * mean
        mean = kept * mean + gain * residual[n]
        pending += innovation * innovation
        held += 1
    return square + pending / variance, log_det + held * math.log(variance)


@kernel()
def lag_weights(phi: float, ratio: FloatArray) -> FloatArray:
    """Weights of (start, then later, earlier, difference of each step) in the whitened Gram matrix."""
    out = np.empty(1 + 3 * ratio.size)
    out[0] = 1.0
    for k in range(ratio.size):
        rho = phi ** ratio[k] if phi > 0.0 else 0.0
        out[1 + 3 * k] = 1.0 / (1.0 + rho)
        out[2 + 3 * k] = -rho / (1.0 + rho)
        out[3 + 3 * k] = rho / (1.0 - rho * rho)
    return out
