"""One specimen under several models: evidence, and how well each predicts what it has not seen.

*Evidence* is the integral of the posterior density of :mod:`tissueid.posterior.specimen_target` over all its
coordinates, coefficients and effects in closed form with the cut to the passive set, by importance sampling
from a Student-t at the mode (or from a fitted mixture where that covers badly).  *elpd* is the log predictive
density of logs, and of whole speeds, each predicted from the others (:mod:`tissueid.fit.held_out`).

A model is *worse* where its log evidence is lower by :data:`DECIDES` or more, or where it predicts logs worse
by more than two standard errors; otherwise it is *undecided* beside the chosen one.  Models that can't be
rendered stand *beside*.  A dashpot is a branch whose relaxation time is at the lower bound, a fifth of the
sampling step: its force is K tau times the speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import TissueidError
from tissueid.fit.candidates import Candidate, Solution, SpecimenSums, fit_candidate, objective_for
from tissueid.fit.estimates import in_field_units
from tissueid.fit.held_out import held_out_scores
from tissueid.fit.selection import NEGLIGIBLE, STANDARD_ERRORS
from tissueid.fit.specimen import FittedSpecimen, adjustments_of
from tissueid.fit.whitening import for_all_degrees, optimum_of
from tissueid.posterior.alternatives import FAMILIES, kernel_evidence
from tissueid.posterior.at_optimum import target_at
from tissueid.posterior.exact import sample_exact
from tissueid.posterior.target import Target
from tissueid.priors import Priors, SpreadPrior
from tissueid.result import SpecimenFit
from tissueid.uncertainty import ComparisonRow

__all__ = ["compare_models", "evidence", "rows_of_choice", "speed_groups"]

FloatArray = NDArray[np.float64]

#: Difference of log evidence that decides (odds of 20; Kass and Raftery 1995, doi 10.2307/2291091).
DECIDES = 3.0
#: Draws of the importance sampler, degrees of freedom of its Student-t, and how much wider it is.
DRAWS, FREEDOM, WIDER = 2000, 5.0, 1.2
#: Effective share of these draws below which a mixture is fitted instead.
LEAST_SHARE = 0.05
#: Speeds that differ by less than this factor are one speed.
SAME_SPEED = 1.05
#: A dashpot's relaxation time against the lower bound, and its prior's standard deviation in ln tau.
DASHPOT_ABOVE, DASHPOT_SD = 0.05, 0.01
MAX_BRANCHES, MAX_DEGREE = 3, 2


@dataclass(frozen=True, slots=True, eq=False)
class _Compared:
    words: str
    candidate: Candidate | None
    log_evidence: float | None
    log_evidence_se: float | None
    logs: FloatArray | None
    speeds: FloatArray | None


def evidence(target: Target, *, seed: int = 0) -> tuple[float, float]:
    """Ln of the integral of a target's density, and its Monte-Carlo standard error.

    Parameters
    ----------
    target : Target
    seed : int
    """
    rng = np.random.default_rng([seed, 3])
    d = target.mode.size
    root = np.linalg.cholesky(target.covariance) * math.sqrt(WIDER)
    z = rng.standard_normal((DRAWS, d)) / np.sqrt(rng.chisquare(FREEDOM, DRAWS) / FREEDOM)[:, None]
    log_proposal = (
        math.lgamma(0.5 * (FREEDOM + d))
        - math.lgamma(0.5 * FREEDOM)
        - 0.5 * d * math.log(FREEDOM * math.pi)
        - float(np.log(np.diag(root)).sum())
        - 0.5 * (FREEDOM + d) * np.log1p((z**2).sum(axis=1) / FREEDOM)
    )
    ratio = target.log_density(target.mode + z @ root.T) - log_proposal
    largest = float(np.max(ratio, initial=-np.inf, where=~np.isnan(ratio)))
    if math.isfinite(largest):
        weight = np.exp(np.where(np.isnan(ratio), -np.inf, ratio) - largest)
        share = float(weight.sum() ** 2 / (weight**2).sum()) / DRAWS
        if share >= LEAST_SHARE:
            return largest + math.log(weight.mean()), math.sqrt((1.0 / share - 1.0) / DRAWS)
    chain = sample_exact(target, draws=1, seed=seed)
    return chain.log_evidence, chain.log_evidence_se


def speed_groups(speed_mm_s: Sequence[float]) -> list[NDArray[np.int64]]:
    """Logs by their speed, ascending; speeds within :data:`SAME_SPEED` are one."""
    speed = np.asarray(speed_mm_s, dtype=np.float64)
    order = np.argsort(speed, kind="stable")
    new = np.diff(np.log(np.maximum(speed[order], 1e-300)), prepend=-np.inf) > math.log(SAME_SPEED)
    return [np.sort(group) for group in np.split(order, np.flatnonzero(new)[1:])]


def _words(candidate: Candidate) -> str:
    if candidate.branches == 0:
        return f"static force only, {candidate.pooling} static"
    number = "1 branch" if candidate.branches == 1 else f"{candidate.branches} branches"
    return f"{number}, K of degree {candidate.degree}, {candidate.pooling} static"


def _candidates(chosen: Candidate, *, highest: int, single: bool) -> list[Candidate]:
    """The chosen model and its neighbours along every choice."""
    # two branches more than the data ask for say nothing, and their posterior is wide and slow
    out = [replace(chosen, branches=b) for b in range(min(chosen.branches + 1, MAX_BRANCHES) + 1)]
    out += [replace(chosen, degree=d) for d in range(min(MAX_DEGREE, highest) + 1)]
    if not single:
        out += [replace(chosen, pooling=pooling) for pooling in ("partial", "shared", "per-log")]
    flat = [replace(one, degree=0) if one.branches == 0 else one for one in out]
    return [one for one in dict.fromkeys(flat) if one.branches or one.pooling != "per-log"]


class _Comparison:
    """One specimen under its whitened sums."""

    def __init__(self, fitted: FittedSpecimen, priors: Priors, seed: int) -> None:
        self.fitted, self.priors, self.seed = fitted, priors, seed
        self.sums: SpecimenSums = fitted.whitened.sums
        self.force = max(float(np.abs(trial.curve.force_N).max()) for trial in fitted.told.trials)
        logs = self.sums.logs.size
        speeds = [max(one.facts.speeds_mm_s) for one in fitted.handles]
        self.speeds = speed_groups(speeds) if logs == len(speeds) else []

    def solve(self, candidate: Candidate) -> Solution:
        """The fit of one candidate, from that of the chosen one."""
        chosen = self.fitted.whitened.solution
        if candidate == chosen.candidate:
            return chosen
        return fit_candidate(self.sums, candidate, seeds=[chosen.evaluation.log_tau])

    def integrate(self, solution: Solution, priors: Priors) -> tuple[float, float]:
        """Log evidence of a solution's model and its error."""
        fitted = self.fitted
        whitened = replace(fitted.whitened, solution=solution, sums=self.sums)
        model, theta, _, inverse, _ = in_field_units(self.sums, solution)
        adjustments = adjustments_of(self.sums, solution, (model, theta), fitted.handles)
        optimum = optimum_of(solution, adjustments, self.sums.depth_mm)
        variance = np.diag(inverse) * solution.noise.sigma2
        sd = np.sqrt(np.where(np.isfinite(variance), np.maximum(variance, 0.0), 1.0))
        target = target_at(whitened, optimum, fitted.handles, priors, log_tau_sd=sd, force_N=self.force)
        value, error = evidence(target, seed=self.seed)
        # the branches of a target are ascending: one of the orders that a uniform prior holds
        return value + math.lgamma(solution.candidate.branches + 1.0), error

    def predict(self, solution: Solution) -> tuple[FloatArray | None, FloatArray | None]:
        """Held-out scores by logs and by speeds; ``None`` where there is nothing to hold out."""
        candidate = solution.candidate
        if self.sums.logs.size < 2:
            return None, None
        if candidate.pooling == "per-log":
            shared = replace(candidate, pooling="shared")
            solution = fit_candidate(self.sums, shared, seeds=[solution.evaluation.log_tau])
        speeds = self.speeds if len(self.speeds) > 1 else None
        logs = held_out_scores(self.sums, solution)
        return logs, None if speeds is None else held_out_scores(self.sums, solution, speeds)

    def row(self, candidate: Candidate) -> _Compared:
        solution = self.solve(candidate)
        value, error = self.integrate(solution, self.priors)
        return _Compared(_words(candidate), candidate, value, error, *self.predict(solution))

    def dashpot(self) -> _Compared:
        """Static force and a dashpot of the chosen degree."""
        chosen = self.fitted.whitened.solution
        candidate = replace(chosen.candidate, branches=1)
        at = self.sums.log_tau_bounds[0] + DASHPOT_ABOVE
        noise = chosen.noise
        for _ in range(2):
            objective = objective_for(self.sums, candidate, noise)
            found = objective.evaluate(np.array([at]))
            noise = replace(noise, sigma2=found.value / max(self.sums.n - candidate.n_parameters + 1, 1))
        # it does not move: ln tau is known
        held = replace(found, gradient=np.zeros(1))
        solution = Solution(candidate=candidate, evaluation=held, noise=noise, objective=objective)
        known = replace(self.priors, relaxation_time_s=(SpreadPrior(math.exp(at), DASHPOT_SD),))
        value, error = self.integrate(solution, known)
        words = f"static force and a dashpot of degree {candidate.degree}, {candidate.pooling} static"
        return _Compared(words, None, value, error, *self.predict(solution))

    def beside(self, anchor: float) -> list[_Compared]:
        """Other kernels, by their difference to the chosen exponentials under the same arithmetic."""
        chosen = self.fitted.whitened.solution
        if chosen.candidate.pooling == "per-log" or chosen.candidate.branches == 0:
            return []
        speeds = [
            (s, one.facts.depth_mm) for one in self.fitted.handles for s in one.facts.speeds_mm_s if s > 0.0
        ]
        at = {
            "speed_mm_s": np.array([speed for speed, _ in speeds] or [1.0]),
            "depth_mm": np.array([depth for _, depth in speeds] or [self.sums.depth_mm]),
        }
        own = kernel_evidence(self.sums, chosen, None, force_N=self.force, **at)
        out = []
        for family in FAMILIES:
            found = kernel_evidence(self.sums, chosen, family, force_N=self.force, **at)
            value = anchor + found.log_evidence - own.log_evidence
            words = f"{family.name} kernel, K of degree {chosen.candidate.degree}"
            out.append(_Compared(words, None, value, None, None, None))
        return out


