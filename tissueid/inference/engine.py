"""From the logs of a specimen to the optimum of the law that predicts best, under its noise.

Candidates are fitted with the machine open; the noise is told with the most flexible of them, against what
the recordings show; the simplest that predicts what was left out is kept, and finished under its noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.inference.blocks import Blocks
from tissueid.inference.channel_law import ChannelLaw, kelvin_voigt_law, law_of
from tissueid.inference.choice import (
    Bent,
    Groups,
    Rival,
    Tried,
    bent_of,
    choice_of,
    chosen_among,
    describing,
    groups_of,
    held_out,
    resolved,
    shown,
    speeds_of,
    table_of,
)
from tissueid.inference.evidence import LogEvidence, NoiseVerdict, scan_memory, verdict_on_noise
from tissueid.inference.noise import Memory
from tissueid.inference.optimum import Noise, Optimum, criterion, minimise, whitener_of
from tissueid.inference.prior import Scatter, prior_rows, suited
from tissueid.inference.search import starting_points
from tissueid.inference.system import MACHINE, SHAPE, Effects, Point, System
from tissueid.inference.window import FittedLog, one_program
from tissueid.inference.yardstick_law import YardstickLaw, yardstick_law
from tissueid.model.channels import ChannelModel
from tissueid.model.grammar import KELVIN_VOIGT, Candidates, Named, candidates
from tissueid.priors import Priors

#: Share of the travel that frame and contact may take before less than the travel is claimed.
TAKEN = 0.1
#: Rounds in which the scatter between logs is estimated.
SCATTER_ROUNDS = 4
#: Standard deviation that the scatter counts as beforehand, worth one log.
SCATTER_PRIOR = Scatter(gain=0.05, shape=0.01, time=0.02)
#: Scatter that the search begins with: too narrow a one would have to be outgrown.
WIDE = Scatter(gain=0.5, shape=0.5, time=0.5)
#: Steps of a candidate that is only compared.
LOOK_STEPS = 14
#: Noise over the range of force below which the solution of the equations itself is no better.
LEAST_NOISE = 1e-6
#: Error of a prediction, over the range of force, below which laws are told apart by rounding alone.
ROUNDED = 1e-5


@dataclass(frozen=True, slots=True)
class Request:
    """Request to the engine."""

    #: Orders of the Kelvin-Voigt law that are tried.
    branches: tuple[int, ...] = (1, 2, 3)
    degrees: tuple[int, ...] = (0, 1, 2)
    pooling: str = "auto"  # ``scaled``, ``partial``, ``shared``, or by the speeds
    noise: str = "auto"  # ``auto``, ``white``, ``ar1`` or ``white+ar1``
    priors: Priors = field(default_factory=Priors)
    machine: bool = True  # leave frame, skew and filter open
    candidates: Candidates = field(default_factory=lambda: candidates(KELVIN_VOIGT))  # laws

    @property
    def single(self) -> bool:
        """True where nothing is chosen, and nothing held against."""
        laws = self.candidates
        orders = len(self.branches) * len(self.degrees)
        return not laws.choose and (laws.paper is None or orders == 1)


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """The optimum of the law that was chosen."""

    system: System  # under that law
    law: ChannelLaw
    optimum: Optimum
    scatter: Scatter
    verdict: NoiseVerdict
    discrepant: bool  # the law misses more than the noise of the recordings; levels are then weighted white
    table: tuple[dict[str, Any], ...]  # candidates with their scores
    as_good: tuple[tuple[int, int], ...]  # orders within one standard error of the best
    left_out: str  # what was predicted
    request: Request
    rivals: tuple[Rival, ...] = ()  # other laws beside the chosen one, the simplest of each kind
    bent: Bent | None = None  # the static force, were K not constant
    other: Identified | None = None  # the same order under a start that is as likely (:mod:`.arrival`)

    @property
    def quotable(self) -> bool:
        """False of the yardstick, which has no parameters to quote."""
        return not isinstance(self.law, YardstickLaw)

    @property
    def depth_mm(self) -> float:
        """Depth that is claimed: the travel, or the tip's own where frame and contact took a tenth of it."""
        system, point = self.system, self.optimum.point
        bent = float(point.machine[0]) * float(np.abs(system.force).max())
        offsets = system.offsets(point) * system.depth_mm
        tip = max(float(log.depth_mm.max()) - by for log, by in zip(system.logs, offsets, strict=True)) - bent
        material = self.quotable and 0.0 < tip < (1.0 - TAKEN) * system.depth_mm
        return float(tip) if material else system.depth_mm

    @property
    def model(self) -> ChannelModel:
        """The contact model to the depth that is claimed."""
        model, depth = self.law.model(), self.depth_mm
        return model if depth == self.system.depth_mm else replace(model, depth_mm=depth)


