"""How many branches, and of what degree K is: chosen by what a model predicts, not by how it fits.

Every candidate predicts each log from the others (leave one log out); a specimen with one log is cut
into interleaved stretches of its ramp and hold instead.  The score is the log predictive density
under white noise, the random effects of the held-out log integrated out.  Scores of neighbouring
candidates differ by less than they scatter, so the simplest candidate within two standard errors of
the best is taken.  A better NRMSD never decides: it always prefers the larger model.

Ramps of one speed to one depth can't tell F_s(x) from K(x) s(x) but by the form of their polynomials: there
a contact point that is off by its error, or noise in the displacement, is told as stiffness that varies with
depth, and moves viscosity by a factor of three.  So K is constant there, unless a varying K takes
:data:`SEEN` off the residual, which such errors do not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Candidate, Solution, SpecimenSums, fit_candidate
from tissueid.fit.held_out import held_out_scores

__all__ = ["Choice", "choose"]

FloatArray = NDArray[np.float64]

#: Difference of log predictive density that decides nothing, however small its scatter.
NEGLIGIBLE = 4.0
STANDARD_ERRORS = 2.0
#: Share of the residual's standard deviation that a K varying with depth must take off at one speed: in
#: simulations errors of contact and displacement took off less than 0.01.
SEEN = 0.05
#: Stiffness of a branch, relative to the stiffest, that counts as none.
IDLE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """A chosen candidate and the table it was chosen from.

    Attributes
    ----------
    solution : Solution
    table : tuple of dict
        One row a candidate: branches, stiffness_degree, score, stderr, chosen.
    """

    solution: Solution
    table: tuple[dict[str, float | int | bool | None], ...]


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


def choose(
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
