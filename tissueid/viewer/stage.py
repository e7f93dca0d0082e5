"""Shown state of a server, the clock that says when there is something new to send, and the pointer.

The pointer: mouse or keys on a page lead the hand that holds the simulated device.
The hand is a spring and a damper around the point it is led to, so that the force on it shows: it is pushed
back from the tissue by force over stiffness.  Letting go leads it back above the tissue.  The shared memory
that this writes exists for a simulated device alone; where there is none, every pointer is refused.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tissueid.haptics.shared_hand import SharedHand
from tissueid.viewer.security import RefusalLog

if TYPE_CHECKING:
    from tissueid.viewer.feed import LiveFeed, Source

#: Between two looks at the ring [s]: half of it is the mean age it adds, its inverse the frames a second.
TURN_S = 0.01
#: A page that leads the hand answers a hundred frames a second; one that hangs, or whose machine is gone,
#: is heard of no more, and its connection may last for minutes [s].
SILENCE_S = 4.0


class Stage:
    """One session, for all clients.

    ``hello``: the first message; None until the session is known; ``pointer``: none where no page may lead a
    hand; ``clients``: those connected.
    """

    def __init__(self) -> None:
        self.hello: str | None = None
        self.pointer: HandPointer | None = None
        self.log = RefusalLog()
        self.clients: set[object] = set()
        #: Who leads the hand, and when anything was heard of it last [s].
        self.leader: object = None
        self.leader_heard_s = 0.0
        self._source: Callable[[], Source] | None = None
        self._feed: LiveFeed | None = None
        self._known = asyncio.Event()
        self._news = asyncio.Event()
        self._statuses: list[str] = []

    def show_live(self, hello: Mapping[str, Any], feed: LiveFeed, pointer: HandPointer | None = None) -> None:
        """Show a running servo."""
        self._feed, self.pointer = feed, pointer
        self._show(hello, lambda: feed)

    def show_log(self, hello: Mapping[str, Any], source: Callable[[], Source]) -> None:
        """Show a log: a source of its own for each client."""
        self._show(hello, source)

    def _show(self, hello: Mapping[str, Any], source: Callable[[], Source]) -> None:
        self.hello, self._source = json.dumps(hello, allow_nan=False), source
        self._known.set()

    def end(self) -> None:
        """The servo has ended."""
        if self._feed is not None:
            self._feed.end()

    def tell(self, words: Mapping[str, Any]) -> None:
        """A status for all clients, now and later."""
        self._statuses.append(json.dumps({"type": "status", **words}, allow_nan=False))
        self._wake()

    def statuses(self, seen: int) -> list[str]:
        """Statuses after the first ``seen``."""
        return self._statuses[seen:]

    async def source(self) -> Source:
        """A source for a new client, as soon as there is a session."""
        await self._known.wait()
        assert self._source is not None  # noqa: S101 -- set before the event
        if self._feed is not None:
            self._feed.pump()
        return self._source()

    async def news(self) -> None:
        """Wait until there may be something to send."""
        await self._news.wait()

    def let_go(self) -> None:
        """A hand that nobody leads any more leaves the tissue."""
        if self.leader is not None and self.pointer is not None:
            self.pointer.lead(None)
        self.leader = None

    async def run(self) -> None:
        """Look for what is new, for ever; without a client nothing is looked for."""
        while True:
            await asyncio.sleep(TURN_S)
            if self.leader is not None and time.monotonic() - self.leader_heard_s > SILENCE_S:
                self.let_go()
            if self.pointer is not None:
                self.pointer.hand.stay()
            if self.clients:
                if self._feed is not None:
                    self._feed.pump()
                self._wake()

    def _wake(self) -> None:
        waiting, self._news = self._news, asyncio.Event()
        waiting.set()


#: How far beyond the workspace a hand may be led [m]: 6 N of a 300 N/m hand.
BEYOND_M = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class HandPointer:
    """Leads a hand within its workspace."""

    hand: SharedHand
    rest_m: NDArray[np.float64]  # (3,), where it goes when it is let go [m]
    #: (3,): corners of the workspace [m].
    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]  # (3,)

    def lead(self, position_m: Sequence[float] | None) -> None:
        """Lead the hand to a point, or back to its rest.

        ``position_m``: device frame [m]; cut to the workspace and 20 mm around it.
        """
        wanted = self.rest_m if position_m is None else np.asarray(position_m, dtype=np.float64)
        self.hand.point_at(np.clip(wanted, self.low_m - BEYOND_M, self.high_m + BEYOND_M).tolist())
