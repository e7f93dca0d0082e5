"""Stage-1 draws of all specimens, and the frozen population that proposals are weighted with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, IntArray
from tissueid.population.kernels import Cohort
from tissueid.population.surrogate import Mixture, Pilot, mixture_of

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
#: Normal-consistent factor of the median absolute deviation.
MAD_SD = 1.4826


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
    """Who belongs to what."""

    columns: FloatArray  # (n, q), a column of ones, then covariates, centred
    column_names: tuple[str, ...]  # ``mean``, then the covariates
    group: IntArray  # (L, n), each specimen's group within each level
    levels: tuple[str, ...] = ()
    groups: tuple[tuple[str, ...], ...] = ()  # names of the groups of each level

    @staticmethod
    def plain(count: int) -> Design:
        """No covariates and no levels."""
        return Design(np.ones((count, 1)), ("mean",), np.zeros((0, count), dtype=np.int64))

    @property
    def offsets(self) -> IntArray:
        """First group of each level, among all groups."""
        return np.concatenate([[0], np.cumsum([len(one) for one in self.groups], dtype=np.int64)]).astype(
            np.int64
        )


def first_pilot(stage: StageOne, spread: float) -> Pilot:
    """A population from medians of the specimens.

    ``spread``: least standard deviation of a coordinate.
    """
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
    return Pilot(centre, np.diag(2.0 * PILOT_WIDER * variance), PILOT_NU)


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


def _mixtures(found: list[Mixture], size: int) -> dict[str, FloatArray]:
    """Mixtures in arrays of equal length; components that one lacks weigh nothing."""
    most = max((one.log_weight.size for one in found), default=1)
    log_weight = np.full((len(found), most), -np.inf)
    component = np.zeros((len(found), most, size))
    unit = np.zeros((len(found), most, size, size))
    for s, one in enumerate(found):
        own = slice(0, one.log_weight.size)
        log_weight[s, own], component[s, own], unit[s, own] = one.log_weight, one.mean, one.unit
    return {
        "middle": np.array([one.centre for one in found]).reshape(-1, size),
        "log_weight": log_weight,
        "component": component,
        "unit": unit,
        "likely": np.array([one.middle for one in found]).reshape(-1, size),
        "precision": np.array([one.precision for one in found]).reshape(-1, size, size),
    }


def _poor(stage: StageOne, pilot: Pilot) -> IntArray:
    """Specimens that need a smooth likelihood."""
    own = np.median([_spread(one) for one in stage.phi], axis=0)
    between = np.sqrt(pilot.covariance.diagonal() / PILOT_WIDER)
    if (own > WEAK_SHARE * between).any():
        return np.arange(len(stage.phi))
    enough = np.minimum(LEAST_WORTH, LEAST_SHARE * np.array([len(one) for one in stage.phi]))
    return np.flatnonzero(worths(stage, pilot) < enough)


def packed(stage: StageOne, design: Design, pilot: Pilot, seed: int) -> Cohort:
    """Everything the compiled chain reads, single precision where a draw is meant.

    A coordinate is a logarithm of some ten at the most: its rounding, 5e-7, is a millionth of the smallest
    spread between specimens that matters.  Specimens whose draws are worth too little under the
    pilot get a smooth likelihood.
    """
    sizes = [len(one) for one in stage.phi]
    rng = np.random.default_rng([seed, 2])
    poor = _poor(stage, pilot)
    smooth = np.full(len(stage.phi), -1, dtype=np.int64)
    smooth[poor] = np.arange(poor.size)
    mixtures = [
        mixture_of(np.asarray(stage.phi[i], np.float64), stage.log_reference[i], stage.linear, rng)
        for i in poor
    ]
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    total = int(start[-1])
    phi = np.empty((total, stage.size), dtype=np.float32)
    reference = np.empty(total, dtype=np.float32)
    frozen = np.empty(total, dtype=np.float32)
    cumulative = np.empty(total)
    for i in range(len(sizes)):
        part = slice(start[i], start[i + 1])
        density, weight = _weights(stage, pilot, i)
        phi[part] = stage.phi[i]
        reference[part] = stage.log_reference[i] - np.max(stage.log_reference[i])
        frozen[part] = density - density.max()
        cumulative[part] = np.cumsum(weight)
    offsets = design.offsets
    counts = [len(one) for one in design.groups]
    return Cohort(
        phi=phi,
        log_reference=reference,
        log_pilot=frozen,
        cumulative=cumulative,
        start=start,
        smooth=smooth,
        linear=np.asarray(stage.linear),
        ascending=np.asarray(stage.ascending, dtype=np.int64),
        **_mixtures(mixtures, stage.size),
        design=np.ascontiguousarray(design.columns, dtype=np.float64),
        group=np.ascontiguousarray(design.group + offsets[:-1, None], dtype=np.int64),
        level_of=np.repeat(np.arange(len(counts)), counts).astype(np.int64),
    )
