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
from tissueid.posterior.importance import Weighted, smoothed
from tissueid.posterior.instrument import Behind, inverse
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.posterior.target import Redrawn

__all__ = ["carried_draws"]

FloatArray = NDArray[np.float64]

#: Draws that are carried at the most, and machines that each is carried to.
MOST, MACHINES = 3_000, 2


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
    behind: Behind, target: SpecimenTarget, drawn: Redrawn, points: FloatArray, rng: np.random.Generator
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
    rng : numpy.random.Generator

    Returns
    -------
    Weighted
        Of the free coordinates, with theta as what is beside.
    points : ndarray, shape (m, d)
        In all coordinates.
    """
    rows = np.linspace(0, points.shape[0] - 1, min(points.shape[0], MOST)).astype(np.int64)
    points = np.ascontiguousarray(points[rows])
    theta = np.ascontiguousarray(drawn.linear[rows])
    before = log_joints(target.data, points, theta) + target.log_prior(points)
    branches, inner = behind.branches, behind.branches + INSTRUMENT
    base = np.tile(behind.mode, (rows.size, 1))
    base[:, :branches] = points[:, :branches]
    at = inner
    if "gain" in behind.effects:
        # its logarithm is what was sampled
        base[:, at] = np.exp(points[:, -1])
        before -= points[:, -1]
        at += 1
    if behind.noise is not None:
        base[:, at:] = points[:, branches : branches + behind.noise.mode.size]
    by_theta, by_tau = _response(behind)
    machine = _machines(behind, MACHINES * rows.size, rng)
    base, theta = np.tile(base, (MACHINES, 1)), np.tile(theta, (MACHINES, 1))
    base[:, :branches] += machine @ by_tau.T
    base[:, branches:inner] = machine
    theta = np.ascontiguousarray(theta + machine @ by_theta.T)
    level = _densities(behind, base, theta) - np.tile(before, MACHINES)
    if not np.isfinite(level).any():
        level[:] = 0.0
    weights = np.exp(level - level.max())
    weights, shape = smoothed(weights / weights.sum())
    # machines of one draw are no more than one
    each = weights.reshape(MACHINES, -1).sum(axis=0)
    shape = shape if math.isfinite(shape) else 1.0
    return Weighted(base[:, behind.free], theta, weights, 1.0 / float((each**2).sum()), shape), base
