"""The owner's side of the servo process: spawn, parameters, heartbeat, end, and the messages between both.

Down goes one plan, pickled, with the descriptors of the shared memories, over a private socket whose end of
file is the owner's death.  Up come lines of JSON: ``ready``, then ``ended`` or ``failed``.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import select
import socket
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, Self

import msgspec
import numpy as np

from tissueid import errors
from tissueid.arrays import IntArray
from tissueid.errors import DeviceError
from tissueid.haptics.parameter_block import COMMAND_DISENGAGE, COMMAND_ENGAGE, COMMAND_STOP, ParameterBlock
from tissueid.haptics.ring import Ring
from tissueid.haptics.shared_hand import SharedHand
from tissueid.haptics.states import FAULT_WORDS, Fault, State
from tissueid.rendering.servo_loop import BIN_NS, LATE_SHARE
from tissueid.rendering.servo_spawn import REAP_S, SpawnedServo, spawn_servo
from tissueid.rendering.servo_tick import BLOCK_SIZE

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
    """Figures from a loop's histogram, shape (BINS + 1,), and the deadlines it skipped."""
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
    said: str = ""  # what went wrong in a force law of another distribution

    @property
    def message(self) -> str:
        """One sentence for the console and the log."""
        if self.fault is not Fault.NONE:
            return f"the servo took the force away: {self.said or FAULT_WORDS[self.fault]}"
        return {"signal": "the servo was told to end by a signal"}.get(self.reason, "the servo ended")


def send_plan(descriptor: int, plan: ServoPlan, ring: int, block: int, *hand: int) -> None:
    """Send a plan and the descriptors of the shared memories through the owner's socket."""
    data = pickle.dumps(plan)
    with socket.socket(fileno=os.dup(descriptor)) as there:
        socket.send_fds(there, [len(data).to_bytes(_LENGTH_BYTES, "little")], [ring, block, *hand])
        there.sendall(data)


def receive_plan(descriptor: int) -> tuple[ServoPlan, list[int]]:
    """The plan and this process's own descriptors (ring, block, hand); EOFError where the owner died."""
    data = b""
    with socket.socket(fileno=os.dup(descriptor)) as there:
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


def send_line(descriptor: int, **words: Any) -> None:
    """One line of JSON; nothing happens where nobody reads any more."""
    with contextlib.suppress(BrokenPipeError):
        os.write(descriptor, json.dumps(words).encode() + b"\n")


#: Longest time to the first tick without homing [s]: compiling on a slow and busy machine takes half of it.
START_TIMEOUT_S = 180.0


