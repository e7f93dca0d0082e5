"""From what is asked to ranked protocols, judged on all tissues, and what limits their precision."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissueid.design.machine import Machine, Setting
from tissueid.design.precision import Asked, Ledger, Protocol
from tissueid.design.search import (
    REFINED,
    Found,
    balanced,
    count_paths,
    enumerated,
    refined,
    rounded,
    shallowest,
)
from tissueid.design.tissues import Tissues
from tissueid.documents.design import Limit, Want
from tissueid.errors import UsageError, refuse

#: A change that betters the precision by less is not worth telling.
WORTH_TELLING = 1.1
TIMES = 10.0
#: A frame that does not give.
RIGID_N_PER_MM = 1e9

Progress = Callable[[str, int, int], None]
#: Name, words, and fields of machine, setting and request that become others.
_Change = tuple[str, str, dict[str, Any], dict[str, Any], dict[str, Any]]


def _of_machine(machine: Machine, now: Setting) -> Iterator[_Change]:
    """Changes of the load channel, and of what moves."""
    words = f"a tenth of the noise ({now.noise_N / TIMES:.3g} N)"
    yield "noise", words, {}, {"noise_N": now.noise_N / TIMES}, {}
    words = f"ten times the sampling rate ({TIMES * now.rate_Hz:.4g} Hz), noise a sample the same"
    yield "rate", words, {}, {"rate_Hz": TIMES * now.rate_Hz}, {}
    if now.noise_correlation_s > 0.0:
        yield "correlation", "noise that is white", {}, {"noise_correlation_s": 0.0}, {}
    if now.filter_s > 0.0:
        free = {"filter_s": 0.0, "noise_correlation_s": 0.0, "filter_sd_s": 0.0}
        yield "filter", "no filter, white noise of the same size", {}, free, {}
    fast = {"max_speed_mm_min": TIMES * machine.max_speed_mm_min}
    yield "speed", f"ten times the top speed ({fast['max_speed_mm_min']:.4g} mm/min)", fast, {}, {}
    quick = {"acceleration_mm_s2": TIMES * machine.acceleration_mm_s2}
    words = f"ten times the acceleration ({quick['acceleration_mm_s2']:.4g} mm/s²)"
    yield "acceleration", words, quick, {}, {}
    yield "speed and acceleration", "ten times the top speed and acceleration", fast | quick, {}, {}
    sd = machine.contact_sd_mm / TIMES
    yield "contact", f"a contact point known to {sd:.2g} mm", {"contact_sd_mm": sd}, {}, {}


def _of_request(machine: Machine, asked: Asked) -> Iterator[_Change]:
    """Changes of what is allowed, and a calibration that is known exactly, one nuisance at a time."""
    if asked.gain_sd > 0.0:
        yield "gain", "logs without a scatter of their gain", {}, {}, {"gain_sd": 0.0}
    if asked.time_sd > 0.0:
        yield "times", "logs that relax alike", {}, {}, {"time_sd": 0.0}
    force, deep = TIMES * asked.max_force_N, 2.0 * asked.max_depth_mm
    yield "force", f"{force:.3g} N allowed", {}, {}, {"max_force_N": force}
    yield "depth", f"{deep:.3g} mm allowed", {}, {}, {"max_depth_mm": deep}
    long = {"budget_s": TIMES * asked.budget_s, "max_logs": int(TIMES) * asked.max_logs}
    yield "time", "ten times the machine time and logs", {}, {}, long
    if not asked.total:
        return
    stiffness = machine.frame_stiffness_N_per_mm or RIGID_N_PER_MM
    known = {"frame_stiffness_N_per_mm": stiffness, "frame_stiffness_N_per_mm_sd": 0.0}
    yield "frame", "a frame whose give is known exactly", known, {}, {}
    yield "filter knowledge", "a force filter that is known exactly", {}, {"filter_sd_s": 0.0}, {}
    gains = {"force_gain_sd": 0.0, "displacement_gain_sd": 0.0}
    yield "gains", "force and displacement without an error of their gain", gains, {}, {}
    yield "skew", "force and displacement without a skew", {"skew_sd_s": 0.0}, {}, {}


def limits_of(ledger: Ledger, progress: Progress) -> tuple[Limit, ...]:
    """Gains of the best protocol of a ledger from each change, the greatest gain first."""
    machine, now, asked = ledger.machine, ledger.setting, ledger.asked
    best = enumerated(ledger)[0][0].worst
    changes = [*_of_machine(machine, now), *_of_request(machine, asked)]
    out = []
    for number, (name, words, *fields) in enumerate(changes):
        progress("what limits it", number, len(changes))
        other, setting = replace(machine, **fields[0]), replace(now, **fields[1])
        found, _ = enumerated(Ledger(other, setting, ledger.tissues, replace(asked, **fields[2])))
        if not found:
            continue
        # a protocol that reaches the wants is made no better than it must be
        enough = found[0].worst <= 1.0
        out.append(Limit(name, words, best if enough else best / found[0].worst, enough))
    telling = [one for one in out if one.factor >= WORTH_TELLING]
    return tuple(sorted(telling, key=lambda one: (not one.enough, -one.factor)))


#: Tissues that the search looks at; the result is judged on all.
PILOT = 4
#: Protocols that are judged on all tissues, and that are listed.
FINALISTS, LISTED = 16, 10
#: Machine times that differ by less, relatively, count as one.
SAME_TIME = 0.01
#: Multiples of the wanted precision at which the least machine time is worked out.
FRONT = (4.0, 2.0, 1.4, 1.0, 0.7, 0.5, 0.25)


@dataclass(frozen=True, slots=True, eq=False)
class Judged(Found):
    """A protocol on all tissues."""

    setting: Setting
    #: Relative standard deviation of every wanted number.
    assured: tuple[float, ...]
    median: tuple[float, ...]
    #: Of each indentation in the protocol's order.
    log_seconds: tuple[float, ...]
    peak_N: tuple[float, ...]

    @property
    def reached(self) -> bool:
        """True where all wants are met."""
        return self.worst <= 1.0

    @property
    def rank(self) -> tuple[float, float]:
        """Those that reach the wants by time (to a hundredth), then by precision; then the others."""
        if not self.reached:
            return np.inf, self.worst
        return np.floor(np.log(self.seconds) / SAME_TIME), self.worst


@dataclass(frozen=True, slots=True, eq=False)
class Against:
    """A protocol that is given: what it would reach on this machine, or why it can't be run there."""

    name: str
    judged: Judged | None
    obstacle: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Everything that was found."""

    ranked: tuple[Judged, ...]  # the best first; the first is recommended where it reaches the wants
    front: tuple[tuple[float, Judged], ...]  # multiples of the wants, and the protocol of least time for them
    limits: tuple[Limit, ...]  # what limits the precision, where no protocol reaches the wants
    #: How many were simulated and looked at.
    paths: int
    protocols: int

    @property
    def best(self) -> Judged:
        """The recommended protocol, or the one that comes nearest."""
        return self.ranked[0]


def judged(ledger: Ledger, protocol: Protocol) -> Judged:
    """A protocol on all tissues of a ledger."""
    found = ledger.precision(protocol)
    return Judged(
        setting=ledger.setting,
        protocol=protocol,
        seconds=ledger.duration(protocol),
        assured=tuple(found.assured.tolist()),
        median=tuple(np.median(found.sd, axis=1).tolist()),
        worst=float(found.worst),
        log_seconds=tuple(ledger.seconds(test) - ledger.asked.recovery_s for test in protocol),
        peak_N=tuple(ledger.peak_N(test) for test in protocol),
    )


def against(name: str, protocol: Protocol, machine: Machine, tissues: Tissues, asked: Asked) -> Against:
    """Precision that a given protocol reaches with the best setting of the machine."""
    for test in protocol:
        if test.speed_mm_min > machine.max_speed_mm_min * (1.0 + 1e-9):
            obstacle = (
                f"it moves at {test.speed_mm_min:g} mm/min, the machine at {machine.max_speed_mm_min:g}"
            )
            return Against(name, None, obstacle)
    options = [judged(Ledger(machine, setting, tissues, asked), protocol) for setting in machine.settings]
    return Against(name, min(options, key=lambda one: one.worst))


def matched_wants(protocol: Protocol, machine: Machine, tissues: Tissues, asked: Asked) -> tuple[Want, ...]:
    """The precision that a given protocol reaches, as wants."""
    found = against("", protocol, machine, tissues, asked).judged
    if found is None:
        return asked.wants
    return tuple(
        Want(want.name, float(share)) for want, share in zip(asked.wants, found.assured, strict=True)
    )


def _check_room(machine: Machine, ledgers: Sequence[Ledger], asked: Asked) -> None:
    """Refuse what leaves nothing to do at all."""
    deepest = ledgers[0].deepest(machine.max_speed_mm_min)
    if rounded(deepest) < shallowest(ledgers[0]) and not any(map(count_paths, ledgers)):
        force = (
            f"{asked.max_force_N:g} N are reached at {deepest:.2g} mm, too shallow to plan anything: raise "
            "--max-force, or the load cell's"
        )
        depth = f"{asked.max_depth_mm:g} mm are within the error of the contact point: raise --max-depth"
        raise UsageError(force if deepest < asked.max_depth_mm else depth)
    if asked.repeats > asked.max_logs:
        refuse(f"--repeats {asked.repeats} does not fit --max-logs {asked.max_logs}")


def planned(machine: Machine, tissues: Tissues, asked: Asked, progress: Progress) -> Plan:
    """Search all settings."""
    pilot = tissues.pilot(PILOT)
    ledgers = [Ledger(machine, setting, pilot, asked) for setting in machine.settings]
    _check_room(machine, ledgers, asked)
    total = sum(count_paths(ledger) for ledger in ledgers)
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        progress("indentations", min(done, total), total)

    pools: list[tuple[Ledger, list[Found]]] = []
    looked = 0
    for ledger in ledgers:
        ledger.tick = tick
        found, count = enumerated(ledger)
        looked += count
        if found:
            pools.append((ledger, found))
    if not pools:
        refuse(
            f"no protocol of {asked.repeats} repeats fits a machine time of {asked.budget_s / 60:.3g} min "
            f"with {asked.setup_s:g} s to mount and {asked.recovery_s:g} s of rest: allow a larger --budget"
        )
    ranked = _ranked(machine, tissues, asked, _finalists(pools, progress), progress)
    best = next(ledger for ledger in ledgers if ledger.setting == ranked[0].setting)
    return Plan(
        ranked=tuple(ranked[:LISTED]),
        front=_front(best, progress),
        limits=() if ranked[0].reached else limits_of(best, progress),
        paths=sum(ledger.computed for ledger in ledgers),
        protocols=looked,
    )


def _finalists(
    pools: Sequence[tuple[Ledger, list[Found]]], progress: Progress
) -> list[tuple[Setting, Found]]:
    """The refined protocols of every setting, and the best of its enumeration."""
    out: list[tuple[Setting, Found]] = []
    for number, (ledger, found) in enumerate(pools):
        progress("refining", number, len(pools))
        better = refined(ledger, found[:REFINED])
        out += [(ledger.setting, one) for one in (*better, *found)]
    return out


#: What protocols that differ in repeats and holds only have in common: setting, speeds and depths.
_Family = tuple[Setting, frozenset[tuple[float, float]]]


def _ranked(
    machine: Machine,
    tissues: Tissues,
    asked: Asked,
    finalists: Sequence[tuple[Setting, Found]],
    progress: Progress,
) -> list[Judged]:
    """The best of every family, its repeats balanced for all tissues."""
    best: dict[_Family, Found] = {}
    for setting, one in sorted(finalists, key=lambda pair: pair[1].rank):
        best.setdefault(
            (setting, frozenset((test.speed_mm_min, test.depth_mm) for test in one.protocol)), one
        )
    chosen = list(best.items())[:FINALISTS]
    # every setting is shown once at least
    for setting in machine.settings:
        if not any(key[0] == setting for key, _ in chosen):
            chosen += [item for item in best.items() if item[0][0] == setting][:1]
    whole = {setting: Ledger(machine, setting, tissues, asked) for setting in machine.settings}
    out = []
    for number, ((setting, _), one) in enumerate(chosen):
        progress("judging on all tissues", number, len(chosen))
        ledger = whole[setting]
        fitting = balanced(ledger, tuple(one.protocol), one.protocol) if one.worst <= 1.0 else one
        out.append(judged(ledger, fitting.protocol))
    return sorted(out, key=lambda one: one.rank)


def _front(ledger: Ledger, progress: Progress) -> tuple[tuple[float, Judged], ...]:
    """The least machine time for multiples of the wants, by enumeration."""
    out: list[tuple[float, Judged]] = []
    asked = ledger.asked
    for number, factor in enumerate(FRONT):
        progress("front", number, len(FRONT))
        ledger.asked = replace(
            asked, wants=tuple(Want(want.name, factor * want.share) for want in asked.wants)
        )
        found, _ = enumerated(ledger)
        ledger.asked = asked
        if found and found[0].worst <= 1.0 and not any(one.protocol == found[0].protocol for _, one in out):
            out.append((factor, judged(ledger, found[0].protocol)))
    return tuple(out)
