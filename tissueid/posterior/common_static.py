"""A static curve for logs that have a free cubic each: the passive one that comes closest to all of them.

The logs' own cubics leave nothing of a common curve in the likelihood.  Given everything else it is the
least-squares fit to them, weighted as their samples weigh them, and as uncertain as what it leaves of the
force says: the scatter between logs is in it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.instrument_kernels import EFFECTS
from tissueid.likelihood.knot_terms import log_terms, without_effects
from tissueid.likelihood.passive_normal import draw_passive
from tissueid.model.kelvin_voigt import STATIC_DEGREE
from tissueid.posterior.instrument import Behind, inverse

__all__ = ["common_static"]

FloatArray = NDArray[np.float64]


def common_static(
    behind: Behind, points: FloatArray, theta: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """One draw of the common static curve for each draw of everything else.

    Parameters
    ----------
    behind : Behind
        Of logs with a free cubic each.
    points : ndarray, shape (n, d)
    theta : ndarray, shape (n, p)
        Stiffness coefficients by powers of u.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, shape (n, 3)
        Coefficients by powers of u.
    """
    n = points.shape[0]
    mean = np.empty((n, STATIC_DEGREE))
    covariance = np.empty((n, STATIC_DEGREE, STATIC_DEGREE))
    ones = np.ones(behind.data.gamma.size)
    for i, point in enumerate(points):
        tau, instrument, gain_sd = behind.split(point)
        gram, pull, square = log_terms(behind.data, np.ascontiguousarray(theta[i]), tau, instrument, EFFECTS)
        back = without_effects(gram, pull, square, ones, *behind.effect_prior(gain_sd), behind.sigma2)[3]
        effect = back[:, :, 0]
        own = behind.data.own + effect
        weighted = np.einsum("lij,lj->li", gram, own)
        curvature = gram[:, 1:, 1:].sum(axis=0)
        pulled = weighted[:, 1:].sum(axis=0)
        spread = inverse(curvature)
        mean[i] = spread @ pulled
        left = square.sum() - 2.0 * (effect * pull).sum() + np.einsum("li,lij,lj->", effect, gram, effect)
        left += (own * weighted).sum() - mean[i] @ pulled
        covariance[i] = spread * max(float(left), 0.0) / max(behind.count - STATIC_DEGREE, 1)
    return draw_passive(mean, covariance, np.array([STATIC_DEGREE], dtype=np.int64), rng)[0]
