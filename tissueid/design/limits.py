"""Limits of the precision: how much better the best protocol would be if one thing were otherwise."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from tissueid.design.machine import Machine, Setting
from tissueid.design.precision import Asked, Ledger
from tissueid.design.search import enumerated

#: A change that betters the precision by less is not worth telling.
WORTH_TELLING = 1.1
TIMES = 10.0
#: A frame that does not give.
RIGID_N_PER_MM = 1e9

_Change = tuple[str, str, Machine, Setting, Asked]


@dataclass(frozen=True, slots=True)
class Limit:
    """One thing, changed."""

    name: str  # ``noise``, ``filter``, ``rate``, ``speed``, ...
    words: str  # what was changed
    factor: float  # by how much the precision betters
    enough: bool  # the wants would be reached


def _channel(machine: Machine, now: Setting, asked: Asked) -> Iterator[_Change]:
    """Changes of the load channel."""
    quiet, often = replace(now, noise_N=now.noise_N / TIMES), replace(now, rate_Hz=TIMES * now.rate_Hz)
    yield "noise", f"a tenth of the noise ({quiet.noise_N:.3g} N)", machine, quiet, asked
    words = f"ten times the sampling rate ({often.rate_Hz:.4g} Hz), noise a sample the same"
    yield "rate", words, machine, often, asked
    if now.noise_correlation_s > 0.0:
        white = replace(now, noise_correlation_s=0.0)
        yield "correlation", "noise that is white", machine, white, asked
    if now.filter_s > 0.0:
        free = replace(now, filter_s=0.0, noise_correlation_s=0.0, filter_sd_s=0.0)
        yield "filter", "no filter, white noise of the same size", machine, free, asked


def _mechanics(machine: Machine, now: Setting, asked: Asked) -> Iterator[_Change]:
    """Changes of what moves."""
    faster = replace(machine, max_speed_mm_min=TIMES * machine.max_speed_mm_min)
    yield "speed", f"ten times the top speed ({faster.max_speed_mm_min:.4g} mm/min)", faster, now, asked
    quicker = replace(machine, acceleration_mm_s2=TIMES * machine.acceleration_mm_s2)
    words = f"ten times the acceleration ({quicker.acceleration_mm_s2:.4g} mm/s²)"
    yield "acceleration", words, quicker, now, asked
    both = replace(faster, acceleration_mm_s2=quicker.acceleration_mm_s2)
    yield "speed and acceleration", "ten times the top speed and acceleration", both, now, asked
    found = replace(machine, contact_sd_mm=machine.contact_sd_mm / TIMES)
    yield "contact", f"a contact point known to {found.contact_sd_mm:.2g} mm", found, now, asked
    if asked.gain_sd > 0.0:
        yield "gain", "logs without a scatter of their gain", machine, now, replace(asked, gain_sd=0.0)


def _room(machine: Machine, now: Setting, asked: Asked) -> Iterator[_Change]:
    """Changes of what is allowed."""
    force = replace(asked, max_force_N=TIMES * asked.max_force_N)
    yield "force", f"{force.max_force_N:.3g} N allowed", machine, now, force
    deep = replace(asked, max_depth_mm=2.0 * asked.max_depth_mm)
    yield "depth", f"{deep.max_depth_mm:.3g} mm allowed", machine, now, deep
    long = replace(asked, budget_s=TIMES * asked.budget_s, max_logs=int(TIMES) * asked.max_logs)
    yield "time", "ten times the machine time and logs", machine, now, long


def _instrument(machine: Machine, now: Setting, asked: Asked) -> Iterator[_Change]:
    """A calibration that is known exactly, one nuisance at a time."""
    if not asked.total:
        return
    stiffness = machine.frame_stiffness_N_per_mm or RIGID_N_PER_MM
    known = replace(machine, frame_stiffness_N_per_mm=stiffness, frame_stiffness_N_per_mm_sd=0.0)
    yield "frame", "a frame whose give is known exactly", known, now, asked
    exact = replace(now, filter_sd_s=0.0)
    yield "filter knowledge", "a force filter that is known exactly", machine, exact, asked
    gains = replace(machine, force_gain_sd=0.0, displacement_gain_sd=0.0)
    yield "gains", "force and displacement without an error of their gain", gains, now, asked
    together = replace(machine, skew_sd_s=0.0)
    yield "skew", "force and displacement without a skew", together, now, asked


def limits_of(ledger: Ledger, progress: Callable[[str, int, int], None]) -> tuple[Limit, ...]:
    """Gains of the best protocol of a ledger from each change, the greatest gain first."""
    machine, now, asked = ledger.chain.machine, ledger.chain.setting, ledger.asked
    best = enumerated(ledger)[0][0].worst
    changes = [
        change for kind in (_channel, _mechanics, _room, _instrument) for change in kind(machine, now, asked)
    ]
    out = []
    for number, (name, words, other, setting, allowed) in enumerate(changes):
        progress("what limits it", number, len(changes))
        chain = replace(ledger.chain, machine=other, setting=setting, gain_sd=allowed.gain_sd)
        found, _ = enumerated(Ledger(ledger.tissues, chain, allowed))
        if not found:
            continue
        # a protocol that reaches the wants is made no better than it must be
        enough = found[0].worst <= 1.0
        out.append(Limit(name, words, best if enough else best / found[0].worst, enough))
    telling = [one for one in out if one.factor >= WORTH_TELLING]
    return tuple(sorted(telling, key=lambda one: (not one.enough, -one.factor)))
