"""Choice of a criterion, if any: weighed by evidence, with "undecided" and "none of them" among the answers.

Work, weighted force and an elastic limit are equally likely beforehand; the elastic limit is shared by stored
energy and depth, which no test at constant speed tells apart well (model.md 1.5) and which count as one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.rupture.evidence import Threshold

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
