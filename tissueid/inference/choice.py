"""Choice among laws and orders: the simplest that predicts left-out data as well as the best.

Left out is a speed or a depth where there are three of them, else a log, else stretches of the one log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm, t

from tissueid.arrays import FloatArray, IntArray
from tissueid.inference.blocks import Blocks
from tissueid.inference.channel_law import ChannelLaw
from tissueid.inference.optimum import Optimum, covariance_of, minimise, nearest_in_cone, whitener_of
from tissueid.inference.system import System
from tissueid.inference.window import FOLDS, FittedLog
from tissueid.measured.spread import clusters
from tissueid.model.channels import ChannelModel
from tissueid.model.grammar import DEGREES
from tissueid.model.yardstick import YARDSTICK

#: Speeds or depths within this factor are one; so many of them are needed to leave one out.
ALIKE, FEWEST_GROUPS = 1.1, 3
#: Probability within which a prediction counts as good as the best (one standard error of many groups, by
#: Student's t of few), and a relative gain that is none.
ONE_ERROR, NO_GAIN = 0.8413, 0.02
#: Loss in ln mean square error that is never as good as the best: of two or three groups the standard error
#: alone lets a law pass that misses one of them by far.
TOO_MUCH = 1.0
#: Noise that several logs need under a law over that under the best, beyond which it does not describe them.
#: Laws of different kinds may differ by more.
MISSES, MISSES_OF_LAWS = 1.5, 3.0
#: Gain in ln mean square error that K of a higher degree, or a third branch, must have where there is one
#: program, and level at which the logs themselves must show any: what is left out rests on few gains.
BEND, SHOWN = 0.2, 0.99
#: Times that the static force is less well known under a K that varies, from which a constant K is told.
BENDS = 2.0
#: Groups of logs at the most, steps of a fit without one, and of a log's own parameters under it.
MOST_GROUPS, REFIT_STEPS, OWN_STEPS = 8, 20, 8
#: Share of its depth at which a ramp has ended, and fewest observations that tell a log's own parameters.
AT_DEPTH, FEWEST_OF_RAMP = 0.995, 4
#: Largest force of a branch over the noise with which it counts as seen, and factor between two times.
SEEN, APART = 0.5, 1.5
#: Standard deviations of ln tau that two laws are apart, and the least that counts as one.
FAR_APART, LEAST_SD = 3.0, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Groups left out together: group of each observation, and the name of a group."""

    of: IntArray
    kind: str


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """A candidate with its optimum and its mean square error on each group that was left out [N^2]."""

    optimum: Optimum
    system: System
    errors: FloatArray
    badness: float = 0.0  # twice the negative log density of its optimum

    @property
    def law(self) -> ChannelLaw:
        """The law."""
        return self.system.law

    @property
    def name(self) -> str:
        """Name of the law in the grammar."""
        if self.law.model_of is not None:
            return self.law.model_of.name
        return f"polynomial * {tuple(DEGREES)[self.law.degree]} * prony:{self.law.branches}"


@dataclass(frozen=True, slots=True)
class Rival:
    """Another law beside the chosen one."""

    name: str
    gain: float  # ln of the chosen law's mean square error over its own, on what was left out
    stderr: float
    wide: float  # loss with which it predicts as well
    tau_s: float  # its shortest relaxation time, NaN where nothing relaxes
    apart: float  # difference of ln tau from the chosen law's, in standard deviations of both
    model: ChannelModel = field(repr=False)
    theta: FloatArray = field(repr=False)

    @property
    def better(self) -> bool:
        """It predicts better, by more than one standard error and a fifth."""
        return self.gain > max(self.stderr, BEND)

    @property
    def as_good(self) -> bool:
        """It predicts as well as the chosen law, or better."""
        return self.gain >= -self.wide

    @property
    def disagrees(self) -> bool:
        """It predicts as well, and its relaxation time is another."""
        return self.as_good and abs(self.apart) > FAR_APART


