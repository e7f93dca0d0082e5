"""Which source gives how much of the uncertainty.

Let v(S) be the variance of a parameter when the sources in S are as uncertain as their priors leave them
and all others are known exactly; near the mode this is one small matrix a subset.  With none there is the
noise, with all the total, and a source's share is what v grows by when it joins, averaged over all orders
in which sources can join: its Shapley value (Owen & Prieur 2017, doi 10.1137/16M1097717).  An instrument's
delay and its filter stand in for each other, so that neither matters much while the other is unknown; this
average divides what they do together.  Shares are never negative, since knowing less never helps, and sum
to one.

They are applied to the variance of the total draws, which know the nonlinearity; of a prior that is cut,
the standard deviation after the cut counts.  Gains of force and displacement are independent of all else.
Priors of the tissue and of relaxation times count as noise: unless they are stated they say nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from math import factorial

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.instrument_kernels import ALL, INSTRUMENT
from tissueid.likelihood.knot_terms import log_terms, without_effects
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt, branch_suffix
from tissueid.posterior.calibration import TotalPosterior, truncated_moments
from tissueid.posterior.instrument import Behind, inverse
from tissueid.posterior.reported import reported_draws
from tissueid.uncertainty import BudgetRow

__all__ = ["SOURCES", "TOTAL", "reported", "reported_names", "shapley", "uncertainty_budget"]

FloatArray = NDArray[np.float64]

SOURCES = (
    "noise", "scatter between logs", "contact points", "force gain", "displacement gain", "time skew",
    "force filter", "frame",
)  # fmt: skip
TOTAL = "total"
SCATTER, CONTACTS = SOURCES[1:3]
#: Sources whose effects depend on each other.
ENTANGLED = (SCATTER, CONTACTS, *SOURCES[5:])
#: Precision of what is known, over that of what is not.
KNOWN = 1e12


def reported_names(model: KelvinVoigt) -> tuple[str, ...]:
    """Reported parameters: viscosities first, then those of the contact model."""
    eta = tuple(f"viscosity_N_s_per_mm{branch_suffix(j)}" for j in range(model.branches))
    return (*eta, *model.parameter_names)


def reported(model: KelvinVoigt, theta: FloatArray) -> FloatArray:
    """Reported parameters of draws of theta.

    Parameters
    ----------
    model : KelvinVoigt
    theta : ndarray, shape (n, p)

    Returns
    -------
    ndarray, shape (n, branches + p)
        In the order of :func:`reported_names`.
    """
    found = reported_draws(model, theta)
    return np.column_stack([found[name] for name in reported_names(model)])


class _Variances:
    """v(S) for the sources that are entangled: scatter, contact points, skew, filter, frame."""

    def __init__(self, behind: Behind, slopes: FloatArray) -> None:
        self.behind = behind
        self.slopes = slopes
        tau, instrument, gain_sd = behind.split(behind.mode)
        self.terms = log_terms(behind.data, behind.theta, tau, instrument, ALL)
        self.prior = behind.effect_prior(gain_sd)
        self.tissue = behind.tissue_prior(tau)[1]

    def __call__(self, joined: tuple[bool, ...]) -> FloatArray:
        """Variance of every reported parameter, shape (r,)."""
        behind = self.behind
        precision = self.prior[0].copy()
        for q, name in enumerate(self.effect_sources()):
            if not joined[ENTANGLED.index(name)]:
                precision[:, q] = KNOWN * np.maximum(precision[:, q], self.terms[0][:, q, q] / behind.sigma2)
        ones = np.ones(precision.shape[0])
        curvature = without_effects(*self.terms, ones, precision, self.prior[1], behind.sigma2)[0]
        p, branches = behind.theta.size, behind.branches
        curvature[:p, :p] += self.tissue
        for j, stated in enumerate(behind.priors.relaxation_time_s[:branches]):
            curvature[p + j, p + j] += stated.sd_ln**-2.0
        free = np.ones(p + branches + INSTRUMENT, dtype=np.bool_)
        for k, one in enumerate(behind.calibration):
            at = p + branches + k
            free[at] = one.sd > 0.0 and joined[2 + k]
            if free[at]:
                curvature[at, at] += truncated_moments(one)[1] ** -2.0
        part = np.ix_(free, free)
        slopes = self.slopes[:, free]
        variance = np.einsum("ri,ij,rj->r", slopes, inverse(curvature[part]), slopes)
        return np.asarray(np.maximum(variance, 0.0))

    def effect_sources(self) -> list[str]:
        """Source of each effect of a log."""
        sources = [SCATTER] if "gain" in self.behind.effects else []
        if "offset" in self.behind.effects:
            sources.append(CONTACTS)
        return sources + [SCATTER] * (self.prior[0].shape[1] - len(sources))


def shapley(variance: Callable[[tuple[bool, ...]], FloatArray], players: int) -> FloatArray:
    """Growth of a variance by each player, averaged over all orders in which they can join.

    Parameters
    ----------
    variance : callable
        Which players have joined -> variances, shape (r,).
    players : int

    Returns
    -------
    ndarray, shape (players, r)
    """
    value = {joined: variance(joined) for joined in product((False, True), repeat=players)}
    out = np.zeros((players, value[(False,) * players].size))
    for joined, before in value.items():
        size = sum(joined)
        weight = (
            factorial(size) * factorial(players - size - 1) / factorial(players) if size < players else 0.0
        )
        for k in range(players):
            if not joined[k]:
                after = value[(*joined[:k], True, *joined[k + 1 :])]
                out[k] += weight * np.maximum(after - before, 0.0)
    return out


def _slopes(behind: Behind) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the reported parameters by v, shape (r, v), and by ln gains, shape (r, 2)."""
    model, optimum = behind.model, behind.optimum
    p = behind.theta.size
    size = optimum.degree + 1
    tau = np.exp(behind.mode[: behind.branches])
    rows = STATIC_DEGREE + behind.branches * model.block
    by_v = np.zeros((rows, p + behind.branches + INSTRUMENT))
    by_gain = np.zeros((rows, 2))
    theta = np.zeros(rows)
    for k in range(optimum.static):
        by_v[k, k] = optimum.scale ** -(k + 1.0)
        theta[k] = by_v[k, k] * behind.theta[k]
        by_gain[k] = -theta[k], (k + 1.0) * theta[k]
    for j in range(behind.branches):
        first = STATIC_DEGREE + j * model.block
        for k in range(size):
            at = optimum.static + j * size + k
            by_v[first + k, at] = optimum.scale**-k
            theta[first + k] = by_v[first + k, at] * behind.theta[at]
            by_gain[first + k] = -theta[first + k], (k + 1.0) * theta[first + k]
        by_v[first + size, p + j] = tau[j]
        theta[first + size] = tau[j]
    # viscosities by central differences of what is reported: they are products
    step = 1e-6 * np.maximum(np.abs(theta), 1e-12)
    moved = reported(model, theta + np.diag(step)) - reported(model, theta - np.diag(step))
    jacobian = moved.T / (2.0 * step)
    return jacobian @ by_v, jacobian @ by_gain


