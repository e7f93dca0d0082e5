"""Draws of the tissue alone, carried to machines that may stand before it, and weighted.

A posterior that knows of no instrument is the best proposal there is for one that does where bounds are
active: its draws are passive, while a normal approximation of what is left of a cone is worth nothing.  Each
draw is moved along the linear response of the likelihood to an instrument drawn from its prior, so that the
force stays where the data are, and weighted by the density that knows the instrument over the one that it was
drawn from.  That is exact for any response.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.instrument_density import log_likelihood
from tissueid.likelihood.instrument_kernels import INSTRUMENT
from tissueid.likelihood.marginal import log_joints
from tissueid.likelihood.passive_normal import passive
from tissueid.posterior.importance import Weighted, pooled, smoothed
from tissueid.posterior.instrument import Behind, inverse
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.posterior.target import Redrawn

__all__ = ["carried_draws", "propagated_draws"]

FloatArray = NDArray[np.float64]

#: Draws that are carried at the most, and how much wider they are spread: as they are, and a little beyond.
MOST, STRETCHES = 2_000, (1.0, 1.2, 1.5)
#: Share of propagated draws that must stay passive.
LEAST_PASSIVE = 0.3


def _response(behind: Behind) -> tuple[FloatArray, FloatArray]:
    """What theta and ln tau do for a unit of each nuisance, shapes (p, 3) and (branches, 3)."""
    p, branches = behind.theta.size, behind.branches
    curvature, slope = behind.curvature, behind.slope[:, : branches + INSTRUMENT]
    schur = curvature[p:, p:] + curvature[p:, :p] @ slope
    tau = -inverse(schur[:branches, :branches]) @ schur[:branches, branches:]
    return slope[:, branches:] + slope[:, :branches] @ tau, tau


def _machines(behind: Behind, count: int, rng: np.random.Generator) -> FloatArray:
    """Skew, filter and compliance from their priors, shape (count, 3)."""
    out = np.empty((count, INSTRUMENT))
    for k, prior in enumerate(behind.calibration):
        out[:, k] = prior.mean + prior.sd * rng.standard_normal(count)
        while prior.sd > 0.0 and (below := out[:, k] < prior.lower).any():
            out[below, k] = prior.mean + prior.sd * rng.standard_normal(int(below.sum()))
    return out


def _densities(behind: Behind, points: FloatArray, theta: FloatArray) -> FloatArray:
    """Ln density but for the instrument's prior; -inf where it is not passive."""
    inner = slice(behind.branches, behind.branches + INSTRUMENT)
    same = points.copy()
    same[:, inner] = behind.mode[inner]
    level = behind.log_priors(same)
    level[~passive(theta, behind.blocks)] = -np.inf
    density = behind.density()
    for i in np.flatnonzero(np.isfinite(level)):
        level[i] += log_likelihood(density, points[i], theta[i])
    level[~np.isfinite(level)] = -np.inf
    return level


def carried_draws(
    behind: Behind,
    target: SpecimenTarget,
    drawn: Redrawn,
    points: FloatArray,
    rng: np.random.Generator | None = None,
) -> tuple[Weighted, FloatArray]:
    """Weighted draws of tissue and instrument.

    Parameters
    ----------
    behind : Behind
        Its mode found.
    target : SpecimenTarget
        The posterior without an instrument.
    drawn : Redrawn
        Its draws.
    points : ndarray, shape (n, d)
        The sampled coordinates of each.
    rng : numpy.random.Generator, optional
        Draws instruments; ``None`` weighs every draw as it is, without one: what gains and contact points
        that were linearised about one point have done to it.

    Returns
    -------
    Weighted
        Of the free coordinates, with theta as what is beside.
    points : ndarray, shape (m, d)
        In all coordinates.
    """
    most = points.shape[0] if rng is None else MOST
    rows = np.linspace(0, points.shape[0] - 1, min(points.shape[0], most)).astype(np.int64)
    points = np.ascontiguousarray(points[rows])
    theta = np.ascontiguousarray(drawn.linear[rows])
    before = log_joints(target.data, points, theta) + target.log_prior(points)
    branches, inner = behind.branches, behind.branches + INSTRUMENT
    base = np.tile(behind.mode, (rows.size, 1))
    base[:, :branches] = points[:, :branches]
    base[:, branches:inner] = 0.0
    at = inner
    if "gain" in behind.effects:
        # its logarithm is what was sampled
        base[:, at] = np.exp(points[:, -1])
        before -= points[:, -1]
        at += 1
    if behind.noise is not None:
        base[:, at:] = points[:, branches : branches + behind.noise.mode.size]
    if rng is None:
        return _weighed(behind, base, theta, before)
    by_theta, by_tau = _response(behind)
    middle, centre = base.mean(axis=0), theta.mean(axis=0)
    sets = []
    for stretch in STRETCHES:
        # draws that are spread wider have the density they came from, but for a constant
        machine = _machines(behind, rows.size, rng)
        there = middle + stretch * (base - middle)
        there[:, :branches] += machine @ by_tau.T
        there[:, branches:inner] = machine
        moved = centre + stretch * (theta - centre) + machine @ by_theta.T
        sets.append(_weighed(behind, there, np.ascontiguousarray(moved), before))
    return pooled([one for one, _ in sets]), np.vstack([places for _, places in sets])


def _weighed(
    behind: Behind, points: FloatArray, theta: FloatArray, before: FloatArray
) -> tuple[Weighted, FloatArray]:
    """Points and theta by their density over that of their proposal."""
    level = _densities(behind, points, theta) - before
    if not np.isfinite(level).any():
        level[:] = 0.0
    weights = np.exp(level - level.max())
    weights, shape = smoothed(weights / weights.sum())
    shape = shape if math.isfinite(shape) else 1.0
    return Weighted(points[:, behind.free], theta, weights, 1.0 / float((weights**2).sum()), shape), points


def propagated_draws(
    behind: Behind, drawn: Redrawn, points: FloatArray, rng: np.random.Generator
) -> tuple[Weighted, FloatArray]:
    """Draws with an instrument of the prior, moved along the response to it, of equal weight where passive.

    Uncertainty is propagated to first order (GUM, JCGM 100:2008, section 5); what the data would say of the
    instrument is left out.

    Parameters
    ----------
    behind, drawn, points, rng
        As for :func:`carried_draws`.
    """
    branches, inner = behind.branches, behind.branches + INSTRUMENT
    by_theta, by_tau = _response(behind)
    machine = _machines(behind, points.shape[0], rng)
    base = np.tile(behind.mode, (points.shape[0], 1))
    base[:, :branches] = points[:, :branches] + machine @ by_tau.T
    base[:, branches:inner] = machine
    at = inner
    if "gain" in behind.effects:
        base[:, at] = np.exp(points[:, -1])
        at += 1
    if behind.noise is not None:
        base[:, at:] = points[:, branches : branches + behind.noise.mode.size]
    theta = np.ascontiguousarray(drawn.linear + machine @ by_theta.T)
    good = passive(theta, behind.blocks) & np.isfinite(behind.log_priors(base))
    count = int(good.sum())
    converged = count >= LEAST_PASSIVE * good.size
    rows = np.flatnonzero(good) if count else np.arange(good.size)
    equal = np.full(rows.size, 1.0 / rows.size)
    shape = 0.0 if converged else 1.0
    found = Weighted(base[rows][:, behind.free], theta[rows], equal, float(count), shape, propagated=True)
    return found, base[rows]
