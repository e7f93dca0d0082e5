"""Stage-1 draws of all specimens, the frozen population that weighs them, and smooth likelihoods beside them.

A recording of 10 Hz leaves the relaxation time open over decades: a population that knows it to 15 % lies
among a handful of that specimen's draws, too few to stand for its likelihood, which is then written as a
mixture of normals: components along what is open in logarithms, or one within the other where all of it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from tissueid.arrays import FloatArray, IntArray

#: A quantity is never looked at beyond e to this, times its typical value.
LARGEST = 50.0

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
    """A frozen population: multivariate t of :data:`PILOT_NU` around each specimen's centre."""

    mean: FloatArray  # (n, p)
    covariance: FloatArray  # (p, p)

    def log_density(self, phi: FloatArray, specimen: int) -> FloatArray:
        """Ln density of points of one specimen, up to a constant; shape (n,)."""
        z = (phi - self.mean[specimen]) @ np.linalg.inv(np.linalg.cholesky(self.covariance)).T
        return np.asarray(-0.5 * (PILOT_NU + phi.shape[1]) * np.log1p((z**2).sum(axis=1) / PILOT_NU))


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """A likelihood as a mixture of normals, see :meth:`Mixtures.log_density`."""

    centre: FloatArray  # (p,)
    log_weight: FloatArray  # (c,)
    mean: FloatArray  # (c, p)
    unit: FloatArray  # (c, p, p)
    middle: FloatArray  # (p,), of one normal in phi that proposals are made with
    precision: FloatArray  # (p, p)


def mixture_of(phi: FloatArray, log_reference: FloatArray, linear: NDArray[np.bool_]) -> Mixture:
    """The likelihood behind stage-1 draws; ``phi`` (m, p)."""
    centre = np.median(phi, axis=0)
    x = phi - centre
    reach = FARTHEST_LINEAR * MAD_SD * np.median(np.abs(x), axis=0)
    x[:, linear] = np.exp(np.minimum(x, reach)[:, linear])
    # reference density in x, divided out; dx/dphi of a linear coordinate is exp(phi - centre)
    w = _cut_weights((phi - centre)[:, linear].sum(axis=1) - log_reference)
    near = _one_normal(phi, log_reference)
    share = _shares(phi[:, ~linear], w) if linear.any() else _shells(phi, *near)
    floor = RIDGE * np.diag(np.maximum(np.atleast_2d(np.cov(x, rowvar=False, aweights=w)).diagonal(), 1e-12))
    for _ in range(ROUNDS if share.shape[1] > 1 else 1):
        log_weight, mean, unit = _components(x, w, share, floor)
        if share.shape[1] > 1:
            share = _responsibilities(x, log_weight, mean, unit)
    return Mixture(centre, log_weight, mean, unit, *near)


def _cut_weights(log_weight: FloatArray) -> FloatArray:
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
    w = _cut_weights(-log_reference)
    middle = np.median(phi, axis=0)
    reach = FARTHEST * MAD_SD * np.median(np.abs(phi - middle), axis=0)
    near = np.clip(phi, middle - reach, middle + reach)
    covariance = np.atleast_2d(np.cov(near, rowvar=False, aweights=w))
    covariance = covariance + RIDGE * np.diag(covariance.diagonal() + 1e-12)
    return np.average(near, axis=0, weights=w), np.asarray(np.linalg.inv(covariance))


def _shells(phi: FloatArray, middle: FloatArray, precision: FloatArray) -> FloatArray:
    """First memberships by distance, a core and far wider tails: gains are small or, seldom, all large."""
    if (1.0 - SHELLS[-1]) * len(phi) < DRAWS_EACH:
        return np.ones((len(phi), 1))
    away = phi - middle
    distance2 = ((away @ precision) * away).sum(axis=1)
    cell = np.searchsorted(np.quantile(distance2, SHELLS), distance2)
    return np.stack([cell == k for k in range(len(SHELLS) + 1)], axis=1).astype(np.float64)