def _difference(one: FloatArray | None, best: FloatArray | None) -> tuple[float | None, float | None]:
    if one is None or best is None:
        return None, None
    difference = one - best
    return float(difference.sum()), float(difference.std(ddof=1) * math.sqrt(difference.size))


def _total(scores: FloatArray | None) -> float:
    return -math.inf if scores is None else float(scores.sum())


def _verdict(one: _Compared, chosen: _Compared) -> str:
    if one is chosen:
        return "chosen"
    if one.logs is None and one.log_evidence_se is None:
        return "beside"
    assert one.log_evidence is not None and chosen.log_evidence is not None  # noqa: S101, PT018
    if chosen.log_evidence - one.log_evidence >= DECIDES:
        return "worse"
    less, scatter = _difference(one.logs, chosen.logs)
    if less is not None and scatter is not None and less < -max(STANDARD_ERRORS * scatter, DECIDES):
        return "worse"
    return "undecided"


def compare_models(
    fitted: FittedSpecimen,
    priors: Priors,
    *,
    seed: int = 0,
    tick: Callable[[str], None] | None = None,
) -> tuple[ComparisonRow, ...]:
    """The chosen model of a specimen beside its neighbours and beside kernels of other form.

    Parameters
    ----------
    fitted : FittedSpecimen
        With sums over the whole range of ln tau (``--branches auto``); otherwise there is nothing to compare.
    priors : Priors
    seed : int
    tick : callable, optional
        Told the model that is looked at.

    Returns
    -------
    tuple of ComparisonRow
        The chosen model first, the others by falling evidence; differences are to the best of each column.
    """
    tick = tick or (lambda _: None)
    whitened = fitted.whitened
    if whitened.sums.log_range is not None:
        return ()
    whitened = for_all_degrees(whitened, fitted.handles)
    comparison = _Comparison(replace(fitted, whitened=whitened), priors, seed)
    single = len(fitted.handles) == 1
    chosen_as = whitened.solution.candidate
    found: list[_Compared] = []
    for candidate in _candidates(chosen_as, highest=whitened.sums.columns_degree, single=single):
        tick(_words(candidate))
        try:
            found.append(comparison.row(candidate))
        except (TissueidError, ValueError, FloatingPointError, np.linalg.LinAlgError):
            if candidate == chosen_as:
                raise
            # a model that these data do not even determine in theory is no rival
            found.append(_Compared(_words(candidate), candidate, None, None, None, None))
    chosen = next(one for one in found if one.candidate == chosen_as)
    assert chosen.log_evidence is not None  # noqa: S101
    if chosen_as.pooling != "per-log":
        tick("dashpot and other kernels")
        found += [comparison.dashpot(), *comparison.beside(chosen.log_evidence)]
    return _rows(found, chosen)


