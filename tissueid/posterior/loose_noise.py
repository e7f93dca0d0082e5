"""Noise that is known little better than the instrument: its scale and correlation as coordinates.

A short record, or one whose noise has a long memory, leaves the correlation open, and with it how much its
samples say.  Sums on knots are taken at one correlation; times ``1 - phi^2`` they are a quadratic in phi
where all steps are equal (:mod:`tissueid.likelihood.lag_sums`) and nearly so else: those at a few values of
phi give them at any.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.instrument_kernels import Packed
from tissueid.likelihood.knots import KnotSums
from tissueid.posterior.specimen_target import ARCTANH_LIMIT, SpecimenTarget
from tissueid.priors import Priors

__all__ = ["LooseNoise", "loose_noise"]

FloatArray = NDArray[np.float64]

#: Standard deviation of ln sigma from which the noise is no longer held: to take a scale for known that is
#: known to 3 % makes intervals too short by some 0.2 %.
LOOSE = 0.03
#: Values of phi where all steps are equal, and elsewhere; how far they and the coordinates reach around the
#: mode, in standard deviations, and at the least in arctanh phi.
EQUAL, OTHERS = 3, 5
REACH = 5.0
NARROWEST = 0.5
#: Largest arctanh phi: far beyond, 1 - phi^2 is lost to rounding.
HIGHEST = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class LooseNoise:
    """Scale and correlation of the noise.

    Attributes
    ----------
    mode : ndarray, shape (1,) or (2,)
        ln sigma, and arctanh phi where the noise is correlated, of the statistical posterior.
    covariance : ndarray
        Of the same.
    phi : ndarray, shape (k,)
        Correlations that were summed with; empty for white noise.
    pull, band, square : ndarray, shape (k, ...)
        As in :class:`tissueid.likelihood.instrument_kernels.Packed`, for each.
    ratio, links : ndarray, shape (groups,)
        Steps over the reference step, and their links.
    count : int
        Samples.
    """

    mode: FloatArray
    covariance: FloatArray
    phi: FloatArray
    pull: FloatArray
    band: FloatArray
    square: FloatArray
    ratio: FloatArray
    links: FloatArray
    count: int

    @property
    def names(self) -> tuple[str, ...]:
        """Coordinates."""
        return ("ln_sigma", "arctanh_phi")[: self.mode.size]

    def cuts(self, priors: Priors) -> tuple[FloatArray, FloatArray]:
        """Lower and upper ends of the coordinates."""
        low, high = np.array([-math.inf]), np.array([math.inf])
        if self.mode.size == 1:
            return low, high
        first, last = priors.phi
        ends = math.atanh(first), math.atanh(last) if last < 1.0 else ARCTANH_LIMIT
        near, far = np.arctanh(self.phi[[0, -1]])
        return np.append(low, max(ends[0], near)), np.append(high, min(ends[1], far))

    def at(self, data: Packed, noise: FloatArray) -> Packed:
        """The same logs whitened at another correlation."""
        if noise.size == 1:
            return data
        phi = math.tanh(noise[1])
        weight = np.ones(self.phi.size)
        for k, own in enumerate(self.phi):
            others = np.delete(self.phi, k)
            weight[k] = np.prod((phi - others) / (own - others)) * (1.0 - own * own) / (1.0 - phi * phi)
        return data._replace(
            pull=weight @ self.pull,
            band=np.ascontiguousarray(np.tensordot(weight, self.band, 1)),
            square=weight @ self.square,
        )

    def log_weight(self, noise: FloatArray, priors: Priors) -> float:
        """Ln of the prior, and of what the likelihood has of the noise alone."""
        value = -self.count * noise[0]
        if priors.sigma_N is not None:
            value -= 0.5 * ((noise[0] - math.log(priors.sigma_N.median)) / priors.sigma_N.sd_ln) ** 2
        if noise.size > 1:
            # d phi / d a = 1 / cosh(a)^2
            value -= 2.0 * math.log(math.cosh(noise[1]))
            rho = math.tanh(noise[1]) ** self.ratio
            value -= 0.5 * float(self.links @ np.log1p(-rho * rho))
        return float(value)


def loose_noise(
    target: SpecimenTarget,
    links: tuple[FloatArray, FloatArray],
    count: int,
    knots_at: Callable[[float], Sequence[KnotSums]],
) -> LooseNoise | None:
    """The noise as coordinates, where the recordings leave it open; else ``None``.

    Parameters
    ----------
    target : SpecimenTarget
        Its mode and covariance tell what is known of the noise.
    links : tuple of ndarray
        Distinct steps over the reference step, and how many links have each.
    count : int
        Samples.
    knots_at : callable
        Correlation -> sums of every log on its knots.
    """
    size = 1 + target.data.has_phi
    own = slice(target.data.branches, target.data.branches + size)
    mode, covariance = target.mode[own].copy(), target.covariance[own, own].copy()
    if math.sqrt(covariance[0, 0]) < LOOSE:
        return None
    phi = np.zeros(0)
    if size > 1:
        nodes = EQUAL if links[0].size == 1 else OTHERS
        reach = max(REACH * math.sqrt(covariance[1, 1]), NARROWEST)
        ends = max(mode[1] - reach, 0.0), min(mode[1] + reach, HIGHEST)
        phi = np.tanh(np.linspace(*ends, nodes))
    sums = [knots_at(float(one)) for one in phi]
    width = max((one.band.shape[1] for logs in sums for one in logs), default=1)

    def table(logs: Sequence[KnotSums]) -> FloatArray:
        bands = [np.pad(one.band, ((0, 0), (0, width - one.band.shape[1]))) for one in logs]
        return np.concatenate(bands)

    return LooseNoise(
        mode=mode,
        covariance=covariance,
        phi=phi,
        pull=np.array([np.concatenate([one.pull for one in logs]) for logs in sums]),
        band=np.array([table(logs) for logs in sums]),
        square=np.array([[one.square for one in logs] for logs in sums]),
        ratio=links[0],
        links=links[1],
        count=count,
    )