def rival_of(tried: Tried, chosen: Tried) -> Rival:
    """A law that was tried beside the chosen one."""
    gain, stderr = _gain(tried, chosen)
    wide = float(tolerated(stderr, chosen.errors.size))
    ln_tau, sd = _first_time(tried)
    other, other_sd = _first_time(chosen)
    apart = (ln_tau - other) / max(float(np.hypot(sd, other_sd)), LEAST_SD)
    law, point = tried.law, tried.optimum.point
    theta = law.theta(point.log_times, point.linear)[0]
    return Rival(tried.name, gain, stderr, wide, float(np.exp(ln_tau)), apart, law.model(), theta)


@dataclass(frozen=True, slots=True, eq=False)
class Bent:
    """Static force at half the depth [N], and parameters, which a K that varies would part otherwise."""

    depth_mm: float
    force_N: float  # under the constant K
    ends_N: tuple[float, float]  # 95 % of it under one that is linear in depth, within passive tissue
    model: ChannelModel = field(repr=False)
    theta: FloatArray = field(repr=False)  # (m, p) at both ends of each coefficient and of K half way


def bent_of(chosen: Tried, tried: Sequence[Tried]) -> Bent | None:
    """Static force under a K of one degree more, as far as that leaves it open; ``None`` where it doesn't."""
    force, low, high = _half_way(chosen)
    for one in tried:
        if one.law.order == (chosen.law.branches, chosen.law.degree + 1):
            _, lower, upper = _half_way(one)
            # of a K that varies the constant one is a case
            ends = min(lower, low), max(upper, high)
            if ends[1] - ends[0] > BENDS * (high - low):
                return Bent(0.5 * chosen.law.depth_mm, force, ends, one.law.model(), _thetas(one))
    return None


def _thetas(one: Tried) -> FloatArray:
    """Theta (m, p) at the ends of 95 % of each linear coefficient, and of each K at half the depth."""
    law = one.law
    half = np.zeros((law.branches, law.linear))
    for branch, at in enumerate(range(law.static_size, law.linear, law.powers)):
        half[branch, at : at + law.powers] = 0.5 ** np.arange(law.powers)
    at_ends = one.optimum.point.moved(
        np.concatenate([_ends(one, row) for row in (*np.eye(law.linear), *half)])
    )
    return law.theta(at_ends.log_times, at_ends.linear)


def _half_way(one: Tried) -> tuple[float, float, float]:
    """Static force at half the depth and the ends of its 95 % interval within passive tissue [N]."""
    weights = np.zeros(one.law.linear)
    weights[: one.law.static_size] = 0.5 ** np.arange(1.0, one.law.static_size + 1)
    low, high = _ends(one, weights)[:, -weights.size :] @ weights
    return float(weights @ one.optimum.point.linear), float(low), float(high)


def _ends(one: Tried, weights: FloatArray) -> FloatArray:
    """Shared parameters (2, n) at the ends of 95 % of a sum of the linear ones, within passive tissue."""
    shared, covariance, prior = one.optimum.point.shared, one.optimum.covariance, one.optimum.prior
    to = covariance[:, shared.size - weights.size : shared.size] @ weights
    variance = float(weights @ to[shared.size - weights.size : shared.size])
    far = float(norm.ppf(0.975)) * to / np.sqrt(max(variance, 1e-300))
    return np.array([nearest_in_cone(shared + by, covariance, prior.cone, prior.least) for by in (-far, far)])


def _first_time(one: Tried) -> tuple[float, float]:
    """Ln of the shortest relaxation time and its standard deviation; NaN where nothing relaxes."""
    if one.law.counts[0] == 0:
        # a spectrum: its times are given
        return float(np.log(one.law.fixed_s.min(initial=np.inf if one.law.fixed_s.size else np.nan))), 0.0
    at = int(np.argmin(one.optimum.point.log_times[: one.law.counts[0]]))
    variance = float(one.optimum.covariance[at, at])
    return float(one.optimum.point.log_times[at]), float(np.sqrt(max(variance, 0.0)))


