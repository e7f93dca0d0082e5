"""Effect of one machine on the mean of a population: it does not average out.

Every specimen's total posterior knows the calibration nuisances, its statistical one does not.  All were
measured by one machine with one set of nuisances, so that the difference between the two is taken to be
common: its mean shift and its covariance, averaged over specimens, are added to the mean of the population.
Where specimens were measured by several machines this is too much, by up to the root of their number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.population.coordinates import Coordinates
from tissueid.population.members import Member

#: Share of the specimens that must have a total posterior.
FEWEST_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class SharedInstrument:
    """Instrument that is common to all specimens."""

    shift: FloatArray  # (p,), of ln quantities
    covariance: FloatArray  # (p, p)
    specimens: int  # of how many it was taken

    def added_to(self, mean: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draws of the mean with the machine's uncertainty, shape (n, p)."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(mean + self.shift + rng.standard_normal(mean.shape) @ root.T)


def shared_instrument(members: Sequence[Member], coordinates: Coordinates) -> SharedInstrument | None:
    """The common part of total less statistical posteriors.

    Medians and robust spreads of each specimen are averaged, because ln of a number near zero has no variance
    to speak of.

    Returns ``None`` where fewer than half of the specimens have a total posterior.
    """
    shifts, more = [], []
    for one in members:
        if one.draws_total is None or len(one.draws_total) < 2:
            continue
        total, own = coordinates.to_phi(one.draws_total)[0], coordinates.to_phi(one.draws)[0]
        shifts.append(np.median(total, axis=0) - np.median(own, axis=0))
        more.append(_covariance(total) - _covariance(own))
    if len(shifts) < max(FEWEST_SHARE * len(members), 1):
        return None
    covariance = np.median(more, axis=0)
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    positive = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return SharedInstrument(np.median(shifts, axis=0), np.asarray(positive), len(shifts))


def _covariance(phi: FloatArray) -> FloatArray:
    """Covariance of draws pulled in to their central 99 %."""
    low, high = np.quantile(phi, [0.005, 0.995], axis=0)
    return np.asarray(np.cov(np.clip(phi, low, high), rowvar=False))
