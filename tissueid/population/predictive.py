"""Specimens drawn from a population, and its typical tissue, as theta of the contact model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.population.coordinates import Coordinates
from tissueid.population.sampler import PopulationDraws

#: Specimens that a bundle keeps, proposals tried for them at the most, and tried at a time.
SPECIMENS = 2000
MOST_TRIES = 40_000
BATCH = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Predictive:
    """Prediction of a specimen that was not measured."""

    typical: FloatArray  # (p,), theta of the median tissue
    #: The median of every quantity is no passive tissue: the nearest drawn specimen stands for it.
    typical_is_drawn: bool
    theta: FloatArray  # (n, p), drawn specimens, all passive
    refused: int  # draws that were not passive, and were drawn again

    @property
    def refused_share(self) -> float:
        """Of all draws."""
        return self.refused / max(self.refused + len(self.theta), 1)


def _drawn(draws: PopulationDraws, count: int, rng: np.random.Generator) -> FloatArray:
    """Phi of specimens of new donors, sites and operators at the cohort's mean covariates."""
    p = draws.sd.shape[-1]
    mean, sd = draws.mean, draws.sd.reshape(-1, p)
    correlation, nu = draws.correlation.reshape(-1, p, p), draws.nu.ravel()
    level = draws.level_sd.reshape(len(mean), -1, p)
    row = rng.integers(len(mean), size=count)
    factor = np.linalg.cholesky(correlation[row] + 1e-12 * np.eye(p))
    z = np.einsum("nij,nj->ni", factor, rng.standard_normal((count, p)))
    heavy = np.isfinite(nu[row])
    half = 0.5 * np.where(heavy, nu[row], 1.0)
    weight = np.where(heavy, rng.standard_gamma(half) / half, 1.0)
    phi = mean[row] + sd[row] * z / np.sqrt(weight)[:, None]
    return np.asarray(phi + (level[row] * rng.standard_normal((count, level.shape[1], p))).sum(axis=1))


def predictive_specimens(
    draws: PopulationDraws, coordinates: Coordinates, rng: np.random.Generator, count: int = SPECIMENS
) -> Predictive:
    """Specimens of the population, and its typical one.

    ``count``: fewer are given where most draws are not passive.
    """
    kept: list[FloatArray] = []
    found = refused = tried = 0
    while found < count and tried < MOST_TRIES:
        # a specimen that overflows is as little passive as one with a negative force
        with np.errstate(over="ignore", invalid="ignore"):
            theta = coordinates.to_theta(_drawn(draws, min(BATCH, 2 * count), rng))
            finite = np.asarray(np.isfinite(theta).all(axis=1))
            theta = np.where(finite[:, None], theta, 0.0)
            good = np.asarray(coordinates.passive(theta) & finite)
        tried += len(theta)
        used = (
            int(np.searchsorted(np.cumsum(good), count - found)) + 1
            if good.sum() > count - found
            else len(good)
        )
        kept.append(theta[:used][good[:used]])
        found += len(kept[-1])
        refused += int((~good[:used]).sum())
    theta = np.concatenate(kept) if kept else np.empty((0, coordinates.size))
    middle = np.median(draws.mean, axis=0)
    typical = coordinates.to_theta(middle)
    if bool(coordinates.passive(typical)[0]) or not len(theta):
        return Predictive(typical[0], False, theta, refused)
    phi, _ = coordinates.to_phi(theta)
    sd = np.median(draws.sd.reshape(-1, middle.size), axis=0)
    nearest = int((((phi - middle) / sd) ** 2).sum(axis=1).argmin())
    return Predictive(theta[nearest], True, theta, refused)
