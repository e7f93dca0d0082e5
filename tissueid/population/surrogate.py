"""A smooth likelihood for specimens of which the population lies among few stage-1 draws.

A recording of 10 Hz leaves the relaxation time open over decades; a population that knows it to 15 % then
lies among a handful of that specimen's draws, too few to stand for its likelihood.  Given the relaxation
times the posterior of stage 1 is a normal in forces and viscosities, cut to the passive set, or in their
logarithms where gains leave them open; its likelihood is written as a mixture of normals, components along
what is open in logarithms, or one within the other where all of it is, and the chain then walks in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray

#: Components of a mixture at the most, and draws each needs.
MOST_COMPONENTS = 12
DRAWS_EACH = 80
#: ln tau that is known better than this has one component.
NARROW = 0.3
#: Rounds that settle components and weights.
ROUNDS = 25
#: Draws nearer than these shares of all are the first members of components within each other.
SHELLS = (0.5, 0.75)
#: Share of the whole variance that is added to that of a component.
RIDGE = 1e-6
#: Logarithms of numbers near zero run far out: they are cut at so many standard deviations for one normal.
FARTHEST = 3.0
#: And upwards in the quantity itself, of which one number fifteen times as large would be all the variance.
FARTHEST_LINEAR = 5.0
#: Normal-consistent factor of the median absolute deviation.
MAD_SD = 1.4826
#: Weights are cut at so many times their mean: a draw at a bound stands for no more.
HEAVIEST = 20.0
#: And at once where their logarithm is so far above the median: no number overflows.
FARTHEST_WEIGHT = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Pilot:
    """A frozen population: multivariate t around each specimen's centre."""

    mean: FloatArray  # (n, p)
    covariance: FloatArray  # (p, p)
    nu: float

    def unit(self) -> FloatArray:
        """Inverse Cholesky factor of the covariance."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)))

    def log_density(self, phi: FloatArray, specimen: int) -> FloatArray:
        """Ln density of points of one specimen, up to a constant; shape (n,)."""
        z = (phi - self.mean[specimen]) @ self.unit().T
        return np.asarray(-0.5 * (self.nu + phi.shape[1]) * np.log1p((z**2).sum(axis=1) / self.nu))


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """A likelihood as a mixture of normals, see :func:`tissueid.population.moves.log_mixture`."""

    centre: FloatArray  # (p,)
    log_weight: FloatArray  # (c,)
    mean: FloatArray  # (c, p)
    unit: FloatArray  # (c, p, p)
    middle: FloatArray  # (p,), of one normal in phi that proposals are made with
    precision: FloatArray  # (p, p)


def mixture_of(
    phi: FloatArray, log_reference: FloatArray, linear: NDArray[np.bool_], rng: np.random.Generator
) -> Mixture:
    """The likelihood behind stage-1 draws.

    ``phi`` (m, p); ``log_reference`` (m,): ln of the density of phi that the likelihood was multiplied with;
    ``linear`` (p,): coordinates whose likelihood is normal in the quantity, not in its logarithm.
    """
    centre = np.median(phi, axis=0)
    x = phi - centre
    reach = FARTHEST_LINEAR * MAD_SD * np.median(np.abs(x), axis=0)
    x[:, linear] = np.exp(np.minimum(x, reach)[:, linear])
    # reference density in x, divided out; dx/dphi of a linear coordinate is exp(phi - centre)
    w = _weights((phi - centre)[:, linear].sum(axis=1) - log_reference)
    near = _one_normal(phi, log_reference)
    share = _shares(phi[:, ~linear], w, rng) if linear.any() else _shells(phi, *near)
    floor = RIDGE * np.diag(np.maximum(np.atleast_2d(np.cov(x, rowvar=False, aweights=w)).diagonal(), 1e-12))
    for _ in range(ROUNDS if share.shape[1] > 1 else 1):
        log_weight, mean, unit = _components(x, w, share, floor)
        if share.shape[1] > 1:
            share = _responsibilities(x, log_weight, mean, unit)
    return Mixture(centre, log_weight, mean, unit, *near)


def _weights(log_weight: FloatArray) -> FloatArray:
    """Weights of sum 1, none above :data:`HEAVIEST` times the mean of what is left after all cuts.

    One draw far out in the prior, where the prior says next to nothing, would else stand for all others: a
    single cut at the mean does not help where that draw is the mean.
    """
    w = np.exp(np.minimum(log_weight - np.median(log_weight), FARTHEST_WEIGHT))
    # each cut divides the outliers' share by some n / HEAVIEST; more than that many are no outliers
    while w.max() > 1.01 * HEAVIEST * w.mean() and (w == w.max()).sum() * HEAVIEST < w.size:
        w = np.minimum(w, HEAVIEST * w.mean())
    return np.asarray(w / w.sum())


def _one_normal(phi: FloatArray, log_reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and precision of phi under the likelihood, its far tails cut."""
    w = _weights(-log_reference)
    middle = np.median(phi, axis=0)
    reach = FARTHEST * MAD_SD * np.median(np.abs(phi - middle), axis=0)
    near = np.clip(phi, middle - reach, middle + reach)
    covariance = np.atleast_2d(np.cov(near, rowvar=False, aweights=w))
    covariance = covariance + RIDGE * np.diag(covariance.diagonal() + 1e-12)
    return np.average(near, axis=0, weights=w), np.asarray(np.linalg.inv(covariance))


