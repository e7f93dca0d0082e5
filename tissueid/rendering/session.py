"""One session from its plan to its summary: servo, records, switches, and zero force at the end."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from tissueid.haptics.parameter_block import COMMAND_ENGAGE
from tissueid.haptics.registry import device_class
from tissueid.haptics.ring import RingReader
from tissueid.haptics.states import FAULT_WORDS, Fault
from tissueid.rendering.bridge import BridgeRequest, UdpBridge
from tissueid.rendering.environment import KIND as BLOCK_KIND
from tissueid.rendering.environment import SURFACE, TISSUE
from tissueid.rendering.first_start import first_start
from tissueid.rendering.precheck import PERIOD_S
from tissueid.rendering.recorder import Recorder, SessionSummary
from tissueid.rendering.servo import ServoPlan, ServoProcess
from tissueid.rendering.servo_loop import ENDED_TICKS, new_watch, virtual_loop
from tissueid.rendering.servo_spawn import SpawnedServo
from tissueid.rendering.servo_tick import servo_here
from tissueid.rendering.session_plan import SessionPlan
from tissueid.rendering.surface import SURFACE_SIZE, TOOL_RADIUS

#: Pause between two turns of the owner's loop [s]: a twentieth of the heartbeat's limit.
TURN_S = 0.02
#: A device that is homed by hand takes its time [s].
HOMING_TIMEOUT_S = 300.0
#: Ticks computed at a time in virtual time.
VIRTUAL_TICKS = 500


@dataclass(frozen=True, slots=True)
class Wish:
    """Wish of the person at the keyboard."""

    switch: bool = False  # the next tissue
    stop: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """End of a session."""

    summary: dict[str, Any]  # of ``schemas/session.schema.json``
    log: Path | None
    fault: Fault
    message: str  # one sentence on the end
    remedies: tuple[str, ...]  # what would make the servo more punctual
    interrupted: bool  # by Ctrl-C or a signal


class Session:
    """Runs a plan; ``spawned``: a process that waits for it, closed by its owner whether it was taken or not.

    ``ask`` and ``show`` are called every turn and must not wait; ``watch`` is given the servo before its
    first tick.
    """

    def __init__(
        self,
        plan: SessionPlan,
        *,
        recorder: Recorder | None = None,
        bridge: UdpBridge | None = None,
        ask: Callable[[], Wish] = Wish,
        show: Callable[[Any, SessionSummary], None] = lambda _record, _summary: None,
        tell: Callable[[str], None] = lambda _sentence: None,
        spawned: SpawnedServo | None = None,
        watch: Callable[[ServoProcess], None] = lambda _servo: None,
    ) -> None:
        self.plan = plan
        self.recorder = recorder
        self.bridge = bridge
        self.summary = SessionSummary(PERIOD_S)
        self._ask = ask
        self._show = show
        self._tell = tell
        self._spawned = spawned
        self._watch = watch
        self._blocks = [block.copy() for block in plan.blocks]
        self._current = 0
        self._wanted = 0
        self._changed = False
        self._stop = False
        self._engage = True
        self._switches_s = list(() if plan.script is None else plan.script.switches_s)

    def run(self) -> Outcome:
        """Run to the end; DeviceError, UsageError or BundleError where the device could not be used."""
        try:
            with _signals():
                if self.plan.virtual:
                    return self._virtual()
                with first_start(self.plan.device, self._tell) as uncompiled:
                    return self._live(uncompiled=uncompiled)
        except BaseException:
            # what was recorded before the device was lost, or we failed, is kept whole
            if self.recorder is not None:
                self.recorder.finish(
                    self.summary.as_json(scheduling="unknown", virtual_time=self.plan.virtual)
                )
            raise

    def _live(self, *, uncompiled: bool) -> Outcome:
        plan = self.plan
        # beside a compiler and a browser an owner waits longer than its signs of life may, and no motor moves
        servo_plan = ServoPlan(
            plan.device, dict(plan.device_options), law=plan.environment,
            alive_wanted=not uncompiled, shared_hand=plan.led,
        )  # fmt: skip
        patience = {"start_timeout_s": HOMING_TIMEOUT_S} if plan.capabilities.hardware else {}
        if uncompiled and self._spawned is not None:
            # whether a process compiles is settled when it starts: this one would
            self._spawned.close()
            self._spawned = None
        servo = ServoProcess(servo_plan, tell=self._tell, spawned=self._spawned, **patience)
        servo.block.write(self._blocks[0])
        self._watch(servo)
        interrupted = False
        with servo:
            # asked for before the loop's first ticks are over; the guard waits until it may
            servo.engage()
            try:
                while servo.poll() is None and not self._over():
                    self._turn(servo)
                    time.sleep(TURN_S)
            except KeyboardInterrupt:
                interrupted = True
            end = servo.poll() or servo.stop()
            self._take(servo.records)
        ready = servo.ready
        return self._finish(
            scheduling=end.statistics.scheduling + (", not compiled yet" if uncompiled else ""),
            fault=end.fault,
            message=end.message,
            remedies=() if ready is None else ready.remedies,
            interrupted=interrupted or end.reason == "signal",
        )

    def _turn(self, servo: ServoProcess) -> None:
        """Everything the owner does in one turn."""
        servo.beat()
        self._take(servo.records)
        wish = self._ask()
        self._stop = self._stop or wish.stop
        if wish.switch:
            self._next()
        for request in () if self.bridge is None else self.bridge.requests():
            self._obey(request)
        if self._engage:
            servo.engage()
        else:
            servo.disengage()
        self._exchange(servo.block)

    def _exchange(self, block: Any) -> None:
        """Publish the wanted tissue, once the last one was taken over."""
        if (self._wanted != self._current or self._changed) and block.published == block.taken:
            block.write(self._blocks[self._wanted])
            self._current, self._changed = self._wanted, False

    def _take(self, reader: RingReader) -> None:
        """Hand on what is new."""
        records, lost = reader.read_new()
        self.summary.add(records, lost)
        if self.recorder is not None:
            self.recorder.append(records)
        if self.bridge is not None:
            self.bridge.send(records)
        while self._switches_s and self.summary.seconds >= self._switches_s[0]:
            self._switches_s.pop(0)
            self._next()
        if records.size:
            self._show(records[-1], self.summary)

    def _next(self) -> None:
        """Want the next tissue; after the last presentation of a blind session, the end."""
        if self._wanted + 1 < len(self._blocks):
            self._wanted += 1
        elif self.plan.order is not None:
            self._stop = True
        else:
            self._wanted = 0

    def _obey(self, request: BridgeRequest) -> None:
        self._stop = self._stop or request.stop
        if request.engage is not None:
            self._engage = request.engage
        if request.tissue is not None and request.tissue < len(self._blocks):
            self._wanted = request.tissue
        if request.plane is None:
            return
        # every tissue lies behind the other plane
        for block in self._blocks:
            if block[BLOCK_KIND] == TISSUE:
                radius_m = float(block[SURFACE + TOOL_RADIUS])
                block[SURFACE : SURFACE + SURFACE_SIZE] = request.plane.numbers(radius_m)
        self._changed = True

    def _over(self) -> bool:
        seconds = self.plan.seconds
        return self._stop or (seconds is not None and self.summary.seconds >= seconds)

    def _virtual(self) -> Outcome:
        """The same loop without a clock: ticks are computed as fast as they go."""
        device = device_class(self.plan.device)(**self.plan.device_options)
        interrupted, now, steps = False, 0.0, np.full(self._until_switch(), PERIOD_S)
        with servo_here(device) as (io, servo, ring, block):
            watch, reader = new_watch(), ring.reader(from_start=True)
            block.write(self._blocks[0])
            block.order(COMMAND_ENGAGE)
            try:
                while virtual_loop(io, servo, watch, now, steps) == ENDED_TICKS and not self._over():
                    now += steps.size * PERIOD_S
                    self._take(reader)
                    self._exchange(block)
                    steps = np.full(self._until_switch(), PERIOD_S)
            except KeyboardInterrupt:
                interrupted = True
            self._take(reader)
            fault = device.fault
        return self._finish(
            scheduling="virtual time",
            fault=fault,
            message=f"the servo took the force away: {FAULT_WORDS[fault]}" if fault else "the session ended",
            remedies=(),
            interrupted=interrupted,
        )

    def _until_switch(self) -> int:
        """Ticks to compute at a time: a script's switch comes between two of them."""
        if not self._switches_s:
            return VIRTUAL_TICKS
        left = math.ceil((self._switches_s[0] - self.summary.seconds) / PERIOD_S)
        return min(max(left, 1), VIRTUAL_TICKS)

    def _finish(
        self, *, scheduling: str, fault: Fault, message: str, remedies: tuple[str, ...], interrupted: bool
    ) -> Outcome:
        summary = self.summary.as_json(scheduling=scheduling, virtual_time=self.plan.virtual)
        log = None
        if self.recorder is not None:
            log = self.recorder.finish(summary)
            summary["recording_stopped"] = self.recorder.stopped
        return Outcome(summary, log, fault, message, remedies, interrupted)


@contextmanager
def _signals() -> Iterator[None]:
    """SIGTERM, SIGHUP and Ctrl-Z end a session as Ctrl-C does: with a ramp, a summary and a whole log."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    numbers = (signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, interrupt) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
