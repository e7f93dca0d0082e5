"""Records that begin under a force while the tool moves: it came from air at that speed, or it stood.

A preload that was held has relaxed; one that a trigger has seen in passing has not.  Where the samples do not
tell, half of the draws are of either: an approach that was slower lies between them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from tissueid.flags import Flag
from tissueid.inference.engine import Identified, badness
from tissueid.inference.logs import LogHandle

#: Natural logarithm of the odds from which on one of two starts is taken.
DECIDED = 3.0

#: Logs, identified, each law and order of a request or those of another fit alone.
Identify = Callable[[Sequence[LogHandle], Identified | None], tuple[Identified, list[LogHandle]]]


def _cost(found: Identified) -> float:
    """Criterion of a fit and its free parameters: Akaike's, halved."""
    return 0.5 * badness(found.system, found.optimum) + found.law.times + found.law.linear


def arrived(
    found: Identified, handles: list[LogHandle], identify: Identify, tick: Callable[[str], None]
) -> tuple[Identified, list[LogHandle]]:
    """The likelier of both starts; ``found``: under that of a preload that had relaxed."""
    if not any(one.facts.arrives_mm > 0.0 for one in handles):
        return found, handles
    tick("a start in motion")
    moving = [_in_motion(one) if one.facts.arrives_mm > 0.0 else one for one in handles]
    starts = (found, handles), identify(moving, None)
    (best, on), (other, at) = sorted(starts, key=lambda start: _cost(start[0]))
    if best.law.order != other.law.order:
        other, _ = identify(at, best)
    if _cost(other) > _cost(best) + DECIDED:
        return best, on
    return replace(best, other=other), on


def _in_motion(handle: LogHandle) -> LogHandle:
    """The log as one whose tool came at the speed of its first samples, from where their stiffness says."""
    divided, back_mm = handle.segmentation, handle.facts.arrives_mm
    deeper_mm = float(handle.facts.data.depth_mm[0]) - back_mm
    assert divided.contact is not None  # noqa: S101  (it is fitted)
    met_mm = divided.contact.displacement_mm + divided.compression_sign * deeper_mm
    return replace(
        handle,
        arrives=True,
        segmentation=replace(divided, contact=replace(divided.contact, displacement_mm=met_mm)),
        contact_shift_mm=deeper_mm,
        contact_sd_mm=back_mm if deeper_mm else handle.contact_sd_mm,
    )


def start_flags(found: Identified, handles: Sequence[LogHandle]) -> tuple[Flag, ...]:
    """A start in motion, and one that might be."""
    if found.other is None and not any(one.arrives for one in handles):
        return ()
    count = sum(one.facts.arrives_mm > 0.0 for one in handles)
    words = f"{count} of {len(handles)} recordings begin while the tool moves in the tissue"
    if found.other is not None:
        words += ", or behind a relaxed preload: intervals hold both"
    return (Flag("begins_moving", words, {"recordings": count, "decided": found.other is None}),)
