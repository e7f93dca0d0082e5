"""Messages between the owner and the servo process, and how punctual it was, as frozen data.

Down goes one plan, pickled, with the descriptors of the shared memories, over a private socket whose other
end stays open: its end of file is the owner's death.  Up come lines of JSON: ``ready``, then ``ended`` or
``failed``.
"""

from __future__ import annotations

import json
import os
import pickle
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from tissueid.arrays import IntArray
from tissueid.haptics.states import FAULT_WORDS, Fault, State
from tissueid.rendering.servo_loop import BIN_NS, LATE_SHARE

#: Share of late ticks above which a session is labelled.
DEGRADED_SHARE = 0.01
_US = 1e-3


@dataclass(frozen=True, slots=True)
class PeriodStatistics:
    """Absolute period errors of a session."""

    #: Ticks run, and deadlines skipped.
    ticks: int
    missed: int
    period_us: float
    #: Of |measured period - period|; quantiles to 1 us.
    median_us: float
    p99_us: float
    p999_us: float
    max_us: float
    late_share: float  # share of ticks off by more than a tenth of the period; a skipped tick counts as one
    scheduling: str  # scheduling class the servo really had

    @property
    def degraded(self) -> bool:
        """True where the session is labelled "timing degraded"."""
        return self.late_share > DEGRADED_SHARE

    @property
    def label(self) -> str:
        """Label in console, viewer and log: "timing degraded" or "timing good"."""
        return "timing degraded" if self.degraded else "timing good"

    def as_dict(self) -> dict[str, Any]:
        """The figures for a log, with the label."""
        return {**asdict(self), "label": self.label}


def period_statistics(histogram: IntArray, missed: int, period_ns: int, scheduling: str) -> PeriodStatistics:
    """Figures from a loop's histogram.

    ``histogram`` (BINS + 1,): as :func:`tissueid.rendering.servo_loop.realtime_loop` filled it; ``missed``:
    deadlines skipped.
    """
    counts = histogram[:-1]
    total = int(counts.sum())
    passed = np.cumsum(counts)

    def quantile(share: float) -> float:
        """Lower end of the bin that holds this share [us]."""
        return float(np.searchsorted(passed, share * total)) * BIN_NS * _US if total else 0.0

    # errors above a tenth of the period, counted from the first bin that lies wholly above it
    first = period_ns // LATE_SHARE // BIN_NS + 1
    late = int(counts[first:].sum()) + missed
    return PeriodStatistics(
        ticks=total,
        missed=missed,
        period_us=period_ns * _US,
        median_us=quantile(0.5),
        p99_us=quantile(0.99),
        p999_us=quantile(0.999),
        max_us=float(histogram[-1]) * _US,
        late_share=late / (total + missed) if total else 0.0,
        scheduling=scheduling,
    )


#: Why a loop ended, by the numbers of :mod:`tissueid.rendering.servo_loop`.
REASONS = ("fault", "stopped", "signal", "ticks")
_LENGTH_BYTES = 8
#: At 1 kHz more ticks than anybody's session: 24 days.
NO_END = 2**31


@dataclass(frozen=True, slots=True)
class ServoPlan:
    """One session of the servo."""

    device: str  # name in the registry; never ``auto``, which the owner resolves and says
    options: dict[str, Any] = field(default_factory=dict)  # arguments of the device's class; must pickle
    #: Name of a force law of another distribution, in the place of the compiled environment.
    law: str | None = None
    period_ns: int = 1_000_000
    ticks: int = NO_END  # most ticks to run
    alive_wanted: bool = True  # whether 500 ms without a sign of life take the force away
    #: Whether the hand of the simulated device lies in shared memory, for a pointer; no other device's does.
    shared_hand: bool = False


@dataclass(frozen=True, slots=True)
class ServoReady:
    """The servo runs."""

    #: False for a device or a law in Python, and where compiling is switched off: the loop runs uncompiled.
    compiled: bool
    scheduling: str  # scheduling class
    remedies: tuple[str, ...]  # what was refused, and how to get it


@dataclass(frozen=True, slots=True)
class ServoEnd:
    """End of a session."""

    reason: str  # one of REASONS
    fault: Fault
    state: State  # before the device was closed
    statistics: PeriodStatistics
    #: Of the ticks with tissue touched: outside the identified range, and at the clamp.
    outside_share: float
    clipped_share: float

    @property
    def message(self) -> str:
        """One sentence for the console and the log."""
        if self.fault is not Fault.NONE:
            return f"the servo took the force away: {FAULT_WORDS[self.fault]}"
        return {"signal": "the servo was told to end by a signal"}.get(self.reason, "the servo ended")

    def as_dict(self) -> dict[str, Any]:
        """For a line of JSON and the log."""
        words = asdict(self)
        return {**words, "fault": int(self.fault), "state": int(self.state)}

    @classmethod
    def from_dict(cls, words: dict[str, Any]) -> ServoEnd:
        """The inverse of :meth:`as_dict`."""
        return cls(
            **{
                **words,
                "fault": Fault(words["fault"]),
                "state": State(words["state"]),
                "statistics": PeriodStatistics(**words["statistics"]),
            }
        )


def send_plan(descriptor: int, plan: ServoPlan, ring: int, block: int, *hand: int) -> None:
    """Send a plan and the descriptors of the shared memories through the owner's socket."""
    data = pickle.dumps(plan)
    with _socket(descriptor) as there:
        socket.send_fds(there, [len(data).to_bytes(_LENGTH_BYTES, "little")], [ring, block, *hand])
        there.sendall(data)


def receive_plan(descriptor: int) -> tuple[ServoPlan, list[int]]:
    """The plan that :func:`send_plan` sent, and this process's own descriptors: ring, block, perhaps a hand.

    Raises EOFError: the owner died meanwhile.
    """
    data = b""
    with _socket(descriptor) as there:
        head, shared, _, _ = socket.recv_fds(there, _LENGTH_BYTES, 3)
        if len(head) < _LENGTH_BYTES:
            raise EOFError
        size = int.from_bytes(head, "little")
        while len(data) < size:
            got = there.recv(size - len(data))
            if not got:
                raise EOFError
            data += got
    # the sender is the process that spawned this one, over a socket nobody else has
    plan: ServoPlan = pickle.loads(data)  # noqa: S301
    return plan, shared


@contextmanager
def _socket(descriptor: int) -> Iterator[socket.socket]:
    """The socket behind a descriptor, which stays open."""
    there = socket.socket(fileno=descriptor)
    try:
        yield there
    finally:
        there.detach()


def send_line(descriptor: int, **words: Any) -> None:
    """One line of JSON; nothing happens where nobody reads any more."""
    try:
        os.write(descriptor, json.dumps(words).encode() + b"\n")
    except BrokenPipeError:
        return
