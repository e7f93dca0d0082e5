"""Diagnostics of Markov chains: effective sample sizes and R-hat, as arviz-stats has them.

Vehtari, Gelman, Simpson, Carpenter and Bürkner (2021), doi 10.1214/20-BA1221.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray

#: Chains that never moved have an infinite R-hat, which no document can hold: no larger one is said.
WORST_R_HAT = 1e3
#: A single chain is cut into so many, to be compared with itself.
_PARTS_OF_ONE_CHAIN = 4
#: Quantiles that the tail effective size is the smaller of.
_TAIL = (0.05, 0.95)
#: Least draws a chain must have: halves of four, the fewest that arviz-stats looks at.
_LEAST_DRAWS = 8
#: Offsets of a fractional rank (Blom 1958), as in Vehtari et al. (2021), equation 14.
_RANK_OFFSET = 3.0 / 8.0


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """Convergence diagnostics of one parameter's draws."""

    ess_bulk: float  # effective number of draws for the centre (rank-normalised)
    ess_tail: float  # the smaller effective number for the 5 % and 95 % quantiles
    #: Rank-normalised split R-hat, the larger of bulk and tail, at most :data:`WORST_R_HAT`.
    r_hat: float


def diagnose(draws: Mapping[str, FloatArray]) -> dict[str, Diagnostics]:
    """Effective sizes and R-hat of each parameter's draws, (chains, draws), or (draws,) in their order.

    Raises ValueError: under eight draws a chain, or draws that are not finite, naming the parameter.
    """
    scores: dict[int, FloatArray] = {}
    found = {}
    for name, values in draws.items():
        chains = _chains(name, values)
        half = chains.shape[1] // 2
        halves = np.concatenate([chains[:, :half], chains[:, -half:]])
        if halves.size not in scores:
            scores[halves.size] = _normal_scores(halves.size)
        found[name] = _diagnose_one(halves, scores[halves.size])
    return found


def _chains(name: str, values: FloatArray) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 1 or array.shape[0] == 1:
        kept = array.size - array.size % _PARTS_OF_ONE_CHAIN
        array = array.ravel()[:kept].reshape(_PARTS_OF_ONE_CHAIN, -1)
    if array.ndim != 2 or array.shape[1] < _LEAST_DRAWS:
        msg = f"{name}: draws of shape {np.shape(values)}; at least {_LEAST_DRAWS} of each chain are needed"
        raise ValueError(msg)
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: {np.count_nonzero(~np.isfinite(array))} draws are not finite")
    return array


def _diagnose_one(halves: FloatArray, scores: FloatArray) -> Diagnostics:
    if np.ptp(halves) == 0.0:
        return Diagnostics(ess_bulk=float(halves.size), ess_tail=float(halves.size), r_hat=1.0)
    bulk = scores[_twice_ranks(halves)]
    folded = scores[_twice_ranks(np.abs(halves - np.median(halves)))]
    below = [(halves <= bound).astype(np.float64) for bound in np.quantile(halves, _TAIL)]
    # chains that never moved have no variance within: R-hat is infinite, or undefined where folded ones agree
    with np.errstate(divide="ignore", invalid="ignore"):
        r_hat = np.nanmax([_r_hat(scored) for scored in (bulk, folded)])
    return Diagnostics(
        ess_bulk=_effective_size(bulk),
        ess_tail=min(_effective_size(one) for one in below),
        r_hat=float(min(r_hat, WORST_R_HAT)),
    )


def _r_hat(chains: FloatArray) -> float:
    """Potential scale reduction of chains, shape (chains, draws)."""
    n = chains.shape[1]
    within = chains.var(axis=1, ddof=1).mean()
    between = n * chains.mean(axis=1).var(ddof=1)
    return float(np.sqrt((between / within + n - 1.0) / n))


def _effective_size(chains: FloatArray) -> float:
    """Effective draws for the mean of chains (chains, draws), by Geyer's sequence, equations 9 to 11."""
    from scipy.fft import irfft, next_fast_len, rfft

    count, n = chains.shape
    if np.ptp(chains) < np.finfo(np.float64).resolution:
        return float(chains.size)
    centre = chains.mean(axis=1)
    length = next_fast_len(2 * n, real=True)
    power = np.abs(rfft(chains - centre[:, None], length)) ** 2
    # the transform is linear: one back for all chains
    covariance = irfft(power.mean(axis=0), length)[:n] / n
    within = covariance[0] * n / (n - 1.0)
    every = covariance[0] + (np.var(centre, ddof=1) if count > 1 else 0.0)
    rho = 1.0 - (within - covariance) / every
    rho[0] = 1.0
    pairs = rho[0 : n - 1 : 2] + rho[1:n:2]
    # pairs that are looked at, the first that is not positive or the last among them
    looked = max((n - 1) // 2, 1)
    ended = np.flatnonzero(pairs[:looked] <= 0.0)
    last = int(ended[0]) if ended.size else looked - 1
    beyond = rho[2 * last] if rho[2 * last] > 0.0 or pairs[last] >= 0.0 else 0.0
    time = -1.0 + 2.0 * np.minimum.accumulate(pairs[:last]).sum() + beyond
    return float(chains.size / max(time, 1.0 / np.log10(chains.size)))


def _normal_scores(size: int) -> FloatArray:
    """Normal score of each rank among ``size``, and of the half ranks that ties share, (2 size - 1,)."""
    from scipy.special import ndtri

    ranks = 1.0 + 0.5 * np.arange(2 * size - 1)
    return np.asarray(ndtri((ranks - _RANK_OFFSET) / (size + 1 - 2 * _RANK_OFFSET)))


def _twice_ranks(values: FloatArray) -> NDArray[np.int_]:
    """Place of each value's rank in :func:`_normal_scores`; equal values share their mean rank."""
    flat = values.ravel()
    order = np.argsort(flat)
    ordered = flat[order]
    first = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    counts = np.diff(np.append(first, flat.size))
    places = np.empty(flat.size, dtype=np.int_)
    places[order] = np.repeat(2 * first + counts - 1, counts)
    return places.reshape(values.shape)