def _clusters(values: Sequence[float]) -> IntArray:
    """Group of each value, of those within a factor of each other."""
    out = np.zeros(len(values), dtype=np.int64)
    for group, members in enumerate(clusters(values, ALIKE)):
        out[members] = group
    return out


def speeds_of(facts: Sequence[FittedLog]) -> NDArray[np.int64]:
    """Number of the speed of each log, alike within 10 %."""
    speeds = [max(one.speeds_mm_s) for one in facts]
    return _clusters(speeds) if min(speeds) > 0.0 else np.zeros(len(speeds), dtype=np.int64)


def groups_of(system: System, facts: Sequence[FittedLog]) -> Groups:
    """Choose the groups to leave out of these logs."""
    if len(facts) == 1:
        return Groups(system.fold % FOLDS, "stretch of the log")
    for kind, values in (
        ("speed", [max(one.speeds_mm_s) for one in facts]),
        ("depth", [one.depth_mm for one in facts]),
    ):
        if min(values) > 0.0:
            found = _clusters(values)
            if found.max() + 1 >= FEWEST_GROUPS:
                return Groups(found[system.log], kind)
    return Groups(system.log % MOST_GROUPS, "log")


def held_out(system: System, optimum: Optimum, groups: Groups) -> FloatArray:
    """Mean square error of each group, predicted from the others [N^2, whitened]."""
    if len(system.logs) == 1:
        return _stretches(system, optimum, groups)
    of = groups.of[system.begins]
    return np.array([_left_out(system, optimum, of == group) for group in np.unique(of)])


def _stretches(system: System, optimum: Optimum, groups: Groups) -> FloatArray:
    """Mean square error of each stretch of a log, by one step without it."""
    normal, prior, point = optimum.normal, optimum.prior, optimum.point
    s, times = normal.shared.shape[1], system.law.times
    wide = np.hstack([normal.shared, normal.own])
    own = prior.own[0] if normal.own.shape[1] else np.zeros(0)
    rows = np.zeros((len(prior.rows), wide.shape[1]))
    rows[:, :s] = prior.rows
    precision = rows.T @ rows
    precision[s:, s:] = np.diag(own)
    pull = -rows.T @ (prior.rows @ point.shared - prior.target)
    pull[s:] = -own * point.own[0]
    # the machine is held: its derivatives are zero where it was closed
    precision[np.arange(times, times + 3), np.arange(times, times + 3)] += 1e-9 + (
        1e30 * (np.abs(normal.shared[:, times : times + 3]).max(axis=0) == 0.0)
    )
    total, right = wide.T @ wide + precision, wide.T @ normal.residual + pull
    out = []
    for group in np.unique(groups.of):
        part, left = wide[groups.of == group], normal.residual[groups.of == group]
        covariance = covariance_of(total - part.T @ part)
        move = covariance @ (right - part.T @ left)
        shared = point.shared + move[:s]
        inside = nearest_in_cone(shared, covariance[:s, :s], prior.cone, prior.least)
        if inside is not shared:
            change = np.linalg.solve(covariance[:s, :s] + 1e-14 * np.eye(s), inside - shared)
            move = move + covariance[:, :s] @ change
        error = left - part @ move
        out.append(float(error @ error) / max(error.size, 1))
    return np.array(out) * optimum.noise.sigma_N**2


def _left_out(system: System, optimum: Optimum, out: NDArray[np.bool_]) -> float:
    """Mean square error of logs under a fit of the others, their own parameters from their ramps."""
    prior, noise, kept = optimum.prior, optimum.noise, np.flatnonzero(~out).tolist()
    rest = system.of([system.logs[i] for i in kept], kept)
    theirs = replace(prior, own=prior.own[~out])
    found = minimise(
        rest, replace(optimum.point, own=optimum.point.own[~out]), lambda _: theirs,
        noise=noise, machine=False, steps=REFIT_STEPS,
    )  # fmt: skip
    squares, count = 0.0, 0
    for i in np.flatnonzero(out).tolist():
        point, own = replace(found.point, own=optimum.point.own[i : i + 1]), prior.own[i : i + 1]
        point = minimise(
            system.of([_ramp(system.logs[i])], [i]), point, lambda _, own=own: replace(prior, own=own),  # type: ignore[misc]
            noise=noise, machine=False, steps=OWN_STEPS, held=np.arange(point.shared.size),
        ).point  # fmt: skip
        one = system.of([system.logs[i]], [i])
        error = whitener_of(one, noise.memory)(one.force - one.predict(point))
        squares, count = squares + float(error @ error), count + error.size
    return squares / max(count, 1)