class ServoProcess:
    """A servo in its own process; ``spawned``: one that waits for a plan."""

    def __init__(
        self,
        plan: ServoPlan,
        *,
        start_timeout_s: float = START_TIMEOUT_S,
        tell: Callable[[str], None] = lambda _sentence: None,
        spawned: SpawnedServo | None = None,
    ) -> None:
        self.plan = plan
        self._tell = tell
        self.ring = Ring.create()
        self.block = ParameterBlock.create(BLOCK_SIZE)
        #: Through which a pointer leads the simulated device; None where none may.
        self.hand = SharedHand.create() if plan.shared_hand else None
        #: What is new in the ring.
        self.records = self.ring.reader()
        #: What the servo said of itself; known after ``start``.
        self.ready: ServoReady | None = None
        self.end: ServoEnd | None = None
        self._start_timeout_s = start_timeout_s
        self._spawned = spawned
        self._closed = False
        self._text = b""

    def start(self) -> ServoReady:
        """Send the plan and wait until the loop runs, with zero force; raises what the process refused."""
        try:
            self.ready = self._started()
        except BaseException:
            self.close()
            raise
        return self.ready

    def _started(self) -> ServoReady:
        if self._spawned is None:
            self._spawned = spawn_servo()
        self._spawned.planned = True
        shared = [one.descriptor for one in (self.ring, self.block, self.hand) if one is not None]
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            send_plan(self._spawned.owner, self.plan, *shared)
        deadline = time.monotonic() + self._start_timeout_s
        # what the device tells its user meanwhile is handed on
        while (words := self._next_line(deadline - time.monotonic())) and words["event"] == "told":
            self._tell(words["sentence"])
        if words is None or words["event"] != "ready":
            raise self._failure(words, f"did not start within {self._start_timeout_s:.0f} s")
        return ServoReady(words["compiled"], words["scheduling"], tuple(words["remedies"]))

    def beat(self) -> None:
        """Sign of life; at least twice a heartbeat limit."""
        self.block.beat()

    def engage(self) -> None:
        """Ask for force."""
        self.block.order(COMMAND_ENGAGE)

    def disengage(self) -> None:
        """Take the force away; the loop goes on."""
        self.block.order(COMMAND_DISENGAGE)

    def poll(self, timeout_s: float = 0.0) -> ServoEnd | None:
        """End of the servo, or None while it runs; DeviceError where it died without a word."""
        if self.end is None:
            words = self._next_line(timeout_s)
            if words is not None:
                self._ended(words)
            elif self._spawned is not None and self._spawned.process.poll() is not None:
                # the last line may have come between the two looks
                self._ended(self._next_line(0.0))
        return self.end

    def stop(self) -> ServoEnd:
        """Ramp down, end the loop, close the device; DeviceError where it did not end in time."""
        self.block.order(COMMAND_STOP)
        deadline = time.monotonic() + REAP_S
        while self.poll(0.05) is None and time.monotonic() < deadline:
            self.beat()
        if self.end is None:
            raise self._failure(None, f"did not end within {REAP_S:.0f} s")
        return self.end

    def close(self) -> None:
        """End the process if it runs, and give shared memory back; harmless when called twice."""
        if self._closed:
            return
        self._closed = True
        if self._spawned is not None:
            self._spawned.close()
            if self._spawned.planned and self._spawned.process.returncode < 0:
                self._take_force_away()
        self.ring.close()
        self.block.close()
        if self.hand is not None:
            self.hand.close()

    def _take_force_away(self) -> None:
        """Send zero force from here: a servo that was killed leaves its last command to the motors."""
        from tissueid.haptics.registry import device_class

        # nothing but this way is left, and what was to be raised is the servo's death
        with contextlib.suppress(errors.TissueidError, OSError):
            device = device_class(self.plan.device)(**self.plan.options)
            if device.capabilities.hardware:
                device.open()
                device.close()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None and self.end is None:
                self.stop()
        finally:
            self.close()

    def _next_line(self, timeout_s: float) -> dict[str, Any] | None:
        """The next line of the report, or None without one in time or at its end."""
        assert self._spawned is not None  # noqa: S101 -- only a started servo reports
        deadline = time.monotonic() + timeout_s
        while b"\n" not in self._text:
            left = max(deadline - time.monotonic(), 0.0)
            if not select.select([self._spawned.report], [], [], left)[0]:
                return None
            got = os.read(self._spawned.report, 65_536)
            if not got:
                return None
            self._text += got
        line, self._text = self._text.split(b"\n", 1)
        words: dict[str, Any] = json.loads(line)
        return words

    def _ended(self, words: dict[str, Any] | None) -> None:
        if words is None or words["event"] != "ended":
            raise self._failure(words, "died without a word")
        self.end = msgspec.convert(words, ServoEnd)

    def _failure(self, words: dict[str, Any] | None, otherwise: str) -> errors.TissueidError:
        """Refusal of the process, or its end."""
        if words is not None and words["event"] == "failed":
            refused: errors.TissueidError = getattr(errors, words["kind"])(words["message"])
            return refused
        code = None if self._spawned is None else self._spawned.reap()
        return DeviceError(f"the servo process {otherwise} (exit code {code}); device {self.plan.device}")
