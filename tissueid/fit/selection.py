"""How many branches, and of what degree K is: chosen by what a model predicts, not by how it fits.

Every candidate predicts each log from the others (leave one log out); a specimen with one log is cut
into interleaved stretches of its ramp and hold instead, or, where its noise is known, judged by BIC.  The
score is the log predictive density, the random effects of the held-out log integrated out.  From the
simplest candidate on, one branch or one degree is added as long as that predicts better than chance would
have it: by two standard errors between logs, or, where the sums are whitened for the noise, by :data:`CLEAR`
(what shows in a few logs only scatters between logs as much as it counts).  A better NRMSD never decides: it
always prefers the larger model.  Models that predict somewhat better than the chosen one, but not beyond
chance, are named beside it: the choice is then undecided.

Ramps of one speed to one depth can't tell F_s(x) from K(x) s(x) but by the form of their polynomials: there
a contact point that is off by its error, or noise in the displacement, is told as stiffness that varies with
depth, and moves viscosity by a factor of three.  So K is constant there, unless a varying K takes
:data:`SEEN` off the residual, which such errors do not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Candidate, Solution, SpecimenSums, fit_candidate, refit
from tissueid.fit.held_out import held_out_scores
from tissueid.uncertainty import NoiseFit

__all__ = [
    "IDLE",
    "NEGLIGIBLE",
    "SEEN",
    "STANDARD_ERRORS",
    "Choice",
    "as_good",
    "choose",
    "has_idle_branch",
    "judged",
]

FloatArray = NDArray[np.float64]

#: Difference of log predictive density that decides nothing, however small its scatter.
NEGLIGIBLE = 4.0
STANDARD_ERRORS = 2.0
#: Difference that decides under known noise: a true gain of S^2 / 2 scatters by S, and this is two of these.
CLEAR = 8.0
#: A gain below this is that of a model which only has more parameters (more in one of twenty cases).
HINT = 2.0
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
    candidates : tuple of Solution
        Those of the table, in its order.
    undecided : tuple of Candidate
        Models that these data can't rule out beside the chosen one; none where the choice is clear.
    idle : tuple of Solution
        Candidates with a branch that says nothing.
    """

    solution: Solution
    table: tuple[dict[str, float | int | bool | None], ...]
    candidates: tuple[Solution, ...] = ()
    undecided: tuple[Candidate, ...] = ()
    idle: tuple[Solution, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """One candidate that was fitted, and its held-out scores."""

    solution: Solution
    scores: FloatArray

    @property
    def candidate(self) -> Candidate:
        return self.solution.candidate


def _scatter(difference: FloatArray) -> float:
    """Standard error of a sum of differences between held-out units; 0 where there is one."""
    return float(difference.std(ddof=1) * np.sqrt(difference.size)) if difference.size > 1 else 0.0


def _table(tried: list[_Tried], chosen: _Tried) -> tuple[dict[str, float | int | bool | None], ...]:
    best = max(tried, key=lambda one: float(one.scores.sum()))
    rows: list[dict[str, float | int | bool | None]] = []
    for one in tried:
        difference = one.scores - best.scores
        rows.append(
            {
                "branches": one.candidate.branches,
                "stiffness_degree": one.candidate.degree,
                "score": float(difference.sum()),
                "stderr": _scatter(difference),
                "chosen": one is chosen,
            }
        )
    return tuple(rows)


def as_good(simple: FloatArray, other: FloatArray, *, known_noise: bool) -> bool:
    """True where ``other`` predicts no better than chance would have it.

    It does better where its advantage exceeds two standard errors, or where every unit that was held
    out is predicted better by more than :data:`NEGLIGIBLE` (of two logs, two standard errors say little),
    or under known noise where it exceeds :data:`CLEAR`.
    """
    difference = other - simple
    gain = float(difference.sum())
    if known_noise and gain > CLEAR:
        return False
    by_chance = gain <= max(STANDARD_ERRORS * _scatter(difference), NEGLIGIBLE)
    return by_chance and not float(difference.min()) > NEGLIGIBLE


def judged(sums: SpecimenSums, solution: Solution) -> Solution:
    """What predicts a held-out log: under per-log pooling it has no static curve, a shared one does."""
    if solution.candidate.pooling != "per-log":
        return solution
    shared = replace(solution.candidate, pooling="shared")
    return fit_candidate(sums, shared, seeds=[solution.evaluation.log_tau])


def has_idle_branch(sums: SpecimenSums, solution: Solution) -> bool:
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


def _scores(sums: SpecimenSums, solution: Solution, *, known_noise: bool) -> FloatArray:
    """Held-out scores, or for one log under known noise minus half of its BIC."""
    predicting = judged(sums, solution)
    if not known_noise or sums.logs.size > 1:
        return held_out_scores(sums, predicting)
    n, sigma2 = float(sums.n), predicting.noise.sigma2
    penalty = solution.candidate.n_parameters * np.log(n)
    return np.array(
        [-0.5 * (n * np.log(2.0 * np.pi * sigma2) + predicting.evaluation.value / sigma2 + penalty)]
    )


def _undecided(tried: list[_Tried], chosen: _Tried) -> tuple[Candidate, ...]:
    """Models that predict better than the chosen one, or no worse with no more parameters."""
    out = []
    for one in tried:
        gain = float((one.scores - chosen.scores).sum())
        simple = one.candidate.n_parameters <= chosen.candidate.n_parameters
        if one is not chosen and (gain > HINT or (simple and gain > -HINT)):
            out.append(one.candidate)
    return tuple(out)


class _Search:
    """Candidates that were tried, each fitted once."""

    def __init__(
        self,
        sums: SpecimenSums,
        pooling: str,
        known_noise: bool,
        progress: Callable[[str], None] | None,
        start: Sequence[Solution],
        ready: Sequence[Solution],
    ) -> None:
        self.sums, self.pooling, self.known_noise, self.progress = sums, pooling, known_noise, progress
        self.start, self.ready = (
            {(one.candidate.branches, one.candidate.degree): one for one in some} for some in (start, ready)
        )
        self.fitted: dict[tuple[int, int], _Tried | None] = {}
        self.idle: list[Solution] = []

    def fit(self, branches: int, degree: int) -> Solution:
        """One candidate, started from the simpler ones."""
        if self.progress is not None:
            self.progress(f"{branches} branch{'es' if branches > 1 else ''}, K of degree {degree}")
        if (branches, degree) in self.ready:
            return self.ready[branches, degree]
        if (branches, degree) in self.start:
            return refit(self.sums, self.start[branches, degree])
        seeds = [
            one.solution.evaluation.log_tau
            for (count, _), one in self.fitted.items()
            if one is not None and count in (branches, branches - 1)
        ]
        candidate = Candidate(branches=branches, degree=degree, pooling=self.pooling)
        return fit_candidate(self.sums, candidate, seeds=seeds)

    def tried(self, branches: int, degree: int, *, fewest: int) -> _Tried | None:
        """The same with its scores; ``None`` where a branch more than the fewest says nothing."""
        key = (branches, degree)
        if key not in self.fitted:
            solution = self.fit(branches, degree)
            if branches > fewest and has_idle_branch(self.sums, solution):
                self.idle.append(solution)
                self.fitted[key] = None
            else:
                scores = _scores(self.sums, solution, known_noise=self.known_noise)
                self.fitted[key] = _Tried(solution, scores)
        return self.fitted[key]

    def better(self, near: Sequence[_Tried | None], than: _Tried, *, flattest: int | None) -> list[_Tried]:
        """Neighbours that predict better; one whose K varies with depth must show it, if it may.

        ``flattest`` is the least degree where depth and speed vary together, else ``None``.
        """
        flat = min(
            one.solution.noise.sigma2
            for one in self.fitted.values()
            if one is not None and flattest in (None, one.candidate.degree)
        )
        out = []
        for one in near:
            if one is None or as_good(than.scores, one.scores, known_noise=self.known_noise):
                continue
            bends = flattest is not None and one.candidate.degree > flattest
            if not (bends and one.solution.noise.sigma2 > (1.0 - SEEN) ** 2 * flat):
                out.append(one)
        return out


def choose(
    sums: SpecimenSums,
    *,
    branches: tuple[int, ...],
    degrees: tuple[int, ...],
    pooling: str,
    one_speed: bool = False,
    noise: NoiseFit | None = None,
    start: Sequence[Solution] = (),
    ready: Sequence[Solution] = (),
    progress: Callable[[str], None] | None = None,
) -> Choice:
    """The simplest candidate that predicts about as well as the best of its neighbours.

    Parameters
    ----------
    sums : SpecimenSums
        With at least two units where there is more than one candidate and the noise is not known.
    branches, degrees : tuple of int
        What to try, ascending without gaps; one value each means there is nothing to choose.
    pooling : str
        ``partial``, ``shared`` or ``per-log``.
    one_speed : bool
        True where all ramps have one speed and all holds one depth: K then varies with depth only where
        that takes :data:`SEEN` off the residual.
    noise : NoiseFit, optional
        The noise that the sums are whitened for; ``None`` while it is not known.
    start : sequence of Solution
        Candidates that were fitted before the noise was known.
    ready : sequence of Solution
        Candidates that were fitted to these very sums.
    progress : callable, optional
        Told the name of each candidate before it is fitted.

    Returns
    -------
    Choice
    """
    known = noise is not None
    search = _Search(sums, pooling, known, progress, start, ready)
    fewest, flattest = branches[0], degrees[0]
    if len(branches) * len(degrees) == 1:
        return Choice(solution=search.fit(fewest, flattest), table=())
    current = search.tried(fewest, flattest, fewest=fewest)
    assert current is not None  # noqa: S101
    while True:
        here = current.candidate
        ways = [(here.branches + 1, here.degree), (here.branches, here.degree + 1)]
        near = [search.tried(*way, fewest=fewest) for way in ways if way[0] in branches and way[1] in degrees]
        better = search.better(near, current, flattest=flattest if one_speed else None)
        if not better:
            break
        current = max(better, key=lambda one: float(one.scores.sum()))
    tried = [one for one in search.fitted.values() if one is not None]
    simpler = sorted(tried, key=lambda one: one.candidate.n_parameters)
    chosen = next(
        one for one in simpler if one is current or as_good(one.scores, current.scores, known_noise=known)
    )
    return Choice(
        solution=chosen.solution,
        table=_table(tried, chosen),
        candidates=tuple(one.solution for one in tried),
        undecided=_undecided(tried, chosen),
        idle=tuple(search.idle),
    )
