"""A specimen linearised at its optimum, as the compiled density takes it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Linearised"]

FloatArray = NDArray[np.float64]


class Linearised(NamedTuple):
    """A specimen linearised at its optimum, everything that the compiled density needs.

    Columns of the sums are: the static coefficients (3, or none), then for each branch and power of u the
    states at its nodes of ln tau, then the residual at the optimum; all in units of u = x / depth.

    Attributes
    ----------
    branches, degree, static : int
        Branches, degree of K, static coefficients (3 or 0).
    shared : ndarray, shape (kinds, m, m)
        Sums over logs; kinds as in :func:`tissueid.likelihood.lag_kernels.lag_weights`.
    cross : ndarray, shape (logs, kinds, q, m)
        Effects of a log by columns.
    own : ndarray, shape (logs, kinds, q, q)
    ratio : ndarray, shape (groups,)
        Distinct steps over the reference step.
    links : ndarray, shape (groups,)
        Links between samples of each step.
    samples : float
        Samples.
    best, best_tau : ndarray, shape (p,) and (branches,)
        Optimum, and its ln tau.
    nodes, barycentric : ndarray, shape (branches, q)
        Nodes of ln tau and their barycentric weights.
    mixing : ndarray, shape (branches, r, q)
        States at the nodes by those that are summed (:class:`tissueid.likelihood.linearise.TauNodes`).
    prior_mean : ndarray, shape (p,)
    prior_precision : ndarray, shape (p, p)
        A weak branch's block is given for a largest state of 1 mm.
    weak : ndarray of bool, shape (branches,)
    prior_log_mass : float
        ln of the prior's probability of the passive cone.
    speed_mm_s, depth_mm : ndarray, shape (ramps,)
        Ramps behind the largest state of a branch.
    effect_precision, effect_mean : ndarray, shape (logs, q)
        Priors of the effects; where the gain's spread is sampled, its column is replaced.
    phi, has_phi : float, bool
        Correlation where it is not sampled, and whether it is.
    has_gain : bool
        Whether the spread of the gains is sampled (the gain is then effect 0).
    blocks : ndarray of int
        Sizes of theta's polynomial blocks.
    """

    branches: int
    degree: int
    static: int
    shared: FloatArray
    cross: FloatArray
    own: FloatArray
    ratio: FloatArray
    links: FloatArray
    samples: float
    best: FloatArray
    best_tau: FloatArray
    nodes: FloatArray
    barycentric: FloatArray
    mixing: FloatArray
    prior_mean: FloatArray
    prior_precision: FloatArray
    weak: NDArray[np.bool_]
    prior_log_mass: float
    speed_mm_s: FloatArray
    depth_mm: FloatArray
    effect_precision: FloatArray
    effect_mean: FloatArray
    phi: float
    has_phi: bool
    has_gain: bool
    blocks: NDArray[np.int64]
