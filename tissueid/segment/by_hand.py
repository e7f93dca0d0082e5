"""Decisions of the user instead of the data: said with the result, and a hold that begins where he says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.segment.options import SegmentOptions
from tissueid.segment.stop import travel_line
from tissueid.trial import Phase, Trial

#: A hold may begin in these kinds of phase.
HOLDABLE = ("ramp", "hold", "creep", "rest")


def by_hand(trial: Trial, options: SegmentOptions) -> tuple[Flag, ...]:
    """``decision_overridden`` for what was decided of a run and not, with its reason, in a study file."""
    known = {key for flag in trial.flags for key in flag.values.get("keys", ())}
    stated = {key: value for key, value in options.stated().items() if key not in known}
    if not stated:
        return ()
    words = ", ".join(f"{key} = {str(value).lower()}" for key, value in stated.items())
    because = "stated for this run"
    message = f"{words}, because: {because}"
    return (Flag("decision_overridden", message, {"keys": list(stated), "because": because}),)


def held_from_here(
    time_s: FloatArray, depth_mm: FloatArray, phases: tuple[Phase, ...], start_s: float
) -> tuple[Phase, ...]:
    """Phases of which the hold nearest to a time begins there; a ramp is parted where there is no hold.

    ``time_s``, ``depth_mm`` (n,); ``start_s``: as recorded [s].
    """
    at = int(np.argmin(np.abs(time_s - start_s)))
    holds = [k for k, phase in enumerate(phases) if phase.kind in ("hold", "creep") and k > 0]
    if holds:
        k = min(holds, key=lambda one: abs(phases[one].start_s - start_s))
        before, after = phases[k - 1], phases[k]
        if before.start < at < after.stop - 1:
            moved = (_ending(time_s, depth_mm, before, at), _starting(time_s, after, at))
            return (*phases[: k - 1], *moved, *phases[k + 1 :])
        return phases
    for k, phase in enumerate(phases):
        if phase.kind in HOLDABLE and phase.start < at < phase.stop - 1:
            hold = replace(_starting(time_s, phase, at), kind="hold", speed_mm_s=0.0)
            return (*phases[:k], _ending(time_s, depth_mm, phase, at), hold, *phases[k + 1 :])
    return phases


def _ending(time_s: FloatArray, depth_mm: FloatArray, phase: Phase, at: int) -> Phase:
    """A phase that ends at a sample."""
    speed = phase.speed_mm_s
    if speed != 0.0:
        speed, _ = travel_line(time_s, depth_mm, phase.start, at)
    return replace(phase, stop=at + 1, end_s=float(time_s[at]), speed_mm_s=speed)


def _starting(time_s: FloatArray, phase: Phase, at: int) -> Phase:
    """A phase that starts at a sample."""
    return replace(phase, start=at, start_s=float(time_s[at]))