def _shares(along: FloatArray, w: FloatArray) -> FloatArray:
    """First memberships: cells of equal weight along the widest open direction."""
    count = min(MOST_COMPONENTS, w.size // DRAWS_EACH)
    if along.shape[1] == 0 or count < 2:
        return np.ones((w.size, 1))
    middle = np.average(along, axis=0, weights=w)
    sd = np.sqrt(np.average((along - middle) ** 2, axis=0, weights=w))
    if sd.max() < NARROW:
        return np.ones((w.size, 1))
    values, vectors = np.linalg.eigh(np.cov(along.T, aweights=w).reshape(along.shape[1], -1))
    line = along @ vectors[:, int(values.argmax())]
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


#: Effective draws under the pilot that a specimen needs, and of all its draws the share; with fewer its
#: likelihood is smoothed.
LEAST_WORTH = 500.0
LEAST_SHARE = 0.25
#: Where a typical specimen's own standard deviation of a coordinate is more than this share of that between
#: specimens all are smoothed: the population then follows its specimens as much as they follow it, and joint
#: moves carry smooth ones only.
WEAK_SHARE = 1.0
#: The pilot is wider than the population it was made from, and has heavy tails, so that it covers it.
PILOT_WIDER = 1.5
PILOT_NU = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class StageOne:
    """Draws of every specimen."""

    phi: tuple[NDArray[Any], ...]  # (m_i, p), single precision will do
    #: (m_i,): ln of the density of phi that the likelihood was multiplied with, up to a constant a specimen.
    log_reference: tuple[FloatArray, ...]
    #: (p,): coordinates whose likelihood is close to normal in the quantity itself, not in its logarithm.
    linear: NDArray[np.bool_]
    ascending: IntArray  # coordinates that ascend within a specimen

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return int(self.linear.size)


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """Who belongs to what, and how columns are to be read."""

    columns: FloatArray  # (n, q), a column of ones, then covariates, centred
    column_names: tuple[str, ...]  # ``mean``, then the covariates
    group: IntArray  # (L, n), each specimen's group within each level
    levels: tuple[str, ...] = ()
    group_by: str | None = None
    compared: tuple[str, ...] = ()  # its groups; the first is the one that others are compared with
    scales: Mapping[str, float] = field(default_factory=dict)  # numeric covariate -> its standard deviation
    #: Covariate -> specimens that do not state it and were given its mean.
    missing: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def first_pilot(stage: StageOne, spread: float) -> Pilot:
    """A population from medians of the specimens."""
    middle = np.array([np.median(one, axis=0) for one in stage.phi])
    own = np.array([_spread(one) for one in stage.phi])
    variance = np.full(stage.size, spread**2)
    mean = np.median(middle, axis=0)
    for _ in range(5):
        weight = 1.0 / (own**2 + variance)
        mean = (weight * middle).sum(axis=0) / weight.sum(axis=0)
        excess = (weight * ((middle - mean) ** 2 - own**2)).sum(axis=0) / weight.sum(axis=0)
        variance = np.maximum(excess, spread**2)
    centre = np.tile(mean, (len(stage.phi), 1))
    return Pilot(centre, np.diag(2.0 * PILOT_WIDER * variance))


def _spread(phi: NDArray[Any]) -> FloatArray:
    """Standard deviation of each coordinate, far draws aside."""
    return np.asarray(MAD_SD * np.median(np.abs(phi - np.median(phi, axis=0)), axis=0), dtype=np.float64)


def _weights(stage: StageOne, pilot: Pilot, i: int) -> tuple[FloatArray, FloatArray]:
    """Ln pilot density of a specimen's draws, and their frozen weights of sum 1."""
    density = pilot.log_density(stage.phi[i], i)
    level = density - stage.log_reference[i]
    weight = np.exp(level - level.max())
    return density, weight / weight.sum()


def worths(stage: StageOne, pilot: Pilot) -> FloatArray:
    """Effective draws of every specimen under a pilot, shape (n,)."""
    found = [_weights(stage, pilot, i)[1] for i in range(len(stage.phi))]
    return np.array([1.0 / float((one**2).sum()) for one in found])


@dataclass(frozen=True, slots=True, eq=False)
class Mixtures:
    """Likelihoods of s specimens by as many components c each; those that one lacks weigh nothing."""

    linear: NDArray[np.bool_]  # (p,): coordinates that a mixture has in the quantity, over exp(centre)
    ascending: IntArray  # coordinates that ascend
    centre: FloatArray  # (s, p)
    log_weight: FloatArray  # (s, 1, c): of each component, its determinant included
    unit: FloatArray  # (s, p, c p): inverse Cholesky factors, transposed, side by side
    shift: FloatArray  # (s, 1, c p): of the components' means
    #: (s, p): of one normal that proposals are made with.
    likely: FloatArray
    precision: FloatArray  # (s, p, p)

    @classmethod
    def of(cls, found: list[Mixture], stage: StageOne) -> Mixtures:
        """Mixtures side by side."""
        size, most = stage.size, max((one.log_weight.size for one in found), default=1)
        log_weight = np.full((len(found), 1, most), -np.inf)
        unit, shift = np.zeros((len(found), size, most * size)), np.zeros((len(found), 1, most * size))
        for s, one in enumerate(found):
            count = one.log_weight.size
            log_weight[s, 0, :count] = one.log_weight
            unit[s, :, : count * size] = np.moveaxis(one.unit, 2, 0).reshape(size, -1)
            shift[s, 0, : count * size] = np.einsum("cij,cj->ci", one.unit, one.mean).ravel()
        return cls(
            linear=stage.linear,
            ascending=stage.ascending,
            centre=np.array([one.centre for one in found]).reshape(-1, size),
            log_weight=log_weight,
            unit=unit,
            shift=shift,
            likely=np.array([one.middle for one in found]).reshape(-1, size),
            precision=np.array([one.precision for one in found]).reshape(-1, size, size),
        )

    def log_density(self, phi: FloatArray) -> FloatArray:
        """Ln of the likelihoods at points (n, s, p), up to a constant; -inf where times do not ascend."""
        x = phi - self.centre
        x[..., self.linear] = np.exp(np.minimum(x[..., self.linear], LARGEST))
        z = x.swapaxes(0, 1) @ self.unit - self.shift
        square = (z**2).reshape(*z.shape[:2], -1, x.shape[2]).sum(axis=3)
        value = np.logaddexp.reduce(self.log_weight - 0.5 * square, axis=2).T
        times = phi[..., self.ascending]
        return np.where((np.diff(times, axis=2) > 0.0).all(axis=2), value, -np.inf)


def _poor(stage: StageOne, pilot: Pilot) -> IntArray:
    """Specimens that need a smooth likelihood."""
    own = np.median([_spread(one) for one in stage.phi], axis=0)
    between = np.sqrt(pilot.covariance.diagonal() / PILOT_WIDER)
    if (own > WEAK_SHARE * between).any():
        return np.arange(len(stage.phi))
    enough = np.minimum(LEAST_WORTH, LEAST_SHARE * np.array([len(one) for one in stage.phi]))
    return np.flatnonzero(worths(stage, pilot) < enough)


@dataclass(frozen=True, slots=True, eq=False)
class Cohort:
    """Specimens as the chains know them."""

    phi: NDArray[np.float32]  # (N, p), stage-1 draws of all specimens, one after the other
    #: (N,): ln densities of phi, up to a constant for each specimen.
    log_reference: NDArray[np.float32]
    log_pilot: NDArray[np.float32]  # (N,)
    cumulative: FloatArray  # (N,), running sums of frozen weights; those of specimen i go from i to i + 1
    start: IntArray  # (n + 1,), where each specimen's draws begin
    smooth: IntArray  # specimens with a smooth likelihood
    held: IntArray  # the others, which are among their draws
    likelihoods: Mixtures  # of the smooth ones
    design: FloatArray  # (n, q), a column of ones, then covariates
    group: IntArray  # (L, n), each specimen's group among those of all levels
    level_of: IntArray  # (G,), level of each group
    #: Of each level: (its groups, n), 1 where a specimen belongs to one; of none a level without groups.
    members: tuple[csr_array, ...]


def packed(stage: StageOne, design: Design, pilot: Pilot, known: dict[int, Mixture]) -> Cohort:
    """Everything that chains read; single precision, 5e-7, is a millionth of the smallest spread.

    ``known``: mixtures of specimens that were smoothed before; those that are now go into it.
    """
    count, poor = len(stage.phi), _poor(stage, pilot)
    for i in poor:
        if i not in known:
            phi = np.asarray(stage.phi[i], np.float64)
            known[i] = mixture_of(phi, stage.log_reference[i], stage.linear)
    weighted = [_weights(stage, pilot, i) for i in range(count)]
    sizes = [int(one.max()) + 1 for one in design.group]
    return Cohort(
        phi=np.concatenate(stage.phi).astype(np.float32),
        log_reference=np.concatenate([one - np.max(one) for one in stage.log_reference]).astype(np.float32),
        log_pilot=np.concatenate([density - density.max() for density, _ in weighted]).astype(np.float32),
        cumulative=np.concatenate([i + np.cumsum(weight) for i, (_, weight) in enumerate(weighted)]),
        start=np.cumsum([0, *(len(one) for one in stage.phi)]).astype(np.int64),
        smooth=poor,
        held=np.setdiff1d(np.arange(count), poor),
        likelihoods=Mixtures.of([known[i] for i in poor], stage),
        design=np.asarray(design.columns, dtype=np.float64),
        group=design.group + np.cumsum([0, *sizes], dtype=np.int64)[:-1, None],
        level_of=np.repeat(np.arange(len(sizes)), sizes),
        members=tuple(
            csr_array((np.ones(count), (group, np.arange(count))), shape=(size, count))
            for group, size in zip(design.group, sizes, strict=True)
        )
        or (csr_array((0, count)),),
    )
