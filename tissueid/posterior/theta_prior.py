"""The prior density of a specimen's theta, so that a later stage can take another prior in its place."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.model.kelvin_voigt import STATIC_DEGREE
from tissueid.posterior.linear_priors import linear_prior
from tissueid.posterior.specimen_target import SpecimenTarget

__all__ = ["log_theta_prior"]

FloatArray = NDArray[np.float64]


def log_theta_prior(target: SpecimenTarget, theta: FloatArray) -> FloatArray:
    """Ln of the prior density of tissues, up to a constant of the specimen.

    The density is that of theta itself, in the units of the contact model and in tau rather than ln tau.  It
    holds on the passive set with ascending relaxation times inside their range: the mass that the set leaves
    of the normal does not depend on tau, because a weak branch's prior is around zero and only changes its
    size.  A static curve that is drawn in a second stage (logs with a curve each) has a flat prior.

    Parameters
    ----------
    target : SpecimenTarget
    theta : ndarray, shape (n, p)
        In the order of the contact model.

    Returns
    -------
    ndarray, shape (n,)
    """
    optimum, priors, facts = target.optimum, target.priors, target.facts
    size, static = optimum.degree + 1, optimum.static
    mean, precision, weak = linear_prior(priors, target.model, optimum, facts)
    powers = theta[:, :static] * optimum.scale ** np.arange(1.0, static + 1)
    away = powers - mean[:static]
    value = -0.5 * np.einsum("ni,ij,nj->n", away, precision[:static, :static], away)
    for j in range(optimum.branches):
        first = STATIC_DEGREE + j * target.model.block
        part = slice(static + j * size, static + (j + 1) * size)
        away = theta[:, first : first + size] * optimum.scale ** np.arange(float(size)) - mean[part]
        tau = theta[:, first + size]
        square = np.einsum("ni,ij,nj->n", away, precision[part, part], away)
        if weak[j]:
            length = np.multiply.outer(tau, facts.speed_mm_s)
            state = (-length * np.expm1(-facts.depth_mm / length)).max(axis=1)
            square *= state**2
            value += size * np.log(state)
        value -= 0.5 * square + np.log(tau)
        if j < len(priors.relaxation_time_s):
            stated = priors.relaxation_time_s[j]
            value -= 0.5 * ((np.log(tau) - math.log(stated.median)) / stated.sd_ln) ** 2
    return np.asarray(value)