class _Fitting:
    """Candidates of one specimen, fitted from the same blocks."""

    def __init__(
        self, base: System, request: Request, least_N: float, step_s: float, speed: NDArray[np.int64]
    ) -> None:
        self.base, self.request, self.least_N, self.step_s = base, request, least_N, step_s
        self.speed = speed  # number of the speed of each log
        self.scatter, laws = WIDE, request.candidates
        self.known: dict[tuple[int, int], Point] = {}  # optima by order of the Kelvin-Voigt law
        # of laws without a Kelvin-Voigt one, the noise and the logs' differences are told by the freest
        told = [] if laws.paper is not None else [self.named(one) for one in laws.laws if not one.mark]
        self.freest = max(told, key=lambda law: law.freedom, default=None)
        machine = np.array([request.priors.calibration[name].mean for name in MACHINE])
        law, own = self.law(1, 0), np.zeros((len(base.logs), base.effects.size))
        self.at = Point(np.zeros(law.times), machine, np.zeros(law.linear), own)

    def law(self, branches: int, degree: int) -> ChannelLaw:
        """A Kelvin-Voigt law, or the freest of those that were asked for instead."""
        if self.freest is not None:
            return self.freest
        return kelvin_voigt_law(branches, degree, self.base.depth_mm)

    def named(self, name: Named) -> ChannelLaw:
        """A law by its name."""
        if name.mark:
            return yardstick_law(self.base, self.at, whitener_of(self.base, Memory()))
        longest = max(float(one.time_s[-1] - one.time_s[0]) for one in self.base.logs)
        return law_of(name.model(self.base.depth_mm, self.step_s, longest), len(self.base.logs))

    def minimise(
        self, system: System, start: Point, memory: Memory, steps: int, rival: float | None = None
    ) -> Optimum:
        """From one starting point."""
        return minimise(
            system,
            start,
            partial(prior_rows, system, self.scatter, self.request.priors, machine=self.request.machine),
            noise=memory,
            machine=self.request.machine,
            least_sigma_N=self.least_N,
            steps=steps,
            rival=rival,
        )

    def candidate(self, law: ChannelLaw, memory: Memory) -> tuple[System, Optimum]:
        """The best of several starts."""
        system = self.base.under(law)
        whole = law.model_of is None
        fewer = self.known.get((law.branches - 1, law.degree), self.at)
        at = replace(self.at, log_times=fewer.log_times)
        starts = [self.known[law.order]] if whole and law.order in self.known else []
        starts += starting_points(system, law, at, whitener_of(system, memory))
        found = list[tuple[float, Optimum]]()
        for start in starts:
            least = min((reached for reached, _ in found), default=np.inf)
            one = self.minimise(system, start, memory, LOOK_STEPS, least)
            found.append((badness(system, one), one))
        best = min(found, key=itemgetter(0))[1]
        if whole:
            self.known[law.order] = best.point
        return system, best

    def learn_scatter(self, branches: int, degree: int) -> None:
        """Estimate how much logs differ, and where each stands."""
        if not self.base.effects.gain:
            return
        system, optimum = self.candidate(self.law(branches, degree), Memory())
        for _ in range(SCATTER_ROUNDS):
            self.scatter = scatter_of(system, optimum, self.speed)
            optimum = self.minimise(system, optimum.point, Memory(), LOOK_STEPS)
        if system.law.model_of is None:
            self.known[branches, degree] = optimum.point
        self.at = replace(self.at, own=optimum.point.own, machine=optimum.point.machine)


def badness(system: System, optimum: Optimum) -> float:
    """Criterion smallest at the best optimum, the scale of the noise integrated."""
    return criterion(system, optimum.noise.sigma_N, optimum.prior, optimum.point)


def scatter_of(system: System, optimum: Optimum, speed: NDArray[np.int64]) -> Scatter:
    """Standard deviations between logs, about their mean: what all of them share is the specimen's."""
    own = optimum.point.own - optimum.point.own.mean(axis=0)
    variance = np.diagonal(optimum.normal.own_inverse, axis1=1, axis2=2)

    def sd(columns: slice, before: float) -> float:
        total = float((own[:, columns] ** 2).sum() + variance[:, columns].sum())
        per = own[:, columns].shape[1]
        return float(np.sqrt((total / per + before**2) / len(system.logs)))

    gain = sd(slice(0, 1), SCATTER_PRIOR.gain)
    shape = sd(slice(-SHAPE, None), SCATTER_PRIOR.shape) if system.effects.shape else SCATTER_PRIOR.shape
    time = _time_scatter(optimum, system.effects.time_at, speed) if system.effects.time else 0.0
    return Scatter(max(gain, 1e-5), max(shape, 1e-5), max(time, 1e-5))


