"""A mixture of Student-t densities fitted to a target by importance sampling: a proposal to draw from.

Population Monte Carlo with closed updates (Cappe et al. 2008, doi 10.1007/s11222-008-9059-x): draws from the
mixture are weighted by target over proposal, and shares, means and scales of the components are their
weighted moments.  Heavy tails keep the weights bounded where the target falls like a normal or an
exponential, and components side by side follow a bound or a bend.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.triangular import squared_distances
from tissueid.posterior.target import Target

__all__ = ["Mixture", "fitted_mixture"]

FloatArray = NDArray[np.float64]

#: Degrees of freedom: heavier tails cost acceptance, lighter ones bound the weights less safely.
DOF = 6.0
COMPONENTS = 10
#: Rounds of fitting, draws of each for a coordinate, and the gain in effective share that goes on.
ROUNDS = 12
DRAWS_PER_COORDINATE = 1_500
GAIN = 0.02
#: Steps along an axis [Laplace standard deviations] that look for a fall of the log density by so much.
STEPS = np.geomspace(0.02, 2000.0, 80)
FALL = 8.0
#: First scale against the Laplace covariance, and the share of a wide component that always stays.
FIRST_SCALE = 2.0
WIDE_SCALE = 4.0
WIDE_SHARE = 0.05
#: A component with fewer effective draws than this for a coordinate is dropped.
LEAST_DRAWS = 5.0
#: Ridge of a scale matrix, relative to the whole covariance.
RIDGE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """A proposal.

    Attributes
    ----------
    share : ndarray, shape (k,)
    mean : ndarray, shape (k, d)
    factor : ndarray, shape (k, d, d)
        Lower Cholesky factors of the scale matrices.
    """

    share: FloatArray
    mean: FloatArray
    factor: FloatArray

    def draw(self, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Points (n, d) and the ln of the density that they are drawn from."""
        points = self.points(n, rng)
        return points, np.logaddexp.reduce(self.parts(points)[0], axis=1)

    def points(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Points (n, d)."""
        component = np.searchsorted(np.cumsum(self.share)[:-1], rng.random(n), side="right")
        normal = rng.standard_normal((n, self.mean.shape[1]))
        normal /= np.sqrt(rng.chisquare(DOF, n) / DOF)[:, None]
        points = np.empty_like(normal)
        for k in range(self.share.size):
            here = component == k
            points[here] = self.mean[k] + normal[here] @ self.factor[k].T
        return points

    def parts(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Ln of share times density of every component, shape (n, k), and squared distances."""
        d = points.shape[1]
        constant = math.lgamma(0.5 * (DOF + d)) - math.lgamma(0.5 * DOF) - 0.5 * d * math.log(DOF * math.pi)
        distance = squared_distances(points, self.mean, self.factor)
        value = constant - 0.5 * (DOF + d) * np.log1p(distance / DOF)
        value += np.log(self.share) - np.log(np.diagonal(self.factor, axis1=1, axis2=2)).sum(axis=1)
        return value, distance


def _reach(target: Target, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the density has fallen by :data:`FALL`, both ways along each axis of the Laplace covariance."""
    d = target.mode.size
    steps = STEPS[None, :, None] * np.concatenate([-np.eye(d), np.eye(d)])[:, None, :]
    value = target.log_density(target.mode + steps.reshape(-1, d) @ axes.T).reshape(2 * d, -1)
    top = float(target.log_density(target.mode[None, :])[0])
    fallen = value < top - FALL
    first = np.where(fallen.any(axis=1), fallen.argmax(axis=1), STEPS.size - 1)
    return -STEPS[first[:d]], STEPS[first[d:]]


def _first(target: Target, rng: np.random.Generator) -> Mixture:
    """Components scattered around the mode, as wide as the density is along each axis of its covariance."""
    d = target.mode.size
    axes: FloatArray = np.linalg.cholesky(target.covariance).astype(np.float64)
    low, high = _reach(target, axes)
    # a normal density falls by FALL at sqrt(2 FALL) standard deviations
    sd = np.maximum((high - low) / (2.0 * math.sqrt(2.0 * FALL)), STEPS[0])
    centre = target.mode + axes @ (0.5 * (low + high))
    factor = axes * sd
    means = centre + rng.standard_normal((COMPONENTS, d)) @ factor.T
    means[0] = centre
    scales = np.full(COMPONENTS, math.sqrt(FIRST_SCALE))
    scales[0] = math.sqrt(WIDE_SCALE)
    return Mixture(np.full(COMPONENTS, 1.0 / COMPONENTS), means, scales[:, None, None] * factor)


def _updated(mixture: Mixture, points: FloatArray, member: FloatArray, distance: FloatArray) -> Mixture:
    """The mixture after one update by draws, weighted with their part in each component."""
    d = points.shape[1]
    weight = member.sum(axis=1)
    centre = weight @ points
    whole = (weight[:, None] * (points - centre)).T @ (points - centre)
    shares, means, factors = [], [], []
    for k in range(mixture.share.size):
        own = member[:, k]
        share = float(own.sum())
        if share**2 < LEAST_DRAWS * d * float((own * own).sum()):
            continue
        pull = own * (DOF + d) / (DOF + distance[:, k])
        mean = pull @ points / pull.sum()
        scale = (pull[:, None] * (points - mean)).T @ (points - mean) / share
        shares.append(share)
        means.append(mean)
        factors.append(np.linalg.cholesky(scale + RIDGE * whole))
    # one component always covers all there is
    shares.append(WIDE_SHARE * (sum(shares) or 1.0))
    means.append(centre)
    factors.append(np.linalg.cholesky(WIDE_SCALE * (1.0 + RIDGE) * whole + 1e-12 * np.diag(np.diag(whole))))
    normed = np.array(shares) / sum(shares)
    return Mixture(normed, np.array(means), np.array(factors))


def fitted_mixture(target: Target, rng: np.random.Generator, *, share: float = 1.0) -> Mixture:
    """A mixture close to a target.

    Parameters
    ----------
    target : Target
        Mode and covariance are where it starts from.
    rng : numpy.random.Generator
    share : float
        Of the usual number of draws, where a rough one does.
    """
    d = target.mode.size
    mixture = best = _first(target, rng)
    n = int(DRAWS_PER_COORDINATE * share) * d
    highest, stalled = 0.0, 0
    for _ in range(ROUNDS):
        points = mixture.points(n, rng)
        value, distance = mixture.parts(points)
        log_proposal = np.logaddexp.reduce(value, axis=1)
        log_weight = target.log_density(points) - log_proposal
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        effective = 1.0 / float((weight * weight).sum()) / n
        if effective > highest + GAIN:
            highest, best, stalled = effective, mixture, 0
        elif (stalled := stalled + 1) >= 2:
            break
        # single weights of a poor proposal would make a component of one draw
        limit = float(np.sort(weight)[-max(n // 100, 10)])
        clipped = np.minimum(weight, limit) if limit > 0.0 else weight
        member = np.exp(value - log_proposal[:, None]) * (clipped / clipped.sum())[:, None]
        mixture = _updated(mixture, points, member, distance)
    return best