def uncertainty_budget(total: TotalPosterior) -> tuple[BudgetRow, ...]:
    """The budget of every reported parameter, viscosity first.

    Parameters
    ----------
    total : TotalPosterior

    Returns
    -------
    tuple of BudgetRow
        For each parameter the sources of :data:`SOURCES` and then ``total``, whose share is 1.
    """
    behind = total.behind
    by_v, by_gain = _slopes(behind)
    gain_sd = np.array([behind.priors.calibration[n].sd for n in ("force_gain", "displacement_gain")])
    variance = _Variances(behind, by_v)
    scatter, contacts, *instrument = shapley(variance, len(ENTANGLED))
    noise = variance((False,) * len(ENTANGLED))
    parts = np.array([noise, scatter, contacts, *(by_gain * gain_sd).T ** 2, *instrument])
    sums = parts.sum(axis=0)
    shares = parts / np.where(sums > 0.0, sums, 1.0)
    sds = reported(behind.model, total.theta).std(axis=0, ddof=1)
    rows = []
    for r, name in enumerate(reported_names(behind.model)):
        for source, share in zip(SOURCES, shares[:, r], strict=True):
            rows.append(BudgetRow(name, source, float(np.sqrt(share) * sds[r]), float(share)))
        rows.append(BudgetRow(name, TOTAL, float(sds[r]), 1.0))
    return tuple(rows)
