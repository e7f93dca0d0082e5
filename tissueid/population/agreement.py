"""Repeatability within specimens apart from reproducibility between them, and what the order of tests does.

The measured number of a log is its gain, its force over that of its specimen's tissue.  Logs of one specimen
at one speed, depth and site are repeats.  Their scatter is the within-specimen standard deviation w of ln
force; between specimens stands D of the static force at the common depth, so that::

    ICC = D^2 / (D^2 + w^2)

is the share of the variance of one log's force that is the specimen's (Shrout & Fleiss 1979, case 1, doi
10.1037/0033-2909.86.2.420).  Limits of agreement of two repeats are those of Bland & Altman (1999, Stat
Methods Med Res 8:135, doi 10.1177/096228029900800204).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import stats

from tissueid.arrays import FloatArray
from tissueid.documents.population import Order, Repeatability
from tissueid.population.members import Member, TrialRow

#: Speeds and depths that differ by less are one protocol.
SAME_SHARE = 0.05
#: Two-sided 95 % of a normal.
Z95 = 1.959963984540054
#: Fewest pairs of repeats for limits, and logs beyond the specimens for a slope.
FEWEST_PAIRS = 3
FEWEST_FREE = 3


@dataclass(frozen=True, slots=True)
class Agreement:
    """Bland-Altman of successive repeats, in ln force (a difference of 0.01 is 1 %)."""

    #: Specimen, mean force at the common depth [N], difference of ln force, later less earlier.
    pairs: tuple[tuple[str, float, float], ...]
    #: Mean difference, and limits that hold 95 % of differences.
    bias: float
    bias_ci95: tuple[float, float]
    lower: float
    lower_ci95: tuple[float, float]
    upper: float
    upper_ci95: tuple[float, float]

    def as_json(self) -> dict[str, Any]:
        """The ``agreement`` object of the schema."""
        document = {
            key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()
        }
        rows = [
            {"specimen": name, "force_N": force, "ln_ratio": change} for name, force, change in self.pairs
        ]
        return document | {"pairs": rows}


def _same(one: float, other: float) -> bool:
    return abs(one - other) <= SAME_SHARE * max(abs(one), abs(other), 1e-300)


def _repeats(member: Member) -> list[list[TrialRow]]:
    """Sets of logs of one speed, depth and site, in the order of testing."""
    sets: list[list[TrialRow]] = []
    for trial in member.trials:
        if not trial.gain > 0.0:
            continue
        for known in sets:
            first = known[0]
            if (
                first.site == trial.site
                and _same(first.speed_mm_s, trial.speed_mm_s)
                and _same(first.depth_mm, trial.depth_mm)
            ):
                known.append(trial)
                break
        else:
            sets.append([trial])
    for known in sets:
        if all(trial.run is not None for trial in known):
            known.sort(key=lambda trial: trial.run or 0)
    return [known for known in sets if len(known) > 1]


def _has_gains(members: Sequence[Member]) -> bool:
    """True where logs have gains of their own: without partial pooling all are 1."""
    return any(trial.gain != 1.0 for one in members for trial in one.trials)


def _interval(values: FloatArray) -> tuple[float, float]:
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def repeatability(
    members: Sequence[Member], between_sd: FloatArray, rng: np.random.Generator
) -> Repeatability | None:
    """Within-specimen scatter of repeats beside draws of the scatter between specimens.

    The within variance has its posterior under a prior flat in its logarithm, sum of squares over chi-square.

    ``between_sd`` (n,): draws of D of ln static force.  Returns ``None`` where no specimen has repeats with
    gains of their own.
    """
    sets = [known for one in members for known in _repeats(one)]
    logs = sum(len(known) for known in sets)
    freedom = logs - len(sets)
    if freedom < 1 or not _has_gains(members):
        return None
    square = sum(float(np.sum((x - x.mean()) ** 2)) for x in (np.log([t.gain for t in one]) for one in sets))
    within2 = square / rng.chisquare(freedom, between_sd.size)
    icc = between_sd**2 / (between_sd**2 + within2)
    return Repeatability(
        logs=logs,
        groups=len(sets),
        freedom=freedom,
        within_cv=_cv(math.sqrt(square / freedom)),
        within_cv_ci95=_interval(np.sqrt(np.expm1(within2))),
        between_cv=_cv(float(np.median(between_sd))),
        between_cv_ci95=_interval(np.sqrt(np.expm1(between_sd**2))),
        icc=float(np.median(icc)),
        icc_ci95=_interval(icc),
    )


def _cv(sd_ln: float) -> float:
    """Coefficient of variation of a log-normal."""
    return math.sqrt(math.expm1(sd_ln**2))


def agreement(members: Sequence[Member], force_N: Mapping[str, float]) -> Agreement | None:
    """Bland-Altman of successive repeats.

    ``force_N``: specimen -> static force at the common depth [N].  Returns ``None`` with fewer than three
    pairs.
    """
    pairs = []
    for one in members:
        for known in _repeats(one):
            for first, second in pairwise(known):
                middle = force_N[one.specimen] * math.sqrt(first.gain * second.gain)
                pairs.append((one.specimen, middle, math.log(second.gain / first.gain)))
    n = len(pairs)
    if n < FEWEST_PAIRS or not _has_gains(members):
        return None
    change = np.array([pair[2] for pair in pairs])
    bias, sd = float(change.mean()), float(change.std(ddof=1))
    reach = float(stats.t.ppf(0.975, n - 1))
    error = reach * sd / math.sqrt(n)
    limit_error = reach * sd * math.sqrt(1.0 / n + Z95**2 / (2.0 * (n - 1)))
    lower, upper = bias - Z95 * sd, bias + Z95 * sd
    return Agreement(
        pairs=tuple(pairs),
        bias=bias,
        bias_ci95=(bias - error, bias + error),
        lower=lower,
        lower_ci95=(lower - limit_error, lower + limit_error),
        upper=upper,
        upper_ci95=(upper - limit_error, upper + limit_error),
    )


def order_effect(members: Sequence[Member]) -> Order | None:
    """Slope of ln gain on the run, each specimen with a level of its own.

    Returns ``None`` where runs are not stated or leave nothing to judge a slope by.
    """
    runs, gains, specimens = [], [], 0
    for one in members:
        known = [trial for trial in one.trials if trial.run is not None and trial.gain > 0.0]
        if len({trial.run for trial in known}) < 2:
            continue
        specimens += 1
        run = np.array([float(trial.run or 0) for trial in known])
        gain = np.log([trial.gain for trial in known])
        runs.append(run - run.mean())
        gains.append(gain - gain.mean())
    if not runs or not _has_gains(members):
        return None
    x, y = np.concatenate(runs), np.concatenate(gains)
    freedom = x.size - specimens - 1
    if freedom < FEWEST_FREE:
        return None
    slope = float(x @ y / (x @ x))
    left = y - slope * x
    error = math.sqrt(float(left @ left) / freedom / float(x @ x))
    reach = float(stats.t.ppf(0.975, freedom)) * error
    p = float(2.0 * stats.t.sf(abs(slope) / error, freedom)) if error > 0.0 else 0.0
    return Order(slope, (slope - reach, slope + reach), p, int(x.size), specimens)
