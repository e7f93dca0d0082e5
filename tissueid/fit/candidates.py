"""One specimen's sums, the candidate models for them, and the fit of one candidate.

For ``partial`` pooling the noise variance and the spread of the gains are part of the fit: they
maximise the restricted marginal likelihood, alternating with the search over relaxation times.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.search import global_minimum, polish
from tissueid.likelihood import partial
from tissueid.likelihood.basis import TAU_ABOVE_LENGTH, TAU_BELOW_STEP, KernelBasis
from tissueid.likelihood.objective import (
    Evaluation,
    PartialObjective,
    PooledObjective,
    eliminate_static,
    per_log_gram,
    shared_gram,
)
from tissueid.likelihood.sums import N_STATIC

__all__ = [
    "Candidate",
    "Noise",
    "Solution",
    "SpecimenSums",
    "fit_candidate",
    "objective_for",
    "refit",
    "sum_of_logs",
]

FloatArray = NDArray[np.float64]

POOLINGS = ("partial", "shared", "per-log")
#: Spread of the log gain that is tried: from none to a factor of e.
GAIN_SD = np.geomspace(1e-4, 1.0, 41)
START_GAIN_SD = 0.1
#: A sum of squares from a Gram matrix is known to this fraction of the sum of squared forces: noise below
#: it can't be told from none.
VALUE_RESOLUTION = 1e-15
TINY_N2 = 1e-60
#: Groups of logs held out in turn at most.
MAX_GROUPS = 30
VARIANCE_ROUNDS = 6
#: Change of the gain's spread, relative, that counts as none.
VARIANCE_SETTLED = 0.02


@dataclass(frozen=True, slots=True)
class Candidate:
    """A model that could describe a specimen.

    Attributes
    ----------
    branches : int
    degree : int
        Of K(x).
    pooling : str
        ``partial``, ``shared`` or ``per-log``.
    """

    branches: int
    degree: int
    pooling: str

    @property
    def n_parameters(self) -> int:
        """Shared parameters: static, stiffness, relaxation times."""
        return 3 + self.branches * (self.degree + 2)


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise variance [N^2] and spread of the log gain."""

    sigma2: float
    gain_sd: float


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenSums:
    """Gram matrices of one specimen.

    Attributes
    ----------
    gram : ndarray, shape (units, m, m)
        One a log; for a specimen with one log, one a held-out group of its samples.
    count : ndarray of int, shape (units,)
        Samples in each.
    offset_sd_mm : ndarray, shape (units,)
        Standard deviation of each contact point.
    basis : KernelBasis
    columns_degree : int
    depth_mm : float
        Largest fitted depth.
    step_s, duration_s : float
        Finest sampling interval and longest log [s]: relaxation times are sought in
        [step / 5, 10 duration].
    single : bool
        True where the units are parts of one log.
    logs : ndarray of int
        Units that take part; the rest is held out.
    log_range : tuple of float or None
        Part of that range that the sums cover, where not all of it.
    """

    gram: FloatArray
    count: NDArray[np.int64]
    offset_sd_mm: FloatArray
    basis: KernelBasis
    columns_degree: int
    depth_mm: float
    step_s: float
    duration_s: float
    single: bool
    logs: NDArray[np.int64]
    log_range: tuple[float, float] | None = None

    @property
    def n(self) -> int:
        """Samples in the likelihood."""
        return int(self.count[self.logs].sum())

    @property
    def power(self) -> float:
        """Sum of squared forces [N^2]."""
        return float(self.gram[self.logs, -1, -1].sum())

    @property
    def log_tau_bounds(self) -> tuple[float, float]:
        """Range of ln(tau / s) that is searched."""
        if self.log_range is not None:
            return self.log_range
        return float(np.log(self.step_s / TAU_BELOW_STEP)), float(np.log(self.duration_s * TAU_ABOVE_LENGTH))

    def without(self, units: NDArray[np.int64]) -> SpecimenSums:
        """The same specimen with some units held out (nothing is copied)."""
        return replace(self, logs=np.setdiff1d(self.logs, units))

    def held_out_groups(self) -> list[NDArray[np.int64]]:
        """What is held out in turn: every log, or thirty groups of logs where there are more."""
        return [group for group in np.array_split(self.logs, min(self.logs.size, MAX_GROUPS)) if group.size]


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The fit of one candidate.

    Attributes
    ----------
    candidate : Candidate
    evaluation : Evaluation
    noise : Noise
    objective : PooledObjective or PartialObjective
        With the final weights of the random effects.
    """

    candidate: Candidate
    evaluation: Evaluation
    noise: Noise
    objective: PooledObjective | PartialObjective


def sum_of_logs(sums: SpecimenSums) -> FloatArray:
    """Gram matrix of all units that take part."""
    total = np.zeros(sums.gram.shape[1:])
    for i in sums.logs:
        total += sums.gram[i]
    return total


def objective_for(
    sums: SpecimenSums, candidate: Candidate, noise: Noise
) -> PooledObjective | PartialObjective:
    """What is minimised for a candidate with given variances."""
    if candidate.pooling == "partial":
        return PartialObjective(
            gram=sums.gram,
            basis=sums.basis,
            scale=sums.depth_mm,
            branches=candidate.branches,
            degree=candidate.degree,
            columns_degree=sums.columns_degree,
            weight_gain=noise.sigma2 / noise.gain_sd**2,
            weight_offset=noise.sigma2 / sums.offset_sd_mm[sums.logs] ** 2,
            logs=sums.logs,
        )
    shared = candidate.pooling == "shared"
    if shared or sums.single:
        gram = sum_of_logs(sums)
        pooled = shared_gram(gram) if shared else eliminate_static(gram, N_STATIC)
    else:
        pooled = per_log_gram(sums.gram, sums.logs)
    return PooledObjective(
        gram=pooled,
        basis=sums.basis,
        scale=sums.depth_mm,
        branches=candidate.branches,
        degree=candidate.degree,
        columns_degree=sums.columns_degree,
        static=shared,
    )


def _variance(sums: SpecimenSums, candidate: Candidate, value: float) -> float:
    """Noise variance: the (penalised) sum of squares over its degrees of freedom."""
    used = candidate.n_parameters
    if candidate.pooling == "per-log":
        used += 4 * sums.logs.size - 3
    floor = VALUE_RESOLUTION * sums.power / max(sums.n, 1) + TINY_N2
    return max(value / max(sums.n - used, 1), floor)


def _spread_of_gain(
    objective: PartialObjective, found: Evaluation, sigma2: float, offset_sd: FloatArray
) -> float:
    """The gain's standard deviation of highest restricted marginal likelihood."""
    terms = partial.marginal_terms(
        objective.reduced(found.log_tau),
        found.theta,
        found.gamma,
        found.delta,
        sigma2,
        GAIN_SD,
        offset_sd[objective.logs],
        objective.scale,
        objective.degree,
        objective.branches,
    )
    best = int(np.argmin(terms))
    if 0 < best < GAIN_SD.size - 1:
        left, here, right = terms[best - 1 : best + 2]
        bend = left - 2.0 * here + right
        shift = 0.5 * (left - right) / bend if bend > 0.0 else 0.0
        return float(GAIN_SD[best] * (GAIN_SD[1] / GAIN_SD[0]) ** np.clip(shift, -0.5, 0.5))
    return float(GAIN_SD[best])