def _ramp(log: Blocks) -> Blocks:
    """Observations before a log is first at its depth; all of a log that has too few of them."""
    arrived = int(np.argmax(log.depth_mm >= AT_DEPTH * log.depth_mm.max()))
    count = int((log.mid_s <= log.time_s[arrived]).sum())
    if count < FEWEST_OF_RAMP:
        return log
    names = ("at", "force_N", "count", "mid_s", "step_s", "chain", "fold", "digits")
    return replace(log, **{name: getattr(log, name)[:count] for name in names})


def _gain(better: Tried, simpler: Tried) -> tuple[float, float]:
    """Mean and standard error over groups of what the better one gains in ln mean square error."""
    gain = np.log(np.maximum(simpler.errors, 1e-300)) - np.log(np.maximum(better.errors, 1e-300))
    return float(gain.mean()), float(gain.std(ddof=1) / np.sqrt(gain.size)) if gain.size > 1 else 0.0


def tolerated(stderr: Any, count: int) -> Any:
    """Loss with which a prediction counts as good as the best, from its standard error over groups."""
    wide = float(t.ppf(ONE_ERROR, max(count - 1, 1)))
    return np.maximum(np.minimum(wide * stderr, TOO_MUCH), NO_GAIN)


def resolved(one: Tried, step_s: float) -> bool:
    """True where no branch is faster than the sampling, far below the noise, or as fast as another."""
    point, law, sigma = one.optimum.point, one.law, one.optimum.noise.sigma_N
    if law.branches == 1:
        return True
    if float(np.exp(point.log_times.min())) < step_s:
        return False
    if float(np.diff(np.sort(point.log_times)).min()) < np.log(APART):
        return False
    columns = law.columns(point.log_times, one.system.path(one.system.travel))
    branches = [block.at for block in law.blocks if block.branch >= 0]
    return all(np.abs(point.linear[at] @ columns[at]).max() >= SEEN * sigma for at in branches)


def shown(tried: Sequence[Tried], *, one_program: bool) -> list[Tried]:
    """Candidates of which every branch and every bend of K more is seen in the logs themselves.

    Of one program K varies with depth, and has a third branch, only where much is gained as well: only the
    form of their polynomials tells F_s(x) from K(x) s(x) there, and an error of the contact looks like a K
    that bends.
    """

    def needed(one: Tried, other: Tried) -> bool:
        asked = one_program and other.law.branches in {one.law.branches, 2}
        gained = not asked or _gain(one, other)[0] >= BEND
        least = float(chi2.ppf(SHOWN, one.law.freedom - other.law.freedom))
        return gained and other.badness - one.badness >= least

    def plainer(other: Tried, one: Tried) -> bool:
        less, more = other.law, one.law
        return other is not one and less.branches <= more.branches and less.degree <= more.degree

    return [one for one in tried if all(needed(one, other) for other in tried if plainer(other, one))]


def describing(tried: Sequence[Tried], most: float = MISSES) -> list[Tried]:
    """Candidates that describe what they were fitted to nearly as well as the best of them.

    What differs between logs drowns, where one is predicted, what a law misses in all of them.
    """
    if len(tried[0].system.logs) == 1:
        return list(tried)
    least = min(one.optimum.noise.sigma_N for one in tried)
    return [one for one in tried if one.optimum.noise.sigma_N <= most * least]


