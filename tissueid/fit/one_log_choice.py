"""How many branches and which degree of K one log carries: by stretches of it that are held out in turn.

A specimen with one log is cut into interleaved stretches of its ramp and hold, and every candidate predicts
each stretch from the others.  The score is the log predictive density under white noise: of one log, what a
model lacks can't be told from noise with memory, so the noise of a poor fit must not judge the better one.
Scores of neighbouring candidates differ by less than they scatter, so the simplest candidate within two
standard errors of the best is taken.  At one speed K is constant unless a varying K takes :data:`SEEN` off
the residual (see :mod:`tissueid.fit.selection`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Candidate, Noise, Solution, SpecimenSums, fit_candidate, objective_for
from tissueid.fit.search import step_in_log_tau
from tissueid.fit.selection import Choice
from tissueid.likelihood import partial
from tissueid.likelihood.objective import Evaluation, PartialObjective
from tissueid.likelihood.sums import N_STATIC, reduction

__all__ = ["choose_for_one_log"]

FloatArray = NDArray[np.float64]

#: Gauss-Newton rounds for the random effects of a held-out log.
EFFECT_ROUNDS = 12
#: Difference of log predictive density that decides nothing, however small its scatter.
NEGLIGIBLE = 4.0
STANDARD_ERRORS = 2.0
#: Share of the residual's standard deviation that a K varying with depth must take off at one speed: in
#: simulations errors of contact and displacement took off less than 0.01.
SEEN = 0.05
#: Stiffness of a branch, relative to the stiffest, that counts as none.
IDLE = 1e-9


def _held_out_partial(
    q: FloatArray, theta: FloatArray, objective: PartialObjective, noise: Noise, offset_sd: float
) -> tuple[float, float]:
    """Penalised residual of one held-out log and ln det of what integrating its effects costs."""
    gamma, delta = 0.0, 0.0
    m = q.shape[0] - 1
    prior = np.array([noise.sigma2 / noise.gain_sd**2, noise.sigma2 / offset_sd**2])
    value, curvature = np.inf, np.eye(2)
    for _ in range(EFFECT_ROUNDS):
        matrix, shifted = partial.coefficients(
            gamma, delta, objective.scale, objective.degree, objective.branches
        )
        beta = matrix @ theta
        moves = np.column_stack([beta, shifted @ theta])
        error = q[:m, -1] - q[:m, :m] @ beta
        effects = np.array([gamma, delta])
        new = float(q[-1, -1] - beta @ q[:m, -1] - beta @ error + prior @ effects**2)
        curvature = moves.T @ q[:m, :m] @ moves + np.diag(prior)
        if not new < value * (1 - 1e-12):
            value = min(new, value)
            break
        value = new
        gamma, delta = effects + np.linalg.solve(curvature, moves.T @ error - prior * effects)
    return value, float(np.linalg.slogdet(curvature)[1] - np.log(prior).sum())


def _held_out_pooled(q: FloatArray, evaluation: Evaluation, scale: float, degree: int) -> float:
    """Residual sum of squares of one held-out unit under one shared static curve."""
    branches = evaluation.log_tau.size
    powers = np.concatenate(
        [scale ** -np.arange(1.0, N_STATIC), np.tile(scale ** -np.arange(degree + 1.0), branches)]
    )
    beta = np.concatenate([[0.0], evaluation.theta * powers])
    return float(q[-1, -1] - 2.0 * beta @ q[:-1, -1] + beta @ q[:-1, :-1] @ beta)


def held_out_scores(sums: SpecimenSums, solution: Solution) -> FloatArray:
    """Log predictive density of every held-out group, predicted from the others; shape (groups,).

    The relaxation times of the remaining units follow by one Gauss-Newton step from those of all; the
    linear parameters and random effects are solved anew.
    """
    candidate, noise = solution.candidate, solution.noise
    low, high = sums.log_tau_bounds
    groups = sums.held_out_groups()
    scores = np.empty(len(groups))
    for index, group in enumerate(groups):
        rest = sums.without(group)
        objective = objective_for(rest, candidate, noise)
        warm = solution.evaluation
        if warm.gamma.size:
            keep = np.isin(sums.logs, rest.logs)
            warm = replace(warm, gamma=warm.gamma[keep], delta=warm.delta[keep])
        there = objective.evaluate(warm.log_tau, warm)
        step = np.clip(step_in_log_tau(there, objective.blocks), -1.0, 1.0)
        moved = objective.evaluate(np.clip(there.log_tau + step, low, high), there)
        there = moved if moved.value < there.value else there
        weights = reduction(
            sums.basis, there.log_tau, degree=candidate.degree, columns_degree=sums.columns_degree
        )
        used = N_STATIC + candidate.branches * (candidate.degree + 1)
        columns = np.concatenate([weights[:, :used], weights[:, -1:]], axis=1)
        value, cost = 0.0, 0.0
        for unit in group:
            q = columns.T @ sums.gram[unit] @ columns
            if isinstance(objective, PartialObjective):
                residual, extra = _held_out_partial(
                    q, there.theta, objective, noise, float(sums.offset_sd_mm[unit])
                )
                value, cost = value + residual, cost + extra
            else:
                value += _held_out_pooled(q, there, sums.depth_mm, candidate.degree)
        count = float(sums.count[group].sum())
        scores[index] = -0.5 * (count * np.log(2 * np.pi * noise.sigma2) + value / noise.sigma2 + cost)
    return scores


def _table(
    solutions: list[Solution], scores: list[FloatArray], chosen: int
) -> tuple[dict[str, float | int | bool | None], ...]:
    best = int(np.argmax([one.sum() for one in scores]))
    rows: list[dict[str, float | int | bool | None]] = []
    for i, (solution, score) in enumerate(zip(solutions, scores, strict=True)):
        difference = score - scores[best]
        rows.append(
            {
                "branches": solution.candidate.branches,
                "stiffness_degree": solution.candidate.degree,
                "score": float(difference.sum()),
                "stderr": float(difference.std(ddof=1) * np.sqrt(difference.size)),
                "chosen": i == chosen,
            }
        )
    return tuple(rows)


def _as_good(simple: FloatArray, other: FloatArray) -> bool:
    """True where ``other`` predicts no better than chance would have it.

    It does better where its advantage exceeds two standard errors, or where every unit that was held
    out is predicted better by more than :data:`NEGLIGIBLE` (of two logs, two standard errors say little).
    """
    difference = other - simple
    scatter = float(difference.std(ddof=1) * np.sqrt(difference.size))
    by_chance = float(difference.sum()) <= max(STANDARD_ERRORS * scatter, NEGLIGIBLE)
    return by_chance and not float(difference.min()) > NEGLIGIBLE


def _judged(sums: SpecimenSums, solution: Solution) -> Solution:
    """What predicts a held-out log: under per-log pooling it has no static curve, a shared one does."""
    if solution.candidate.pooling != "per-log":
        return solution
    shared = replace(solution.candidate, pooling="shared")
    return fit_candidate(sums, shared, seeds=[solution.evaluation.log_tau])


def _has_idle_branch(sums: SpecimenSums, solution: Solution) -> bool:
    """True where an added branch says nothing of the tissue.

    It came out without stiffness (the model with one branch fewer, named otherwise), or it is over
    between two samples, where it can only describe noise and corners that the log does not show.
    """
    if float(np.exp(solution.evaluation.log_tau.min())) < sums.step_s:
        return True
    shape = (solution.candidate.branches, solution.candidate.degree + 1)
    dynamic = solution.evaluation.theta[-shape[0] * shape[1] :].reshape(shape)
    stiffness = np.abs(dynamic).max(axis=1)
    return bool(stiffness.min() <= IDLE * stiffness.max())


def _admitted(solutions: list[Solution], *, one_speed: bool) -> list[int]:
    """Candidates whose K the program of the test can tell."""
    lowest = min(solution.candidate.degree for solution in solutions)
    flat = min(one.noise.sigma2 for one in solutions if one.candidate.degree == lowest)
    limit = (1.0 - SEEN) ** 2 * flat
    return [
        i
        for i, one in enumerate(solutions)
        if not one_speed or one.candidate.degree == lowest or one.noise.sigma2 <= limit
    ]


def choose_for_one_log(
    sums: SpecimenSums,
    *,
    branches: tuple[int, ...],
    degrees: tuple[int, ...],
    pooling: str,
    one_speed: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Choice:
    """Fit every candidate and take the simplest that predicts about as well as the best.

    Parameters
    ----------
    sums : SpecimenSums
        With at least two units where there is more than one candidate.
    branches, degrees : tuple of int
        What to try; one value each means there is nothing to choose.
    pooling : str
        ``partial``, ``shared`` or ``per-log``.
    one_speed : bool
        True where all ramps have one speed and all holds one depth.
    progress : callable, optional
        Told the name of each candidate before it is fitted.

    Returns
    -------
    Choice
    """
    solutions: list[Solution] = []
    scores: list[FloatArray] = []
    only = len(branches) * len(degrees) == 1
    for degree in degrees:
        seeds: list[FloatArray] = []
        previous: FloatArray | None = None
        for count in branches:
            if progress is not None:
                progress(f"{count} branch{'es' if count > 1 else ''}, K of degree {degree}")
            candidate = Candidate(branches=count, degree=degree, pooling=pooling)
            solution = fit_candidate(sums, candidate, seeds=seeds)
            if only:
                return Choice(solution=solution, table=())
            if previous is not None and _has_idle_branch(sums, solution):
                break
            seeds = [solution.evaluation.log_tau]
            score = held_out_scores(sums, _judged(sums, solution))
            solutions.append(solution)
            scores.append(score)
            if previous is not None and _as_good(previous, score):
                # one branch more did not predict better; two more will not either
                break
            previous = score
    admitted = _admitted(solutions, one_speed=one_speed)
    best = max(admitted, key=lambda i: float(scores[i].sum()))
    order = sorted(admitted, key=lambda i: (solutions[i].candidate.n_parameters, i))
    chosen = next(i for i in order if _as_good(scores[i], scores[best]))
    return Choice(solution=solutions[chosen], table=_table(solutions, scores, chosen))