def _with_variances(
    sums: SpecimenSums, candidate: Candidate, found: Evaluation, noise: Noise
) -> tuple[Evaluation, Noise]:
    """Relaxation times and variances of ``partial`` pooling in turn, from a first guess of both."""
    for _ in range(VARIANCE_ROUNDS):
        objective = objective_for(sums, candidate, noise)
        found = polish(objective, found.log_tau, sums.log_tau_bounds, warm=found)
        sigma2 = _variance(sums, candidate, found.value)
        gain_sd = _spread_of_gain(objective, found, sigma2, sums.offset_sd_mm)  # type: ignore[arg-type]
        settled = abs(np.log(gain_sd / noise.gain_sd)) < VARIANCE_SETTLED
        noise = Noise(sigma2=sigma2, gain_sd=gain_sd)
        if settled:
            break
    return found, noise


def refit(sums: SpecimenSums, solution: Solution) -> Solution:
    """The same candidate under other sums of the same logs, from where it ended.

    Parameters
    ----------
    sums : SpecimenSums
        As whitened for the noise.
    solution : Solution
    """
    candidate, found, noise = solution.candidate, solution.evaluation, solution.noise
    if candidate.pooling == "partial":
        found, noise = _with_variances(sums, candidate, found, noise)
    objective = objective_for(sums, candidate, noise)
    found = polish(objective, found.log_tau, sums.log_tau_bounds, warm=found)
    order = np.argsort(found.log_tau, kind="stable")
    if (order != np.arange(order.size)).any():
        found = objective.evaluate(found.log_tau[order])
    if candidate.pooling != "partial":
        noise = replace(noise, sigma2=_variance(sums, candidate, found.value))
    return Solution(candidate=candidate, evaluation=found, noise=noise, objective=objective)


def fit_candidate(
    sums: SpecimenSums, candidate: Candidate, *, seeds: list[FloatArray] | None = None
) -> Solution:
    """The best passive fit of one candidate.

    Parameters
    ----------
    sums : SpecimenSums
    candidate : Candidate
    seeds : list of ndarray, optional
        ln tau of solutions with as many branches, or one fewer.

    Returns
    -------
    Solution
    """
    bounds = sums.log_tau_bounds
    seeds = seeds or []
    if candidate.pooling != "partial":
        if candidate.branches > 2 and not any(seed.size == candidate.branches - 1 for seed in seeds):
            # three branches are searched for beside the best pair
            fewer = fit_candidate(sums, replace(candidate, branches=candidate.branches - 1))
            seeds = [*seeds, fewer.evaluation.log_tau]
        noise = Noise(sigma2=1.0, gain_sd=START_GAIN_SD)
        objective = objective_for(sums, candidate, noise)
        found = global_minimum(objective, bounds, seeds=seeds)
        noise = replace(noise, sigma2=_variance(sums, candidate, found.value))
        return Solution(candidate=candidate, evaluation=found, noise=noise, objective=objective)
    # without a branch a free curve for each log leaves nothing to start from
    free = "per-log" if candidate.branches else "shared"
    robust = fit_candidate(sums, replace(candidate, pooling=free), seeds=seeds)
    start = robust.evaluation.log_tau
    found = objective_for(sums, candidate, robust.noise).evaluate(start)
    found, noise = _with_variances(sums, candidate, found, robust.noise)
    objective = objective_for(sums, candidate, noise)
    shared = objective_for(sums, replace(candidate, pooling="shared"), noise)
    found = global_minimum(objective, bounds, scan=shared, seeds=[*seeds, start, found.log_tau])
    return Solution(candidate=candidate, evaluation=found, noise=noise, objective=objective)
