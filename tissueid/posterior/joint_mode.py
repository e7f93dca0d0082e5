"""Whether a specimen is linearised where its posterior is, and where to linearise it else.

Gains and contact offsets enter the force as products with the tissue's coefficients; their columns are
derivatives at one point (:mod:`tissueid.likelihood.linearise`).  Far from it, as where least squares ended at
a bound that the noise's memory or a prior leaves again, the linear force is not the model's.  How far off it
is at the mode of the posterior is a sum of squares over the samples, and the sums know it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.basis import KernelBasis
from tissueid.likelihood.cone import cone_least_squares
from tissueid.likelihood.lag_sums import LagSums
from tissueid.likelihood.linearise import Optimum, centre, effect_columns
from tissueid.likelihood.marginal import conditionals, draw_effects
from tissueid.likelihood.marginal_parts import prior_precision
from tissueid.likelihood.objective import cone_start
from tissueid.likelihood.partial import coefficients
from tissueid.likelihood.passive_normal import passive
from tissueid.likelihood.sums import N_STATIC, reduction
from tissueid.posterior.linear_priors import effect_prior
from tissueid.posterior.specimen_target import SpecimenTarget

__all__ = ["JointMode", "joint_mode", "towards"]

FloatArray = NDArray[np.float64]

#: Dual tolerance of the passive theta that is best.
NEAR_ENOUGH = 1e-9
#: Steps of gains and contact points towards the mode that are tried, as fractions of the whole: the linear
#: force may point too far, and along a ridge not far enough.
STEPS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.1, 0.03, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class JointMode:
    """Best tissue and effects at the mode of the sampled coordinates.

    Attributes
    ----------
    optimum : Optimum
        That point; its theta is the linearised force's.
    departure : float
        Distance between the linearised force at the mode and the model's, in standard deviations of the
        noise: no estimate is moved by more of its own standard deviations (Cauchy and Schwarz).
    """

    optimum: Optimum
    departure: float


def joint_mode(target: SpecimenTarget, logs: Sequence[LagSums], basis: KernelBasis) -> JointMode:
    """Where the posterior of a specimen is highest, and how wrong its force is there.

    Parameters
    ----------
    target : SpecimenTarget
        Its mode found.
    logs : sequence of LagSums
    basis : KernelBasis
        Of the sums.
    """
    data, about = target.data, target.optimum
    point = np.ascontiguousarray(target.mode[None])
    mean, covariance = (one[0] for one in conditionals(data, point))
    precision = np.ascontiguousarray(np.linalg.inv(covariance))
    theta = cone_least_squares(
        precision, precision @ mean, data.blocks, cone_start(data.blocks), NEAR_ENOUGH
    )[0]
    none = np.zeros((1, *data.effect_mean.shape))
    effects = draw_effects(data, point, theta[None], none)[0]
    linear = replace(about, theta=theta, log_tau=target.mode[: data.branches].copy())
    there = _with_effects(linear, about, effects, target)
    at = data.branches
    phi = math.tanh(float(target.mode[at + 1])) if data.has_phi else data.phi
    sigma2 = math.exp(2.0 * float(target.mode[at]))
    square = 0.0
    for i, one in enumerate(logs):
        off = centre(basis, one.degree, there, i) - centre(basis, one.degree, linear, i)
        off -= (effect_columns(basis, one.degree, about, target.effects, i) @ effects[i])[:-1]
        square += float(off @ one.whitened(phi)[0][:-1, :-1] @ off)
    return JointMode(there, math.sqrt(max(square, 0.0) / sigma2))


def towards(
    target: SpecimenTarget, there: Optimum, logs: Sequence[LagSums], basis: KernelBasis, centred: Optimum
) -> Optimum:
    """The best point on the way of gains and contact points to the mode, by the model's own force.

    Noise, scales and relaxation times are those of the mode; the tissue is the best passive one.

    Parameters
    ----------
    target : SpecimenTarget
    there : Optimum
        From :func:`joint_mode`.
    logs : sequence of LagSums
    basis : KernelBasis
    centred : Optimum
        Whose residuals stand in the sums.
    """
    exact = _Exact.at_mode(target, logs, basis, centred)
    about, tried = target.optimum, []
    for step in STEPS:
        point = replace(
            there,
            gamma=about.gamma + step * (there.gamma - about.gamma),
            delta=about.delta + step * (there.delta - about.delta),
        )
        value, theta = exact.best(point)
        tried.append((value, replace(point, theta=theta)))
    return max(tried, key=lambda one: one[0])[1]


def _with_effects(linear: Optimum, about: Optimum, effects: FloatArray, target: SpecimenTarget) -> Optimum:
    """The point that theta and the linear effects of every log stand for."""
    gamma, delta, theta, own = about.gamma, about.delta, linear.theta, about.own
    if "gain" in target.effects:
        gamma = gamma + effects[:, 0]
        # what all gains have in common moves the tissue as well: together they are exact
        common = float(effects[:, 0].mean())
        moved = (theta + common * about.theta) * math.exp(-common)
        theta = moved if passive(moved[None], target.data.blocks)[0] else theta
    if "offset" in target.effects:
        delta = delta + effects[:, -1]
    if "static" in target.effects:
        own = own + effects * about.scale ** -np.arange(float(own.shape[1]))
    return replace(linear, theta=np.ascontiguousarray(theta), gamma=gamma, delta=delta, own=own)


@dataclass(frozen=True, slots=True, eq=False)
class _Exact:
    """Density of tissue and effects by the model's own force, all else held at the mode.

    ``grams`` are of the columns of :func:`tissueid.likelihood.sums.reduction`, the force last, in the noise's
    standard deviations.
    """

    target: SpecimenTarget
    grams: Sequence[FloatArray]

    @classmethod
    def at_mode(
        cls, target: SpecimenTarget, logs: Sequence[LagSums], basis: KernelBasis, centred: Optimum
    ) -> _Exact:
        """Sums at the mode of the sampled coordinates."""
        data, grams = target.data, []
        at = data.branches
        phi = math.tanh(float(target.mode[at + 1])) if data.has_phi else data.phi
        sigma = math.exp(float(target.mode[at]))
        for i, one in enumerate(logs):
            columns = reduction(basis, target.mode[:at], degree=data.degree, columns_degree=one.degree)
            used = N_STATIC + at * (data.degree + 1)
            columns = np.delete(columns, slice(used, columns.shape[1] - 1), axis=1)
            # the residual and what was taken off it are the force
            columns[:-1, -1] += centre(basis, one.degree, centred, i)
            grams.append(columns.T @ one.whitened(phi)[0] @ columns / sigma**2)
        return cls(target, grams)

    def best(self, point: Optimum) -> tuple[float, FloatArray]:
        """Ln density at given gains and contact points, up to a constant, and its passive theta."""
        target, data = self.target, self.target.data
        precision = prior_precision(data, point.log_tau)
        curvature, pull = precision.copy(), precision @ data.prior_mean
        square = float(data.prior_mean @ pull)
        for i, gram in enumerate(self.grams):
            columns, _ = coefficients(
                float(point.gamma[i]), float(point.delta[i]), point.scale, point.degree, point.branches
            )
            columns = columns[:, columns.shape[1] - point.theta.size :]
            curvature += columns.T @ gram[:-1, :-1] @ columns
            pull += columns.T @ gram[:-1, -1]
            square += float(gram[-1, -1])
        theta = cone_least_squares(
            np.ascontiguousarray(curvature), pull, data.blocks, cone_start(data.blocks), NEAR_ENOUGH
        )[0]
        square += float(theta @ curvature @ theta - 2.0 * theta @ pull)
        mean, sd = effect_prior(point, target.facts, target.effects)
        if data.has_gain:
            sd[:, 0] = math.exp(float(target.mode[-1]))
        return -0.5 * (square + float(((mean / sd) ** 2).sum())), theta