def _time_scatter(optimum: Optimum, at: int, speed: NDArray[np.int64]) -> float:
    """Standard deviation of ln times between logs of one speed, by what they determine of theirs.

    MacKay's fixed point (1992, doi 10.1162/neco.1992.4.3.415); few logs tell it badly.  Times that follow the
    speed are the law's to explain.
    """
    own, precision = optimum.point.own[:, at], optimum.prior.own[:, at]
    alike = speed[:, None] == speed
    apart = own - alike @ own / alike.sum(axis=1)
    known = (1.0 - optimum.normal.own_inverse[:, at, at] * precision) * (1.0 - 1.0 / alike.sum(axis=1))
    told, total = float(known.sum()), float((apart**2).sum()) + SCATTER_PRIOR.time**2
    wider = float(stats.t.ppf(0.975, max(told, 2.0)) / stats.norm.ppf(0.975))
    return wider * float(np.sqrt(total / (told + 1.0)))


def _orders(request: Request) -> list[tuple[int, int]]:
    """First candidates: few, and a K that bends, which shapes of logs could stand in for."""
    branches = [b for b in request.branches if b <= 2] or [min(request.branches)]
    degrees = [d for d in request.degrees if d <= 1] or [min(request.degrees)]
    bent = [(1, d) for d in request.degrees if d > max(degrees) and 1 in branches]
    return [*((b, d) for b in branches for d in degrees), *(bent if request.pooling == "scaled" else [])]


