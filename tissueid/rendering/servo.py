"""The owner's side of the servo process: spawn, parameters, heartbeat, end.

::

    with ServoProcess(ServoPlan("sim")) as servo:
        servo.block.write(parameters)
        servo.engage()
        while (end := servo.poll()) is None:
            servo.beat()
            records, overrun = servo.records.read_new()
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import time
from collections.abc import Callable
from typing import Any, Self

from tissueid import errors
from tissueid.errors import DeviceError
from tissueid.haptics.parameter_block import (
    COMMAND_DISENGAGE,
    COMMAND_ENGAGE,
    COMMAND_STOP,
    ParameterBlock,
)
from tissueid.haptics.ring import Ring
from tissueid.haptics.shared_hand import SharedHand
from tissueid.rendering.servo_plan import ServoEnd, ServoPlan, ServoReady, send_plan
from tissueid.rendering.servo_spawn import REAP_S, SpawnedServo, spawn_servo
from tissueid.rendering.servo_tick import BLOCK_SIZE

#: Longest time to the first tick without homing [s]: compiling on a slow machine takes half of it.
START_TIMEOUT_S = 60.0


class ServoProcess:
    """A servo in its own process.

    ``start_timeout_s``: until the loop runs; a device that a user must home needs more; ``tell``: told what
    the device says to its user while it is opened and homed; ``spawned``: a process that waits for a plan;
    without it one is spawned by ``start``.
    """

    def __init__(
        self,
        plan: ServoPlan,
        *,
        start_timeout_s: float = START_TIMEOUT_S,
        tell: Callable[[str], None] | None = None,
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
        """Send the plan and wait until the loop runs, with zero force.

        Raises DeviceError, UsageError, BundleError: what the process refused, or DeviceError where it died or
        took too long.
        """
        try:
            self.ready = self._started()
        except BaseException:
            self.close()
            raise
        return self.ready

    def _started(self) -> ServoReady:
        """Send the plan, wait for the first line."""
        if self._spawned is None:
            self._spawned = spawn_servo()
        self._spawned.planned = True
        shared = [one.descriptor for one in (self.ring, self.block, self.hand) if one is not None]
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            send_plan(self._spawned.owner, self.plan, *shared)
        words = self._start_line()
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

    def poll(self) -> ServoEnd | None:
        """End of the servo, or None while it runs.

        Raises DeviceError: the process died without a word.
        """
        if self.end is None:
            words = self._next_line(0.0)
            if words is not None:
                self._ended(words)
            elif self._spawned is not None and self._spawned.process.poll() is not None:
                # the last line may have come between the two looks
                self._ended(self._next_line(0.0))
        return self.end

    def stop(self) -> ServoEnd:
        """Ramp down, end the loop, close the device.

        Raises DeviceError: it did not end in time (and was killed), or died without a word.
        """
        self.block.order(COMMAND_STOP)
        deadline = time.monotonic() + REAP_S
        while self.poll() is None and time.monotonic() < deadline:
            self.beat()
            self._ended(self._next_line(0.05), patient=True)
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
        self.ring.close()
        self.block.close()
        if self.hand is not None:
            self.hand.close()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None and self.end is None:
                self.stop()
        finally:
            self.close()

    def _start_line(self) -> dict[str, Any] | None:
        """The line that says how starting ended; what the device tells its user meanwhile is handed on."""
        deadline = time.monotonic() + self._start_timeout_s
        while True:
            words = self._next_line(deadline - time.monotonic())
            if words is None or words["event"] != "told":
                return words
            if self._tell is not None:
                self._tell(words["sentence"])

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

    def _ended(self, words: dict[str, Any] | None, *, patient: bool = False) -> None:
        """Take in the last line of the report."""
        if words is None:
            if not patient:
                raise self._failure(None, "died without a word")
        elif words.pop("event") == "ended":
            self.end = ServoEnd.from_dict(words)
        else:
            raise self._failure({"event": "failed", **words}, "")

    def _failure(self, words: dict[str, Any] | None, otherwise: str) -> errors.TissueidError:
        """Refusal of the process, or its end."""
        if words is not None and words["event"] == "failed":
            refused: errors.TissueidError = getattr(errors, words["kind"])(words["message"])
            return refused
        code = None if self._spawned is None else self._spawned.reap()
        return DeviceError(f"the servo process {otherwise} (exit code {code}); device {self.plan.device}")
