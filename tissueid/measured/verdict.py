"""Keep it, push again, or stop and look: one reason with its number, while the tissue is still mounted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tissueid.documents.inspect import Verdict
from tissueid.documents.measured import Measured, MeasuredHold, MeasuredPush
from tissueid.flags import FLAGS, Flag, warning_line
from tissueid.measured.spread import ramp_reason
from tissueid.trial import Contact, Segmentation, Trial

#: From good to bad.
LEVELS = ("good", "look", "repeat")
#: Flags that spoil a recording, and those that ask for a look, the gravest first.
SPOILING, DOUBTFUL = (
    [code for code, kind in FLAGS.items() if kind.beside == level] for level in ("repeat", "look")
)
#: A hold should last so many relaxation times; it is said where it lasts less than so many.
HELD_TAUS, FEWEST_TAUS = 3.0, 2.0
#: Samples that a ramp and a relaxation time should have, and fewer than which are said.
SAMPLES_IN_RAMP, SAMPLES_IN_TAU, FEWEST_IN_TAU = 10, 5.0, 2.0
#: Pushes are compared where depth or peak agree within this share.
EQUAL = 0.05
#: Softening that is always within the spread, and its standard deviations.
LEAST_SOFTER, SOFTER_SD = 0.02, 2.0
#: Softening that is said where fewer than this many earlier pushes know no spread.
UNKNOWN_SPREAD, KNOWN_FROM = 0.1, 3


def verdict_of(
    trial: Trial, segmentation: Segmentation, measured: Measured, earlier: Sequence[MeasuredPush] = ()
) -> Verdict:
    """The verdict on one recording."""
    flags = {flag.code: flag for flag in reversed((*trial.flags, *segmentation.flags))}
    # what broke can't be pushed again, however its ramp ended
    spoiling = flags.keys() - {"aborted_ramp"} if "rupture" in flags else flags.keys()
    if again := next((code for code in SPOILING if code in spoiling), None):
        return Verdict("repeat", _told(flags[again]))
    if found := next(_doubts(trial, measured, earlier, flags), None):
        return Verdict("look", found)
    return Verdict("good", _no_air(segmentation.contact, measured.push, flags) or None)


def _doubts(
    trial: Trial, measured: Measured, earlier: Sequence[MeasuredPush], flags: dict[str, Flag]
) -> Iterator[str]:
    """Doubts that ask for a look, the gravest first."""
    if "rupture" in flags:
        yield f"{flags['rupture'].message}. Take another site"
    if softer := _softer(measured.push, earlier):
        yield softer
    if measured.push is not None:
        yield from _too_slow(trial, measured.push)
    # a pause on the way down is no hold that was meant
    longest = max(measured.holds, key=lambda one: one.length_s, default=None)
    if longest is not None:
        yield from _too_short(trial, longest)
    yield from (_told(flags[code]) for code in DOUBTFUL if code in flags)


def _told(flag: Flag) -> str:
    """Observation with its number, and the way out."""
    return warning_line(flag.code, flag.message).rstrip(".")


def _softer(push: MeasuredPush | None, before: Sequence[MeasuredPush]) -> str:
    """Sentence where a push is softer than the last equal one by more than they spread; else empty."""
    if push is None:
        return ""
    equal = [one for one in before if _equal(push, one)]
    if not equal:
        return ""
    stiffness = np.array([_secant(one) for one in equal])
    change = 1.0 - _secant(push) / float(stiffness[-1])
    spread = float(stiffness.std(ddof=1) / stiffness.mean()) if stiffness.size >= KNOWN_FROM else None
    limit = UNKNOWN_SPREAD if spread is None else max(SOFTER_SD * spread, LEAST_SOFTER)
    if change <= limit:
        return ""
    known = "" if spread is None else f", spread {100.0 * spread:.2g} %"
    return f"{100.0 * change:.2g} % softer than the last push{known}: rest longer, or take another site"


def _equal(push: MeasuredPush, other: MeasuredPush) -> bool:
    if ramp_reason(None, [push.ramp_time_s, other.ramp_time_s]) or not _secant(other) > 0.0:
        return False
    depths = abs(push.travel_mm - other.travel_mm) <= EQUAL * abs(other.travel_mm)
    return depths or abs(push.peak.force_N - other.peak.force_N) <= EQUAL * abs(other.peak.force_N)


def _secant(push: MeasuredPush) -> float:
    """Peak over travel: contact, which is known worse, plays no part."""
    return push.peak.force_N / push.travel_mm if push.travel_mm > 0.0 else 0.0


def _too_slow(trial: Trial, push: MeasuredPush) -> Iterator[str]:
    inside = int(((trial.time_s >= push.start_s) & (trial.time_s <= push.stop_s)).sum())
    if inside < SAMPLES_IN_RAMP and push.ramp_time_s > 0.0:
        rate = 2.0 * SAMPLES_IN_RAMP / push.ramp_time_s
        yield f"sampling too slow: {inside} samples in a ramp of {push.ramp_time_s:.3g} s; take {rate:.2g} Hz"


def _too_short(trial: Trial, hold: MeasuredHold) -> Iterator[str]:
    """Sentences where the hold, or its samples, are too few for the relaxation that it shows."""
    tau = None if hold.tau is None else hold.tau.single_s
    if tau is None:
        return
    if hold.length_s < FEWEST_TAUS * tau:
        yield (
            f"hold too short: {hold.length_s:.3g} s for a relaxation time of {tau:.2g} s; "
            f"hold {HELD_TAUS * tau:.2g} s or longer"
        )
    first = int(np.searchsorted(trial.time_s, hold.start_s))
    last = int(np.searchsorted(trial.time_s, hold.start_s + HELD_TAUS * tau, side="right"))
    held = trial.time_s[first : max(last, first + 2)]
    step = float(np.diff(held).mean()) if held.size > 1 else hold.length_s
    # the noise of a hold that does not relax has a time below its step
    if step <= tau < FEWEST_IN_TAU * step:
        yield (
            f"sampling too slow: a relaxation time of {tau:.2g} s, samples {step:.2g} s apart; "
            f"take {SAMPLES_IN_TAU / tau:.2g} Hz"
        )


def _no_air(contact: Contact | None, push: MeasuredPush | None, flags: dict[str, Flag]) -> str:
    if contact is None or contact.in_record or push is None or push.depth_mm is None or push.depth_mm <= 0.0:
        return ""
    if not {"starts_in_contact", "preload"} & set(flags):
        return ""
    known = f"depth known to {100.0 * contact.sd_mm / push.depth_mm:.2g} % if the force was zeroed in air"
    return f"no air before contact: {known}. Start in air"