def _further(request: Request, chosen: Tried, best: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Candidates beside a winner at the edge of those tried so far."""
    wanted = []
    branches, degree = chosen.law.order
    if branches == 2 or (2, degree) in best:
        wanted += [(3, 0), (3, 1)]
    if degree >= 1 or (branches, 1) in best:
        wanted += [(1, 2), (2, 2)]
    return [one for one in wanted if one[0] in request.branches and one[1] in request.degrees]


def identify_logs(
    logs: Sequence[Blocks],
    facts: Sequence[FittedLog],
    evidence: Sequence[LogEvidence],
    request: Request,
    tick: Callable[[str], None],
) -> Identified:
    """Choose and fit the law of a specimen; of ``facts`` the samples are not looked at."""
    depth = max(one.depth_mm for one in facts)
    step = min(one.step_s for one in facts)
    several, speed = len(logs) > 1, speeds_of(facts)
    if request.pooling == "auto":  # without a repeat of a speed, curves and times that differ are the law's
        repeated = np.unique(speed).size < max(len(logs), 2)
        request = replace(request, pooling="scaled" if repeated else "partial")
    scaled = several and request.pooling == "scaled"
    effects = Effects(several and request.pooling != "shared", scaled, scaled)
    base = System(logs, kelvin_voigt_law(1, 0, depth), depth, effects)
    request = replace(request, priors=suited(request.priors, float(np.abs(base.force).max()), depth))
    fitting = _Fitting(base, request, LEAST_NOISE * float(np.ptp(base.force)), step, speed)
    most = max(b for b in request.branches if b <= 2 or b == min(request.branches))
    flexible = (most, max(request.degrees) if effects.shape else min(1, max(request.degrees)))
    tick("how logs differ")
    fitting.learn_scatter(*flexible)
    groups, memory = groups_of(base, facts), Memory()
    tick("noise")
    if request.noise != "white":
        memory, _ = _noise(fitting, *fitting.candidate(fitting.law(*flexible), Memory()), evidence)
    orders, laws = _Orders(None, (), ()), request.candidates
    if laws.paper is not None:
        orders = _orders_tried(fitting, memory, groups, facts, tick)
    others = []
    for one in () if laws.paper is not None and request.single else laws.laws:
        tick(one.name)
        others.append(_tried(fitting, fitting.named(one), memory, None if request.single else groups))
    paper = orders.chosen
    choice = choice_of(paper, others, choose=laws.choose)
    found = _finished(fitting, choice.chosen, evidence, memory, groups.kind, tick)
    table = () if request.single else table_of(orders.table, choice, paper)
    as_good = orders.as_good if choice.chosen is paper else ()
    bent = orders.bent if choice.chosen is paper else None
    return replace(found, table=table, as_good=as_good, rivals=choice.simplest, bent=bent)


class _Orders(NamedTuple):
    """Orders of the Kelvin-Voigt law: the chosen one, their table, those that are as good."""

    chosen: Tried | None
    table: tuple[dict[str, Any], ...]
    as_good: tuple[tuple[int, int], ...]
    bent: Bent | None = None


def _orders_tried(
    fitting: _Fitting, memory: Memory, groups: Groups, facts: Sequence[FittedLog], tick: Callable[[str], None]
) -> _Orders:
    """Orders until none is wanted."""
    request, tried = fitting.request, list[Tried]()
    single = len(request.branches) * len(request.degrees) == 1
    orders = [(request.branches[0], request.degrees[0])] if single else _orders(request)
    while True:
        for branches, degree in orders:
            tick(f"{branches} branch{'es' if branches > 1 else ''}, K of degree {degree}")
            law = fitting.law(branches, degree)
            tried.append(_tried(fitting, law, memory, None if request.single else groups))
        seen_whole = describing([one for one in tried if resolved(one, fitting.step_s)] or tried[:1])
        if not single:
            seen_whole = shown(seen_whole, one_program=one_program(facts))
        chosen, table, as_good = chosen_among(seen_whole)
        done = {one.law.order for one in tried}
        best = tuple(one.law.order for one in as_good)
        orders = [] if single else [one for one in _further(request, chosen, best) if one not in done]
        if not orders:
            constant = not single and chosen.law.degree == 0
            return _Orders(chosen, table, best, bent_of(chosen, tried) if constant else None)


def _tried(fitting: _Fitting, law: ChannelLaw, memory: Memory, groups: Groups | None) -> Tried:
    """A law, fitted, and asked to predict what is left out."""
    system, optimum = fitting.candidate(law, memory)
    errors = np.ones(1)
    if groups is not None:
        least = (ROUNDED * float(np.ptp(system.force))) ** 2
        errors = np.maximum(held_out(system, optimum, groups), least)
    return Tried(optimum, system, errors, badness(system, optimum))


def _noise(
    fitting: _Fitting, system: System, optimum: Optimum, seen: Sequence[LogEvidence]
) -> tuple[Memory, NoiseVerdict]:
    """Memory of the noise in the residuals, none where it can't be noise, and the verdict on that."""
    parts, model = system.derivatives(optimum.point, machine=False), fitting.request.noise
    noise = scan_memory(
        system, optimum.point, parts, optimum.prior,
        step_s=fitting.step_s, rough_N=optimum.noise.sigma_N, model=model,
    )  # fmt: skip
    verdict = verdict_on_noise(noise, seen, step_s=fitting.step_s, alone=len(system.logs) == 1)
    if model != "auto":
        verdict = replace(verdict, refuted=False)
    return Memory() if verdict.refuted else noise.memory, verdict


def _finished(
    fitting: _Fitting,
    chosen: Tried,
    evidence: Sequence[LogEvidence],
    memory: Memory,
    left_out: str,
    tick: Callable[[str], None],
) -> Identified:
    """The chosen candidate under its own noise."""
    system, optimum = chosen.system, chosen.optimum
    tick("the optimum")
    for _ in range(2):
        optimum = fitting.minimise(system, optimum.point, memory, 40)
        if system.effects.gain:
            fitting.scatter = scatter_of(system, optimum, fitting.speed)
            optimum = fitting.minimise(system, optimum.point, memory, 40)
        wanted, verdict = _noise(fitting, system, optimum, evidence)
        if wanted == memory:
            break
        memory = wanted
    else:
        optimum = fitting.minimise(system, optimum.point, memory, 40)
    return Identified(
        system=system, law=chosen.law, optimum=optimum, scatter=fitting.scatter, verdict=verdict,
        discrepant=verdict.refuted, table=(), as_good=(), left_out=left_out, request=fitting.request,
    )  # fmt: skip


def refit(
    identified: Identified,
    *,
    machine: bool,
    start: Point | None = None,
    steps: int = 40,
    held: NDArray[np.int64] | None = None,
    noise: Noise | None = None,
) -> Optimum:
    """The optimum again, with the machine open or held where it is; ``noise``: held at its scale."""
    request = identified.request
    return minimise(
        identified.system,
        start or identified.optimum.point,
        partial(prior_rows, identified.system, identified.scatter, request.priors, machine=machine),
        noise=noise or identified.optimum.noise.memory,
        machine=machine,
        steps=steps,
        held=held,
    )
