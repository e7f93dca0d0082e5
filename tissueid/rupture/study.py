"""Everything that is said of the ruptures of a cohort, its criterion, and the law that goes into its bundles.

Choice of a criterion, if any: weighed by evidence, with "undecided" and "none of them" among the answers.
Work, weighted force and an elastic limit are equally likely beforehand; the elastic limit is shared by stored
energy and depth, which no test at constant speed tells apart well and which count as one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.errors import NotIdentifiedError
from tissueid.flags import Flag
from tissueid.population.confounding import Confounding, confounding_of
from tissueid.rupture.evidence import Threshold, threshold_of
from tissueid.rupture.failures import Failure
from tissueid.rupture.speeds import (
    AtSpeed,
    Change,
    Hardening,
    change_with_speed,
    hardening_of,
    per_speed,
)
from tissueid.rupture_law import CRITERIA, RuptureLaw

#: Kinds that are weighed, with the criteria that count as one.
KINDS: Mapping[str, tuple[str, ...]] = {
    "work": ("work",),
    "weighted force": ("weighted-force",),
    "elastic limit": ("stored-energy", "depth"),
}
#: Probability from which a kind is taken.
DECIDED_FROM = 0.95
#: p value below which a trend with speed contradicts a criterion.
TREND_P = 0.01


@dataclass(frozen=True, slots=True)
class Decision:
    """The answer."""

    #: ``decided``, ``undecided`` or ``none`` (every criterion leaves a trend with speed, or the likeliest).
    answer: str
    kind: str | None  # of :data:`KINDS`, where it is decided
    criterion: str | None  # the likelier one of that kind
    probability: Mapping[str, float]  # of each kind, given that it is one of them
    reason: str  # one sentence


def decide(thresholds: Sequence[Threshold], *, hindrance: str | None = None) -> Decision:
    """Weigh the criteria.

    ``thresholds``: of all criteria; ``hindrance``: why these tests can't tell, whatever the evidence is.
    """
    found = {one.criterion: one for one in thresholds}
    ln = {
        kind: float(np.logaddexp.reduce([found[name].ln_evidence for name in names]) - np.log(len(names)))
        for kind, names in KINDS.items()
    }
    total = float(np.logaddexp.reduce(list(ln.values())))
    probability = {kind: float(np.exp(value - total)) for kind, value in ln.items()}
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
    speeds: tuple[AtSpeed, ...]
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
    """Describe and compare.

    ``failures``: of all specimens, measured with ``weight``; ``asked``: one of :data:`ASKED`.  Raises
    NotIdentifiedError: too few tests ruptured.
    """
    broken = [one for one in failures if one.ruptured]
    if len(broken) < FEWEST_RUPTURES:
        msg = (
            f"{len(broken)} of {len(failures)} tests end in a rupture, and {FEWEST_RUPTURES} are needed; "
            "`tissueid inspect` shows where the force falls, and `rupture = false` in an override denies one"
        )
        raise NotIdentifiedError(msg)
    names = list(dict.fromkeys(one.specimen for one in broken))
    confounding = confounding_of(
        [[one.test.speed_mm_s for one in broken if one.specimen == name] for name in names]
    )
    assert confounding is not None  # noqa: S101 -- a loaded test has a speed
    thresholds = tuple(threshold_of(failures, criterion) for criterion in CRITERIA)
    decision = decide(thresholds, hindrance=_hindrance(confounding))
    told = confounding.kind in {"none", "partly"}
    return RuptureStudy(
        failures=tuple(failures),
        weight=weight,
        confounding=confounding,
        speeds=tuple(per_speed(failures, _all_speeds(failures))),
        changes=tuple(change_with_speed(failures)) if told else (),
        hardening=hardening_of(failures),
        thresholds=thresholds,
        decision=decision,
        asked=asked,
        laws=_laws(failures, thresholds, decision, weight, asked),
        flags=tuple(confounding.flags()),
    )


def _all_speeds(failures: Sequence[Failure]) -> Confounding:
    """Speeds of all tests, of those that did not rupture as well."""
    found = confounding_of([[one.test.speed_mm_s] for one in failures])
    assert found is not None  # noqa: S101 -- a loaded test has a speed
    return found


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
    residual = float(np.median([one.test.residual for one in failures if one.test.residual is not None]))
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
