"""What the data determine: profile intervals of relaxation times.

A relaxation time counts as identified where its 95 % profile-likelihood interval is closed within
the range of search and narrower than one in ln tau (a factor e from end to end).  That rule flags
nearly every fit whose true relative error is 50 % and none of 10 % (statistics.md 4).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from tissueid.likelihood.objective import Evaluation, Objective

__all__ = [
    "LEVEL_95",
    "MAX_WIDTH",
    "ProfileInterval",
    "on_ridge",
    "profile_interval",
    "ridge_of",
    "width_of",
]

FloatArray = NDArray[np.float64]

#: 95 % point of chi-square with one degree of freedom.
LEVEL_95 = 3.841458820694124
#: Widest 95 % interval in the logarithm that counts as identified.
MAX_WIDTH = 1.0
#: First bracket, in standard errors, and its growth.
FIRST_BRACKET = 1.5
GROWTH = 1.6
SMALLEST_STEP = 1e-4


@dataclass(frozen=True, slots=True)
class ProfileInterval:
    """95 % profile-likelihood interval of one ln tau.

    Attributes
    ----------
    low, high : float
        Ends in ln(tau / s); the bound of the search where open.
    open_low, open_high : bool
        True where the likelihood never falls far enough before the bound.
    """

    low: float
    high: float
    open_low: bool
    open_high: bool

    @property
    def width(self) -> float:
        """Width in ln tau."""
        return self.high - self.low

    @property
    def identified(self) -> bool:
        """Closed, and narrower than :data:`MAX_WIDTH`."""
        return not (self.open_low or self.open_high) and self.width <= MAX_WIDTH


def width_of(estimate: float, stderr: float) -> float:
    """Width of the 95 % interval of the logarithm of a positive estimate, from its standard error."""
    if not (np.isfinite(stderr) and estimate > 0.0):
        return float("inf")
    return 2.0 * float(np.sqrt(LEVEL_95)) * stderr / estimate


def ridge_of(inverse: FloatArray, branch: int) -> FloatArray:
    """How all ln tau follow that of one branch, by the Gauss-Newton curvature.

    Parameters
    ----------
    inverse : ndarray, shape (branches, branches)
        Inverse curvature of ln tau.
    branch : int

    Returns
    -------
    ndarray, shape (branches,)
        One for the branch itself; zero where the curvature says nothing.
    """
    variance = inverse[branch, branch]
    known = np.isfinite(variance) and variance > 0.0
    ridge = inverse[:, branch] / variance if known else np.zeros(inverse.shape[0])
    ridge = np.where(np.isfinite(ridge), ridge, 0.0)
    ridge[branch] = 1.0
    return ridge


def on_ridge(
    log_tau: FloatArray, branch: int, ridge: FloatArray, at: float, bounds: tuple[float, float]
) -> FloatArray:
    """All ln tau, shape (branches,), where that of one branch is ``at``: along its ridge, within bounds."""
    point: FloatArray = np.clip(log_tau + ridge * (at - log_tau[branch]), *bounds)
    point[branch] = at
    return point


def profile_interval(
    objective: Objective,
    optimum: Evaluation,
    branch: int,
    *,
    sigma2: float,
    inverse: FloatArray,
    bounds: tuple[float, float],
) -> ProfileInterval:
    """Where the (penalised) sum of squares rises by ``3.84 sigma^2``, all other parameters following.

    Linear parameters and random effects are solved anew at each point.  Relaxation times of other
    branches move along the ridge of the Gauss-Newton curvature.

    Parameters
    ----------
    objective, optimum
        The fit.
    branch : int
        Which ln tau.
    sigma2 : float
        Noise variance [N^2].
    inverse : ndarray, shape (branches, branches)
        Inverse curvature of ln tau (times sigma2: its covariance).
    bounds : tuple of float
        Range of ln tau.
    """
    variance = inverse[branch, branch]
    ridge = ridge_of(inverse, branch)
    profile = _Profile(objective, optimum, branch, ridge, bounds, LEVEL_95 * sigma2)
    sd = float(np.sqrt(sigma2 * variance)) if np.isfinite(variance) and variance > 0.0 else np.inf
    first = float(np.clip(FIRST_BRACKET * sd, SMALLEST_STEP, 1.0))
    low, open_low = profile.end(-1.0, first)
    high, open_high = profile.end(1.0, first)
    return ProfileInterval(low=low, high=high, open_low=open_low, open_high=open_high)


@dataclass(slots=True)
class _Profile:
    """The objective along ln tau of one branch, above its optimum and a level."""

    objective: Objective
    optimum: Evaluation
    branch: int
    ridge: FloatArray
    bounds: tuple[float, float]
    target: float
    last: Evaluation = field(init=False)

    def rise(self, at: float) -> float:
        """Above the level, started from the point that was looked at last."""
        point = on_ridge(self.optimum.log_tau, self.branch, self.ridge, at, self.bounds)
        self.last = self.objective.evaluate(point, self.last)
        return self.last.value - self.optimum.value - self.target

    def end(self, direction: float, step: float) -> tuple[float, bool]:
        """Where the level is crossed on one side, and whether a bound comes first."""
        self.last = self.optimum
        bound = self.bounds[0] if direction < 0.0 else self.bounds[1]
        here = inside = self.optimum.log_tau[self.branch]
        while True:
            outside = here + direction * step
            reached = direction * (outside - bound) >= 0.0
            outside = bound if reached else outside
            if self.rise(outside) > 0.0:
                return self._between(inside, outside, step), False
            if reached:
                return bound, True
            inside, step = outside, step * GROWTH

    def _between(self, inside: float, outside: float, step: float) -> float:
        if self.rise(inside) > 0.0:
            # the objective is flat to its rounding: the step itself is the interval's end
            return outside
        try:
            return float(brentq(self.rise, inside, outside, xtol=1e-4 * max(step, 1e-3), rtol=1e-6))
        except ValueError:
            # started elsewhere, the same point came out below the level: rounding again
            return outside
