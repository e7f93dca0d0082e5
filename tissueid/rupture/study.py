"""Everything that is said of the ruptures of a cohort: their speeds, the criterion, the law of its bundles.

An effect of speed is seen inside specimens that were tested at several.  Work, weighted force and an elastic
limit are equally likely beforehand; stored energy and depth, which no test at constant speed tells apart
well, share the last.  "undecided" and "none of them" are answers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as t_distribution

from tissueid.arrays import FloatArray
from tissueid.documents.population import Confounding
from tissueid.documents.rupture import (
    AtRupture,
    Change,
    Criterion,
    Decision,
    Direction,
    Hardening,
    Kind,
    Quantity,
    Speed,
    Threshold,
)
from tissueid.documents.rupture import Test as Failure
from tissueid.errors import NotIdentifiedError
from tissueid.flags import Flag
from tissueid.population.agreement import confounding_flags, confounding_of
from tissueid.rupture.evidence import threshold_of
from tissueid.rupture_law import CRITERIA, RuptureLaw

#: What is quoted of a rupture.
QUOTED: tuple[Quantity, ...] = ("force_N", "depth_mm", "work_N_mm")
CONFIDENCE = 0.95
#: Specimens from which their own scatter gives the interval.
FEWEST_SPECIMENS = 3
#: Two speeds inside a specimen differ, in ln.
SPEEDS_DIFFER = 0.05


def direction(
    ends: tuple[float, float], *, below: Direction = "falls", above: Direction = "rises"
) -> Direction:
    """Word for an interval of a ratio below or above 1, and ``undecided`` for one that holds it."""
    if ends[1] < 1.0:
        return below
    return above if ends[0] > 1.0 else "undecided"


def per_speed(failures: Sequence[Failure], confounding: Confounding) -> list[Speed]:
    """Means and standard deviations at each speed, slowest first."""
    speeds = np.log(confounding.speeds_mm_s)
    groups: list[list[Failure]] = [[] for _ in speeds]
    for one in failures:
        groups[int(np.argmin(np.abs(speeds - np.log(one.speed_mm_s))))].append(one)
    found = []
    for speed, group in zip(confounding.speeds_mm_s, groups, strict=True):
        broken = [one for one in group if one.ruptured]
        near = [
            one for one in failures if one.ruptured and abs(np.log(one.speed_mm_s / speed)) < SPEEDS_DIFFER
        ]
        values = {name: np.array([getattr(one, name) for one in broken]) for name in QUOTED}
        found.append(
            Speed(
                speed_mm_s=speed,
                ruptured=len(broken),
                censored=len(group) - len(broken),
                mean=AtRupture(**{name: float(v.mean()) if v.size else None for name, v in values.items()}),
                sd=AtRupture(
                    **{name: float(v.std(ddof=1)) if v.size > 1 else None for name, v in values.items()}
                ),
                hardening=float(np.mean([one.hardening for one in near])) if near else None,
                dynamic_share=float(np.mean([one.dynamic_share for one in near])) if near else None,
            )
        )
    return found


def change_with_speed(failures: Sequence[Failure]) -> list[Change]:
    """Change of force, depth and work at rupture with speed, inside specimens; of ruptured tests alone."""
    broken = [one for one in failures if one.ruptured]
    names = list(dict.fromkeys(one.specimen for one in broken))
    who = np.array([names.index(one.specimen) for one in broken], dtype=int)
    speed = _inside(np.log10([one.speed_mm_s for one in broken]), who)
    left = len(broken) - len(names) - 1
    if left < 1 or not np.abs(speed).max(initial=0.0) > SPEEDS_DIFFER:
        return []
    found = []
    quantile = float(t_distribution.ppf(0.5 + CONFIDENCE / 2.0, left))
    for name in QUOTED:
        values = _inside(np.log([getattr(one, name) for one in broken]), who)
        total = float((speed**2).sum())
        slope = float((speed * values).sum()) / total
        error = float(np.sqrt(((values - slope * speed) ** 2).sum() / left / total))
        ends = (float(np.exp(slope - quantile * error)), float(np.exp(slope + quantile * error)))
        found.append(Change(name, float(np.exp(slope)), ends, direction(ends)))
    return found


def _inside(values: FloatArray, who: NDArray[np.intp]) -> FloatArray:
    """Values less the mean of their specimen."""
    inside: FloatArray = values.astype(np.float64)
    for k in np.unique(who):
        inside[who == k] -= inside[who == k].mean()
    return inside


def hardening_of(failures: Sequence[Failure]) -> Hardening | None:
    """Mean x F_s'/F at rupture with a 95 % interval, over specimens.

    Only ruptures at depths of many v tau tell the sign.  From three specimens on their scatter gives the
    interval, which holds what the laws do not know; of fewer the draws of their laws do.
    """
    broken = [one for one in failures if one.ruptured and one.settled]
    names = list(dict.fromkeys(one.specimen for one in broken))
    if not names:
        return None
    means = np.array([np.mean([one.hardening for one in broken if one.specimen == name]) for name in names])
    count = len(names)
    if count >= FEWEST_SPECIMENS:
        error = float(means.std(ddof=1)) / count**0.5
        half = float(t_distribution.ppf(0.5 + CONFIDENCE / 2.0, count - 1)) * error
    else:
        # draws of one law move all its tests together
        own = [np.mean([one.hardening_sd for one in broken if one.specimen == name]) for name in names]
        half = float(t_distribution.ppf(0.5 + CONFIDENCE / 2.0, np.inf)) * float(np.linalg.norm(own)) / count
    mean = float(means.mean())
    ends = (mean - half, mean + half)
    return Hardening(mean, ends, len(broken), direction(ends, below="rises", above="falls"))


#: Kinds that are weighed, with the criteria that count as one.
KINDS: Mapping[Kind, tuple[Criterion, ...]] = {
    "work": ("work",),
    "weighted force": ("weighted-force",),
    "elastic limit": ("stored-energy", "depth"),
}
#: Probability from which a kind is taken.
DECIDED_FROM = 0.95
#: p value below which a trend with speed contradicts a criterion.
TREND_P = 0.01


def decide(thresholds: Sequence[Threshold], *, hindrance: str | None = None) -> Decision:
    """Weigh the criteria."""
    found = {one.criterion: one for one in thresholds}
    ln = {
        kind: float(np.logaddexp.reduce([found[name].ln_evidence for name in names]) - np.log(len(names)))
        for kind, names in KINDS.items()
    }
    total = float(np.logaddexp.reduce(list(ln.values())))
    probability: dict[str, float] = {kind: float(np.exp(value - total)) for kind, value in ln.items()}
    if hindrance is not None:
        return Decision("undecided", None, None, probability, hindrance)
    kind = max(ln, key=lambda one: ln[one])
    best = max(KINDS[kind], key=lambda name: found[name].ln_evidence)
    p = found[best].trend_p
    if p is not None and p < TREND_P:
        reason = (
            f"the likeliest of them, {best}, leaves a trend with speed (p = {p:.2g}): none of the criteria "
            "describes these ruptures"
        )
        return Decision("none", None, None, probability, reason)
    if probability[kind] < DECIDED_FROM:
        shares = ", ".join(f"{one} {100 * share:.0f} %" for one, share in probability.items())
        reason = (
            f"the tests do not tell the criteria apart ({shares}; {100 * DECIDED_FROM:.0f} % is asked for)"
        )
        return Decision("undecided", None, None, probability, reason)
    reason = f"{kind} has {100 * probability[kind]:.1f} % of the evidence"
    return Decision("decided", kind, best, probability, reason)


#: What may be asked for: no law, the one that the evidence decides for, or a named one.
ASKED = ("none", "auto", *CRITERIA)
#: Fewest ruptures with a mean and two spreads.
FEWEST_RUPTURES = 4


@dataclass(frozen=True, slots=True)
class RuptureStudy:
    """Ruptures of a cohort."""

    failures: tuple[Failure, ...]  # every test, censored ones among them
    weight: float  # w of the weighted force
    confounding: Confounding
    speeds: tuple[Speed, ...]
    changes: tuple[Change, ...]  # inside specimens; empty where nothing can be said
    hardening: Hardening | None
    thresholds: tuple[Threshold, ...]  # one for each criterion
    decision: Decision
    asked: str  # one of :data:`ASKED`
    laws: Mapping[str, RuptureLaw]  # by specimen; empty where there is none
    flags: tuple[Flag, ...]

    @property
    def taken(self) -> str:
        """Criterion of the bundles, or ``none``."""
        return next((law.criterion for law in self.laws.values()), "none")


def rupture_study(failures: Sequence[Failure], *, weight: float, asked: str = "none") -> RuptureStudy:
    """Describe and compare."""
    broken = [one for one in failures if one.ruptured]
    if len(broken) < FEWEST_RUPTURES:
        raise NotIdentifiedError(
            f"{len(broken)} of {len(failures)} tests end in a rupture, and {FEWEST_RUPTURES} are needed; "
            "`tissueid inspect` shows where the force falls, and `rupture = false` in an override denies one"
        )
    names = list(dict.fromkeys(one.specimen for one in broken))
    confounding = confounding_of(
        [[one.speed_mm_s for one in broken if one.specimen == name] for name in names]
    )
    all_speeds = confounding_of([[one.speed_mm_s] for one in failures])
    assert confounding is not None  # noqa: S101 -- a loaded test has a speed
    assert all_speeds is not None  # noqa: S101
    thresholds = tuple(threshold_of(failures, criterion) for criterion in CRITERIA)
    decision = decide(thresholds, hindrance=_hindrance(confounding))
    told = confounding.kind in {"none", "partly"}
    return RuptureStudy(
        failures=tuple(failures),
        weight=weight,
        confounding=confounding,
        speeds=tuple(per_speed(failures, all_speeds)),
        changes=tuple(change_with_speed(failures)) if told else (),
        hardening=hardening_of(failures),
        thresholds=thresholds,
        decision=decision,
        asked=asked,
        laws=_laws(failures, thresholds, decision, weight, asked),
        flags=tuple(confounding_flags(confounding)),
    )


def _hindrance(confounding: Confounding) -> str | None:
    """Why the criteria can't be told apart, whatever the numbers are."""
    if confounding.kind == "single speed":
        return "all tests were loaded at one speed, and only speed tells the criteria apart"
    if confounding.kind == "confounded":
        return (
            "each speed was tested on specimens of its own: what tells the criteria apart may as well be a "
            "difference between specimens"
        )
    return None


def _laws(
    failures: Sequence[Failure],
    thresholds: Sequence[Threshold],
    decision: Decision,
    weight: float,
    asked: str,
) -> dict[str, RuptureLaw]:
    criterion = decision.criterion if asked == "auto" else asked
    found = next((one for one in thresholds if one.criterion == criterion), None)
    if found is None:
        return {}
    residual = float(np.median([one.residual for one in failures if one.residual is not None]))
    return {
        name: RuptureLaw(
            criterion=found.criterion,
            threshold=value,
            weight=weight,
            sd_ln=found.sd_ln,
            specimen_sd_ln=found.specimen_sd_ln,
            population=found.median,
            population_ci95=found.ci95,
            residual=residual,
        )
        for name, value in found.specimens.items()
    }
