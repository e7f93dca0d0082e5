"""The servo process: nothing but the loop, spawned, with zero force on every way out.

SIGKILL and SIGSTOP can't be caught: then the device keeps the last force until the owner, its own firmware or
its power plug takes it away.
"""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict
from types import FrameType
from typing import Any, Self

import numba
import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import without_scipy
from tissueid.errors import DeviceError, TissueidError
from tissueid.haptics.device import WAYS_OUT, HapticDevice, compiled_io
from tissueid.haptics.guard import SHUT, new_guard, transition
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.parameter_block import ParameterBlock
from tissueid.haptics.registry import device_class, environment_law
from tissueid.haptics.ring import Ring
from tissueid.haptics.shared_hand import SharedHand
from tissueid.haptics.sim import SimulatedDevice
from tissueid.haptics.states import FAULT_WORDS, Fault
from tissueid.rendering.first_start import is_compiled, note_compiled
from tissueid.rendering.servo import REASONS, ServoEnd, ServoPlan, period_statistics, receive_plan, send_line
from tissueid.rendering.servo_loop import BINS, compiled_loop, new_watch, realtime_loop
from tissueid.rendering.servo_schedule import make_punctual, settled
from tissueid.rendering.servo_tick import MISSED, PythonIO, new_servo

COMPILING = "compiling the servo's loop, 10 to 20 s, once for this kind of device"
#: Longest time of one call of a law in Python [s]: until then the motors keep the last force.
LONGEST_S = 0.05


class _Overdue(BaseException):
    """The law has not returned; no ``except Exception`` of a law catches it."""


class BoundedLaw:
    """A law in Python whose exceptions, wrong shapes and late returns are no number: a fault to the guard."""

    def __init__(self, name: str, law: Callable[[FloatArray, FloatArray, float], Any]) -> None:
        self.name, self.law = name, law
        self.said = ""  # what went wrong: it is not called again
        self._running = False

    def __enter__(self) -> Self:
        self._before = signal.signal(signal.SIGALRM, self._overdue)
        return self

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGALRM, self._before)

    def _overdue(self, _number: int, _frame: FrameType | None) -> None:
        if self._running:
            raise _Overdue

    def __call__(self, position: FloatArray, velocity: FloatArray, dt: float) -> FloatArray:
        """Force of the law [N], (3,); not a number once it failed."""
        if self.said:
            return np.full(3, np.nan)
        try:
            self._running = True
            signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
            force = np.asarray(self.law(position, velocity, dt), dtype=np.float64).reshape(3)
            self._running = False
        except BaseException as error:  # noqa: BLE001 - of somebody else's law nothing may pass
            self._running = False
            late = f"did not return within {1e3 * LONGEST_S:.0f} ms"
            what = late if isinstance(error, _Overdue) else f"raised {type(error).__name__}: {error}"[:200]
            self.said = f"{self.name} {what}"
            force = np.full(3, np.nan)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        return force


class Signalled(BaseException):
    """A signal came while no loop ran; like KeyboardInterrupt, nothing but a way out catches it."""


class SignalWatch:
    """Makes signals readable for the compiled loop, and an exception everywhere else."""

    def __init__(self) -> None:
        self.descriptor, self._writing = os.pipe()
        os.set_blocking(self._writing, False)
        #: In the loop a signal ends it; elsewhere it raises.
        self.in_loop = False

    def __enter__(self) -> Self:
        self._before = [signal.signal(number, self._came) for number in WAYS_OUT]
        # the C handler writes here at once, even while compiled code holds the only thread
        self._wakeup = signal.set_wakeup_fd(self._writing, warn_on_full_buffer=False)
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._wakeup)
        for number, handler in zip(WAYS_OUT, self._before, strict=True):
            signal.signal(number, handler)
        os.close(self.descriptor)
        os.close(self._writing)

    def _came(self, _number: int, _frame: FrameType | None) -> None:
        if not self.in_loop:
            raise Signalled


def _must_be_owned(owner: int) -> None:
    """Refuse to wait once the owner is dead: nothing but the end of file ever comes after the plan."""
    if select.select([owner], [], [], 0.0)[0]:
        raise DeviceError(FAULT_WORDS[Fault.PARENT_DIED])


def _share_hand(device: HapticDevice, hand: SharedHand) -> None:
    """Let a pointer lead a simulated hand; DeviceError for another device, which a real hand moves."""
    if not isinstance(device, SimulatedDevice):
        raise DeviceError(f"{device.name}: a pointer leads the simulated device alone")
    device.share(hand)


def run_plan(
    plan: ServoPlan,
    ring: Ring,
    block: ParameterBlock,
    owner: int,
    report: int,
    hand: SharedHand | None = None,
) -> ServoEnd:
    """Open the device, run the loop, close the device; DeviceError or UsageError where it can't be used."""
    law = None if plan.law is None else BoundedLaw(plan.law, environment_law(plan.law))
    with SignalWatch() as signals, law or nullcontext():
        device = device_class(plan.device)(**plan.options)
        if hand is not None:
            _share_hand(device, hand)
        device.tell = lambda sentence: send_line(report, event="told", sentence=sentence)
        device.while_waiting = lambda: _must_be_owned(owner)
        try:
            device.open()
            given = device.compiled() if law is None else None
            io = PythonIO(device, law) if given is None else compiled_io(given)
            compiled = given is not None and not getattr(numba.config, "DISABLE_JIT", False)
            loop = compiled_loop if compiled else realtime_loop
            servo = new_servo(device, ring, block)
            histogram = np.zeros(BINS + 1, np.int64)
            watch = new_watch(owner, signals.descriptor, alive_wanted=plan.alive_wanted)
            # each kind of device has a loop of its own
            kind = type(io).__name__
            if compiled and not is_compiled(kind):
                device.tell(COMPILING)
            # whatever takes time comes before homing: a homed device is not left without commands
            loop(io, servo, watch, histogram, plan.period_ns, 0)
            if compiled:
                note_compiled(kind)
            locked = settled(collect=not compiled)
            device.home()
            schedule = make_punctual(locked=locked)
            send_line(
                report, event="ready", compiled=compiled, scheduling=schedule.name, remedies=schedule.remedies
            )
            signals.in_loop = True
            reason = loop(io, servo, watch, histogram, plan.period_ns, plan.ticks)
            missed = int(servo.counters[MISSED])
            statistics = period_statistics(histogram, missed, plan.period_ns, schedule.name)
            said = "" if law is None else law.said
            return ServoEnd(REASONS[reason], device.fault, device.state, statistics, said)
        finally:
            signals.in_loop = True
            device.close()


def main(arguments: list[str]) -> int:
    """The spawned process, with the owner's socket and the report's pipe; its exit code."""
    owner, report = (int(word) for word in arguments)
    # numba sets itself up at the first call: while the owner decides, not when it waits
    with without_scipy():
        transition(new_guard(), GuardLimits().block(), SHUT)
    try:
        plan, shared = receive_plan(owner)
        ring, block = shared[:2]
        hand = SharedHand.attach(shared[2]) if len(shared) > 2 else None
        end = run_plan(plan, Ring.attach(ring), ParameterBlock.attach(block), owner, report, hand)
    except TissueidError as error:
        send_line(report, event="failed", kind=type(error).__name__, message=error.message)
        return error.exit_status
    except (EOFError, Signalled):
        return DeviceError.exit_status
    send_line(report, event="ended", **asdict(end))
    return 0 if end.fault == 0 else DeviceError.exit_status
