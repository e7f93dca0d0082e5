"""Repeatability of logs, the effect of their order, and the confounding of speed and specimen.

ICC = D^2 / (D^2 + w^2), w the standard deviation of ln force of repeats and D that between specimens, is case
1 of Shrout & Fleiss (1979, doi 10.1037/0033-2909.86.2.420); limits of agreement are those of Bland & Altman
(1999, Stat Methods Med Res 8:135, doi 10.1177/096228029900800204).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy import stats
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tissueid.arrays import FloatArray
from tissueid.documents.population import Agreement, Confounding, Interval, Order, Pair, Repeatability
from tissueid.flags import Flag
from tissueid.population.members import Member, TrialRow

#: Speeds and depths that differ by less are one protocol.
SAME_SHARE = 0.05
#: Two-sided 95 % of a normal.
Z95 = 1.959963984540054
#: Fewest pairs of repeats for limits, and logs beyond the specimens for a slope.
FEWEST_PAIRS = 3
FEWEST_FREE = 3


def _alike(one: TrialRow, other: TrialRow) -> bool:
    """True of logs of one site, speed and depth."""
    pairs = ((one.speed_mm_s, other.speed_mm_s), (one.depth_mm, other.depth_mm))
    near = all(abs(a - b) <= SAME_SHARE * max(abs(a), abs(b), 1e-300) for a, b in pairs)
    return near and one.site == other.site


def _repeats(member: Member) -> list[list[TrialRow]]:
    """Sets of logs of one speed, depth and site, in the order of testing."""
    sets: list[list[TrialRow]] = []
    for trial in member.trials:
        if trial.gain > 0.0:
            like = next((known for known in sets if _alike(known[0], trial)), [])
            if not like:
                sets.append(like)
            like.append(trial)
    for known in sets:
        if all(trial.run is not None for trial in known):
            known.sort(key=lambda trial: trial.run or 0)
    return [known for known in sets if len(known) > 1]


def _has_gains(members: Sequence[Member]) -> bool:
    """True where logs have gains of their own: without partial pooling all are 1."""
    return any(trial.gain != 1.0 for one in members for trial in one.trials)


def interval_95(values: FloatArray) -> Interval:
    """Ends of the central 95 % of draws."""
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def repeatability(
    members: Sequence[Member], between_sd: FloatArray, rng: np.random.Generator
) -> Repeatability | None:
    """Within-specimen scatter of repeats beside draws of D of ln static force, shape (n,)."""
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
        within_cv_ci95=interval_95(np.sqrt(np.expm1(within2))),
        between_cv=_cv(float(np.median(between_sd))),
        between_cv_ci95=interval_95(np.sqrt(np.expm1(between_sd**2))),
        icc=float(np.median(icc)),
        icc_ci95=interval_95(icc),
    )


def _cv(sd_ln: float) -> float:
    """Coefficient of variation of a log-normal."""
    return math.sqrt(math.expm1(sd_ln**2))


def agreement(members: Sequence[Member], force_N: Mapping[str, float]) -> Agreement | None:
    """Bland-Altman of successive repeats; ``None`` with fewer than three pairs."""
    pairs = []
    for one in members:
        for known in _repeats(one):
            for first, second in pairwise(known):
                middle = force_N[one.specimen] * math.sqrt(first.gain * second.gain)
                pairs.append(Pair(one.specimen, middle, math.log(second.gain / first.gain)))
    n = len(pairs)
    if n < FEWEST_PAIRS or not _has_gains(members):
        return None
    change = np.array([pair.ln_ratio for pair in pairs])
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
    """Slope of ln gain on the run, each specimen with a level of its own."""
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


S_PER_MIN = 60.0


def _sentence(kind: str, parts: Sequence[Sequence[float]]) -> str:
    """Sentence on an effect of speed, and its limits."""
    if kind == "single speed":
        return "All logs were loaded at one speed: nothing is said of an effect of speed."
    if kind == "none":
        return (
            f"All {sum(map(len, parts))} speeds meet in specimens: their effect is seen inside "
            "specimens, apart from how specimens differ."
        )
    said = "; ".join(
        ", ".join(f"{speed * S_PER_MIN:.3g}" for speed in part) + " mm/min" for part in parts[:6]
    )
    more = f"; and {len(parts) - 6} more" if len(parts) > 6 else ""
    if kind == "confounded":
        return (
            f"Each speed was tested on specimens of its own ({said}{more}): a difference of force "
            "between speeds may as well be one between specimens, and no effect of speed can be claimed "
            "from this cohort. Test each specimen at several speeds."
        )
    return (
        f"The speeds fall into {len(parts)} parts that share no specimen ({said}{more}): speeds of "
        "different parts can't be compared apart from their specimens. Join the parts by specimens "
        "tested at a speed of each."
    )


def confounding_flags(found: Confounding | None) -> list[Flag]:
    """``speed_confounded`` where speeds can't be told from specimens."""
    if found is None or found.kind in {"none", "single speed"}:
        return []
    message = (
        f"{len(found.speeds_mm_s)} speeds were tested on specimens of their own"
        if found.kind == "confounded"
        else f"the speeds fall into {len(found.parts)} parts that share no specimen"
    )
    return [Flag("speed_confounded", message, {"kind": found.kind, "parts": len(found.parts)})]


def confounding_of(speeds_of: Sequence[Sequence[float]]) -> Confounding | None:
    """Connected parts of the graph of speeds and specimens; ``None`` where no speed is known.

    ``speeds_of``: speeds of each specimen's tests [mm/s].
    """
    tested = [(who, speed) for who, own in enumerate(speeds_of) for speed in own if speed > 0.0]
    speeds: list[float] = []
    for _, speed in sorted(tested, key=lambda pair: pair[1]):
        # speeds that differ by no more than a machine's setting are one
        if not speeds or speed > speeds[-1] * (1.0 + SAME_SHARE):
            speeds.append(speed)
    if not speeds:
        return None
    people = len(speeds_of)
    at = [max(k for k, known in enumerate(speeds) if speed >= known * (1.0 - 1e-12)) for _, speed in tested]
    links = (np.ones(len(tested)), ([who for who, _ in tested], people + np.array(at)))
    graph = coo_array(links, shape=(people + len(speeds),) * 2)
    # specimens first, then speeds
    label = connected_components(graph, directed=False)[1][people:].tolist()
    parts = tuple(
        tuple(speed for speed, own in zip(speeds, label, strict=True) if own == one)
        for one in dict.fromkeys(label)
    )
    kind: Literal["none", "partly", "confounded", "single speed"] = "partly"
    if len(parts) == 1:
        kind = "single speed" if len(speeds) == 1 else "none"
    elif all(len(one) == 1 for one in parts):
        kind = "confounded"
    return Confounding(kind, tuple(speeds), parts, _sentence(kind, parts))