def _kinds(laws: Sequence[Tried]) -> list[list[Tried]]:
    """Laws by kind that describe their logs nearly as well as the same law with other branches."""
    kinds: dict[str, list[Tried]] = {}
    for one in laws:
        kinds.setdefault(one.name.rpartition(":")[0] or one.name, []).append(one)
    return [describing(kind) for kind in kinds.values()]


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The law that is fitted, beside those that are not."""

    chosen: Tried
    rivals: tuple[Rival, ...]  # other laws beside it
    simplest: tuple[Rival, ...]  # the one of each kind with as few branches as do
    mark: Rival | None  # the yardstick beside it


def choice_of(paper: Tried | None, others: Sequence[Tried], *, choose: bool) -> Choice:
    """The law of fewest parameters (of two the Kelvin-Voigt law) within one standard error of the best.

    ``choose``: other laws than ``paper``, the Kelvin-Voigt law in its chosen order, may be chosen.
    """
    everyone = [one for one in (paper, *others) if one is not None]
    kinds = _kinds([one for one in everyone if one.name != YARDSTICK] or everyone)
    if paper is not None and not choose:
        chosen = paper
    else:
        # the yardstick is the mark: it is chosen only where it alone was asked for
        as_good = chosen_among(describing([one for kind in kinds for one in kind], MISSES_OF_LAWS))[2]
        chosen = min(
            as_good, key=lambda one: (one.law.freedom, one is not paper, -rival_of(one, as_good[0]).gain)
        )
    beside = [rival_of(one, chosen) for one in everyone if one is not chosen]
    mark = next((one for one in beside if one.name == YARDSTICK), None)
    rivals = tuple(one for one in beside if one is not mark)
    simplest = {chosen_among(kind)[0].name for kind in kinds}
    return Choice(chosen, rivals, tuple(one for one in rivals if one.name in simplest), mark)


def table_of(
    orders: Sequence[dict[str, Any]], choice: Choice, paper: Tried | None
) -> tuple[dict[str, Any], ...]:
    """Rows of every candidate; scores are ln of the chosen one's mean square error over its own."""
    chosen, rows = choice.chosen, [dict(row) for row in orders]
    if paper is not None and chosen is not paper:
        behind = next(one.gain for one in choice.rivals if one.name == paper.name)
        rows = [{**row, "score": row["score"] + behind, "chosen": False} for row in rows]
    if chosen is not paper:
        rows.append(_named_row(chosen.name, chosen.law, 0.0, 0.0) | {"chosen": True})
    for one in (*choice.rivals, *(() if choice.mark is None else (choice.mark,))):
        if paper is None or one.name != paper.name:
            time = {"tau_s": one.tau_s} if np.isfinite(one.tau_s) else {}
            rows.append(_named_row(one.name, one.model, one.gain, one.stderr) | time)
    return tuple(rows)


def _named_row(name: str, law: ChannelLaw | ChannelModel, score: float, stderr: float) -> dict[str, Any]:
    """A row of a law that is no Kelvin-Voigt law."""
    degree = law.degree if isinstance(law, ChannelLaw) else law.stiffness_degree
    return {
        "model": name, "branches": law.branches, "stiffness_degree": degree, "score": score,
        "stderr": stderr, "chosen": False,
    }  # fmt: skip


def chosen_among(tried: Sequence[Tried]) -> tuple[Tried, tuple[dict[str, Any], ...], list[Tried]]:
    """The simplest candidate within one standard error of the best, a table, and those that are as good."""
    best = min(tried, key=lambda one: float(np.log(np.maximum(one.errors, 1e-300)).mean()))
    rows = [(one, *_gain(best, one)) for one in tried]
    good = [row for row in rows if row[0] is best or row[1] <= tolerated(row[2], best.errors.size)]
    chosen = min(good, key=lambda row: (row[0].law.freedom, row[1], row[0].law.branches))[0]
    table = tuple(
        {
            "branches": one.law.branches, "stiffness_degree": one.law.degree, "score": -mean,
            "stderr": error, "chosen": one is chosen, "tau_s": float(np.exp(_first_time(one)[0])),
        }
        for one, mean, error in sorted(rows, key=lambda row: row[0].law.order)
    )  # fmt: skip
    return chosen, table, [one for one, *_ in good]