def _shells(phi: FloatArray, middle: FloatArray, precision: FloatArray) -> FloatArray:
    """First memberships where all is normal in logarithms but for its tails: shells around one centre.

    Two logs that agree leave their gains small or, seldom, both of them large: a core and tails far wider.
    """
    if (1.0 - SHELLS[-1]) * len(phi) < DRAWS_EACH:
        return np.ones((len(phi), 1))
    away = phi - middle
    distance2 = ((away @ precision) * away).sum(axis=1)
    cell = np.searchsorted(np.quantile(distance2, SHELLS), distance2)
    return np.stack([cell == k for k in range(len(SHELLS) + 1)], axis=1).astype(np.float64)


def _shares(along: FloatArray, w: FloatArray, rng: np.random.Generator) -> FloatArray:
    """First memberships: cells of equal weight along the widest open direction."""
    count = min(MOST_COMPONENTS, w.size // DRAWS_EACH)
    if along.shape[1] == 0 or count < 2:
        return np.ones((w.size, 1))
    middle = np.average(along, axis=0, weights=w)
    sd = np.sqrt(np.average((along - middle) ** 2, axis=0, weights=w))
    if sd.max() < NARROW:
        return np.ones((w.size, 1))
    values, vectors = np.linalg.eigh(np.cov(along.T, aweights=w).reshape(along.shape[1], -1))
    line = along @ vectors[:, int(values.argmax())] + 1e-9 * rng.standard_normal(w.size)
    # half by weight, half by length: tails get components of their own
    order = np.argsort(line)
    by_weight = np.empty(w.size)
    by_weight[order] = np.cumsum(w[order])
    by_length = (line - line.min()) / np.ptp(line)
    cell = np.minimum((0.5 * (by_weight + by_length) * count).astype(int), count - 1)
    found = [k for k in range(count) if (cell == k).sum() >= DRAWS_EACH // 4]
    share = np.stack([cell == k for k in found], axis=1).astype(np.float64)
    share[share.sum(axis=1) == 0.0] = 1.0 / len(found)
    return share


def _components(
    x: FloatArray, w: FloatArray, share: FloatArray, floor: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    p, count = x.shape[1], share.shape[1]
    log_weight, mean, unit = np.empty(count), np.empty((count, p)), np.empty((count, p, p))
    for c in range(count):
        own = w * share[:, c]
        total = max(float(own.sum()), 1e-300)
        mean[c] = own @ x / total
        away = x - mean[c]
        covariance = (away * own[:, None]).T @ away / total + floor
        unit[c] = np.linalg.inv(np.linalg.cholesky(covariance))
        log_weight[c] = np.log(total) + np.log(unit[c].diagonal()).sum()
    return log_weight, mean, unit


def _responsibilities(
    x: FloatArray, log_weight: FloatArray, mean: FloatArray, unit: FloatArray
) -> FloatArray:
    level = np.stack(
        [
            log_weight[c] - 0.5 * (((x - mean[c]) @ unit[c].T) ** 2).sum(axis=1)
            for c in range(log_weight.size)
        ],
        axis=1,
    )
    level -= level.max(axis=1, keepdims=True)
    share = np.exp(level)
    return np.asarray(share / share.sum(axis=1, keepdims=True))
