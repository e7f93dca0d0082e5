"""The passive mass of a posterior as a smooth surface over the sampled coordinates.

Where a passivity bound is active, the probability that the linear parameters are passive takes a hundred
times longer to work out than everything else in the density, and is known to a few hundredths only
(:mod:`tissueid.likelihood.passive_normal`).  Most of its logarithm is the squared distance from the passive
cone, a least-squares problem that is solved exactly at every point.  What is left is smooth: over the few
standard deviations of a posterior a cubic, fitted to a few hundred points, describes it better than any
single evaluation does.
"""

from __future__ import annotations

import math

import numpy as np

from tissueid.likelihood.marginal import log_shares
from tissueid.likelihood.objective import cone_start
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.posterior.surface import Surface, cubic_terms

__all__ = ["mass_surface"]

#: Points a coefficient is fitted to, and points that judge the fit.
POINTS_EACH = 5
JUDGES = 40
#: Width of the points in standard deviations of the Laplace approximation.
WIDTH = 1.3
#: Points further from the fit than so many median deviations are failures of single evaluations.
OUTLYING = 6.0
#: Error of ln mass from which the surface is not taken.
WORST_ERROR = 0.5
SEED = 1701


def mass_surface(target: SpecimenTarget) -> Surface | None:
    """The surface for a target whose mode is known.

    Returns
    -------
    Surface or None
        ``None`` where no bound is near (the mass is one, and costs nothing), or where a cubic does not
        describe it.
    """
    start = cone_start(target.data.blocks)
    if float(log_shares(target.data, target.mode[None, :], start)[0]) == -target.data.prior_log_mass:
        return None
    d = target.mode.size
    root = np.linalg.cholesky(target.covariance)
    terms = math.comb(d + 3, 3)
    z = WIDTH * np.random.default_rng(SEED).standard_normal((POINTS_EACH * terms + JUDGES, d))
    points = target.mode + z @ root.T
    inside = np.isfinite(target.log_prior(points))
    z, points = z[inside], points[inside]
    values = log_shares(target.data, np.ascontiguousarray(points), start)
    known = np.isfinite(values)
    z, values = z[known], values[known]
    judged = np.zeros(values.size, dtype=bool)
    judged[:: max(values.size // JUDGES, 1)] = True
    if (~judged).sum() < 2 * terms:
        return None
    design = cubic_terms(z)
    keep = ~judged
    for _ in range(3):
        coefficients = np.linalg.lstsq(design[keep], values[keep], rcond=None)[0]
        miss = np.abs(values - design @ coefficients)
        keep = ~judged & (miss <= OUTLYING * max(float(np.median(miss[keep])), 1e-6))
    error = float(1.4826 * np.median(miss[judged]))
    if not error <= WORST_ERROR:
        return None
    return Surface(
        centre=target.mode,
        whiten=np.linalg.inv(root).T,
        coefficients=np.asarray(coefficients, dtype=np.float64),
        radius=float(np.quantile(np.sqrt((z**2).sum(axis=1)), 0.9)),
        error=error,
    )
