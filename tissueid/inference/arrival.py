"""Records that begin under a force while the tool moves: it came from air at that speed, or it stood.

A preload that was held has relaxed; one that a trigger has seen in passing has not.  The samples tell, or
draws reach from the one to the other: an approach that was slower lies between them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.inference.engine import Identified, badness
from tissueid.inference.logs import LogHandle

#: Natural logarithm of the odds from which on one of two starts is taken.
DECIDED = 3.0

#: Logs, identified, each law and order of a request or those of another fit alone.
Identify = Callable[[Sequence[LogHandle], Identified | None], tuple[Identified, list[LogHandle]]]


def _cost(found: Identified) -> float:
    """Criterion of a fit and its free parameters: Akaike's, halved."""
    return badness(found.system, found.optimum) + found.law.times + found.law.linear


def arrived(
    found: Identified, handles: list[LogHandle], identify: Identify, tick: Callable[[str], None]
) -> tuple[Identified, list[LogHandle]]:
    """The likelier of both starts; ``found``: under that of a preload that had relaxed."""
    if not any(one.facts.arrives_mm > 0.0 for one in handles):
        return found, handles
    tick("a start in motion")
    moving = [replace(one, arrives=one.facts.arrives_mm > 0.0) for one in handles]
    best, on, other = found, handles, identify(moving, found)[0]
    if _cost(other) <= _cost(found) + DECIDED:
        free, there = identify(moving, None)
        if _cost(free) < _cost(found):
            alike = (free.law.branches, free.law.degree) == (found.law.branches, found.law.degree)
            best, on, other = free, there, found if alike else identify(handles, free)[0]
    if _cost(other) > _cost(best) + DECIDED:
        return best, on
    ways = [np.concatenate([one.optimum.point.log_times, one.optimum.point.linear]) for one in (other, best)]
    return replace(best, apart=ways[0] - ways[1]), on


def start_flags(found: Identified, handles: Sequence[LogHandle]) -> tuple[Flag, ...]:
    """A start in motion, and one that might be."""
    if found.apart is None and not any(one.arrives for one in handles):
        return ()
    count = sum(one.facts.arrives_mm > 0.0 for one in handles)
    words = f"{count} of {len(handles)} recordings begin while the tool moves in the tissue"
    if found.apart is not None:
        words += ", or behind a relaxed preload: intervals hold both"
    return (Flag("begins_moving", words, {"recordings": count, "decided": found.apart is None}),)


def along(apart: FloatArray, count: int, seed: int) -> FloatArray:
    """Ways of draws towards the other start, (count, p): arcsine-distributed, so that both ends are held."""
    share = np.random.default_rng([seed, 11]).beta(0.5, 0.5, count)
    return np.asarray(share[:, None] * apart)