def rows_of_choice(fit: SpecimenFit) -> tuple[ComparisonRow, ...]:
    """What the choice of the model looked at, where nothing further was compared: held-out data alone.

    A model counts as undecided where it predicts no worse than the best by more than chance would have it.
    """
    rows = []
    for row in fit.selection:
        candidate = Candidate(int(row["branches"]), int(row["stiffness_degree"]), fit.model.static_pooling)
        score, scatter = float(row["score"]), float(row["stderr"])
        close = -score <= max(STANDARD_ERRORS * scatter, NEGLIGIBLE)
        rows.append(
            ComparisonRow(
                model=_words(candidate),
                log_evidence=None,
                log_evidence_se=None,
                elpd_log=score,
                elpd_log_se=scatter,
                elpd_speed=None,
                elpd_speed_se=None,
                verdict="chosen" if row["chosen"] else "undecided" if close else "worse",
            )
        )
    return tuple(sorted(rows, key=lambda one: (one.verdict != "chosen", -(one.elpd_log or 0.0))))


def _rows(found: list[_Compared], chosen: _Compared) -> tuple[ComparisonRow, ...]:
    known = [one for one in found if one.log_evidence is not None]
    best = max(one.log_evidence for one in known if one.log_evidence is not None)
    predicted = [one for one in known if one.logs is not None]
    by_logs = max(predicted, key=lambda one: _total(one.logs)) if predicted else chosen
    at_speeds = [one for one in known if one.speeds is not None]
    by_speeds = max(at_speeds, key=lambda one: _total(one.speeds)) if at_speeds else chosen
    rows = []
    others = sorted((one for one in known if one is not chosen), key=lambda one: -(one.log_evidence or 0.0))
    for one in [chosen, *others]:
        elpd, elpd_se = _difference(one.logs, by_logs.logs)
        speed, speed_se = _difference(one.speeds, by_speeds.speeds)
        rows.append(
            ComparisonRow(
                model=one.words,
                log_evidence=None if one.log_evidence is None else one.log_evidence - best,
                log_evidence_se=one.log_evidence_se,
                elpd_log=elpd,
                elpd_log_se=elpd_se,
                elpd_speed=speed,
                elpd_speed_se=speed_se,
                verdict=_verdict(one, chosen),
            )
        )
    return tuple(rows)
