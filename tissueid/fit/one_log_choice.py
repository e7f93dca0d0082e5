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

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Candidate, Solution, SpecimenSums, fit_candidate, objective_for
from tissueid.fit.search import step_in_log_tau
from tissueid.fit.selection import SEEN, Choice, as_good, has_idle_branch, judged
from tissueid.likelihood.objective import Evaluation
from tissueid.likelihood.sums import N_STATIC, reduction

__all__ = ["choose_for_one_log"]

FloatArray = NDArray[np.float64]


def _held_out_pooled(q: FloatArray, evaluation: Evaluation, scale: float, degree: int) -> float:
    """Residual sum of squares of one held-out unit under one shared static curve."""
    branches = evaluation.log_tau.size
    powers = np.concatenate(
        [scale ** -np.arange(1.0, N_STATIC), np.tile(scale ** -np.arange(degree + 1.0), branches)]
    )
    beta = np.concatenate([[0.0], evaluation.theta * powers])
    return float(q[-1, -1] - 2.0 * beta @ q[:-1, -1] + beta @ q[:-1, :-1] @ beta)


def _stretch_scores(sums: SpecimenSums, solution: Solution) -> FloatArray:
    """Log predictive density of every stretch, predicted from the others; shape (stretches,).

    The relaxation times of the remaining stretches follow by one Gauss-Newton step from those of all; the
    linear parameters are solved anew.
    """
    candidate, noise = solution.candidate, solution.noise
    low, high = sums.log_tau_bounds
    groups = sums.held_out_groups()
    scores = np.empty(len(groups))
    for index, group in enumerate(groups):
        rest = sums.without(group)
        objective = objective_for(rest, candidate, noise)
        there = objective.evaluate(solution.evaluation.log_tau, solution.evaluation)
        step = np.clip(step_in_log_tau(there, objective.blocks), -1.0, 1.0)
        moved = objective.evaluate(np.clip(there.log_tau + step, low, high), there)
        there = moved if moved.value < there.value else there
        weights = reduction(
            sums.basis, there.log_tau, degree=candidate.degree, columns_degree=sums.columns_degree
        )
        used = N_STATIC + candidate.branches * (candidate.degree + 1)
        columns = np.concatenate([weights[:, :used], weights[:, -1:]], axis=1)
        value = 0.0
        for unit in group:
            q = columns.T @ sums.gram[unit] @ columns
            value += _held_out_pooled(q, there, sums.depth_mm, candidate.degree)
        count = float(sums.count[group].sum())
        scores[index] = -0.5 * (count * np.log(2 * np.pi * noise.sigma2) + value / noise.sigma2)
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
            if previous is not None and has_idle_branch(sums, solution):
                break
            seeds = [solution.evaluation.log_tau]
            score = _stretch_scores(sums, judged(sums, solution))
            solutions.append(solution)
            scores.append(score)
            if previous is not None and as_good(previous, score, known_noise=False):
                # one branch more did not predict better; two more will not either
                break
            previous = score
    admitted = _admitted(solutions, one_speed=one_speed)
    best = max(admitted, key=lambda i: float(scores[i].sum()))
    order = sorted(admitted, key=lambda i: (solutions[i].candidate.n_parameters, i))
    chosen = next(i for i in order if as_good(scores[i], scores[best], known_noise=False))
    return Choice(solution=solutions[chosen], table=_table(solutions, scores, chosen))
