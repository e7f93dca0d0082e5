"""The servo's loops and their clock: absolute deadlines in real time, and virtual time; both call one tick.

Missed deadlines are skipped, never replayed in a burst; a dead or silent owner, its wish to end and a signal
are looked for every 5 ms, and end in zero force: after a signal, over the ramp of an owner's wish to end.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import tick_kernel, tick_part
from tissueid.haptics.device import ZERO_COMMANDS
from tissueid.haptics.foreign import POLL_IN, libc_function, ready
from tissueid.haptics.guard import ENGAGED, FAULTED, HEARTBEAT_LOST, PARENT_DIED, STATE, transition
from tissueid.haptics.limits import HEARTBEAT_S
from tissueid.haptics.parameter_block import COMMAND_STOP, beats
from tissueid.haptics.parameter_block import command as ordered
from tissueid.haptics.states import Lamp
from tissueid.rendering.servo_tick import MISSED, TOLD_TO_END, Servo, compiled_tick, tick

#: int64 words of room: a ``timespec``, then one ``pollfd``.
CLOCK_SIZE = 3
_POLLFD_AT = 2

CLOCK_MONOTONIC, TIMER_ABSTIME = 1, 1
INTERRUPTED = 4
NANOSECONDS = 1_000_000_000

_gettime = libc_function("clock_gettime", types.int32, types.int32, types.int64)
_nanosleep = libc_function("clock_nanosleep", types.int32, types.int32, types.int32, types.int64, types.int64)


@tick_kernel
def monotonic_ns(room: IntArray) -> int:
    """CLOCK_MONOTONIC [ns], which no clock jump moves; ``room`` is int64, shape (CLOCK_SIZE,)."""
    _gettime(CLOCK_MONOTONIC, room.ctypes.data)
    return int(room[0] * NANOSECONDS + room[1])


@tick_kernel
def sleep_until(deadline_ns: int, room: IntArray) -> None:
    """Sleep to a moment of CLOCK_MONOTONIC; no spinning, which a real-time class is punished for."""
    room[0] = deadline_ns // NANOSECONDS
    room[1] = deadline_ns % NANOSECONDS
    while _nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, room.ctypes.data, 0) == INTERRUPTED:
        pass


@tick_kernel
def readable(descriptor: int, room: IntArray) -> bool:
    """True where a descriptor has bytes, or its other end is gone; False for a negative one."""
    return bool(descriptor >= 0 and ready(descriptor, POLL_IN, room[_POLLFD_AT:]) != 0)


#: Why a loop ended: a fault; the owner's wish; a signal; all ticks asked for are done.
ENDED_FAULT, ENDED_STOPPED, ENDED_SIGNAL, ENDED_TICKS = 0, 1, 2, 3

#: Words of a watch: the owner's pipe and the pipe of signals (-1: none), whether signs of life are asked for,
#: signs of life so far, when the last one came [ns], ticks of zero force at the end, room for system calls.
OWNER, SIGNALS, ALIVE_WANTED, BEATS, BEAT_NS, ZEROS, ROOM = range(7)
WATCH_SIZE = ROOM + CLOCK_SIZE

#: Period errors are counted in bins of 1 us; the last bin has all beyond 20 ms.
BINS = 20_001
BIN_NS = 1_000
#: How often the world outside is looked at [ns]: its system calls are no part of a tick.
LOOK_NS = 5_000_000
#: A tick whose period is off by more than this share is late.
LATE_SHARE = 10

_LATE = int(Lamp.LATE)


def new_watch(owner: int = -1, signals: int = -1, *, alive_wanted: bool = False) -> IntArray:
    """Watch of a loop on the owner's pipe, a descriptor of signals and signs of life; -1 is none."""
    watch = np.zeros(WATCH_SIZE, np.int64)
    watch[OWNER], watch[SIGNALS], watch[ALIVE_WANTED] = owner, signals, alive_wanted
    return watch


@tick_kernel
def _look(servo: Servo, watch: IntArray, now_ns: int, room: IntArray) -> None:
    """Look outside."""
    if readable(watch[OWNER], room):
        transition(servo.guard_memory, servo.limits, PARENT_DIED)
    count = beats(servo.block_head)
    if count != watch[BEATS] or watch[BEAT_NS] == 0:
        watch[BEATS] = count
        watch[BEAT_NS] = now_ns
    elif watch[ALIVE_WANTED] != 0 and (now_ns - watch[BEAT_NS]) * 1e-9 > servo.limits[HEARTBEAT_S]:
        transition(servo.guard_memory, servo.limits, HEARTBEAT_LOST)
    if readable(watch[SIGNALS], room):
        servo.counters[TOLD_TO_END] = 1


@tick_part
def _over(servo: Servo, watch: IntArray) -> bool:
    """True where enough ticks of zero force followed a fault, a signal, or the owner's wish to end."""
    state = servo.guard_memory[STATE]
    told = servo.counters[TOLD_TO_END] != 0 or ordered(servo.block_head) == COMMAND_STOP
    ending = state == FAULTED or (state != ENGAGED and told)
    force = servo.out[0] != 0.0 or servo.out[1] != 0.0 or servo.out[2] != 0.0
    watch[ZEROS] = watch[ZEROS] + 1 if ending and not force else 0
    return bool(watch[ZEROS] >= ZERO_COMMANDS)


@tick_part
def _reason(servo: Servo) -> int:
    """Reason why a loop is over."""
    if servo.guard_memory[STATE] == FAULTED:
        return ENDED_FAULT
    return ENDED_SIGNAL if servo.counters[TOLD_TO_END] != 0 else ENDED_STOPPED


@tick_part
def _count(histogram: IntArray, error_ns: int) -> None:
    """Count one absolute period error."""
    histogram[min(error_ns // BIN_NS, histogram.size - 2)] += 1
    # the largest error itself, in the last word
    histogram[histogram.size - 1] = max(histogram[histogram.size - 1], error_ns)


def realtime_loop(
    io: Any, servo: Servo, watch: IntArray, histogram: IntArray, period_ns: int, ticks: int
) -> int:
    """Run in real time until something ends it; ENDED_FAULT, ENDED_STOPPED, ENDED_SIGNAL or ENDED_TICKS.

    ``histogram`` (BINS + 1,): absolute period errors by microsecond, then the largest [ns]; added to.
    """
    room = watch[ROOM:]
    last = monotonic_ns(room)
    looked = last
    deadline = last + period_ns
    for _ in range(ticks):
        sleep_until(deadline, room)
        now = monotonic_ns(room)
        elapsed = now - last
        last = now
        error = abs(elapsed - period_ns)
        _count(histogram, error)
        lamp = _LATE if error * LATE_SHARE > period_ns else 0
        tick(io, servo, now * 1e-9, elapsed * 1e-9, (now - deadline) * 1e-9, lamp)
        if _over(servo, watch):
            return _reason(servo)
        deadline += period_ns
        now = monotonic_ns(room)
        if now - looked >= LOOK_NS:
            looked = now
            _look(servo, watch, now, room)
        if now > deadline:
            missed = (now - deadline) // period_ns
            servo.counters[MISSED] += missed
            deadline += missed * period_ns
    return ENDED_TICKS


#: :func:`realtime_loop`, compiled for the type of its ``io``.
compiled_loop = tick_kernel(realtime_loop)


@tick_kernel
def virtual_loop(io: Any, servo: Servo, watch: IntArray, start_s: float, steps: FloatArray) -> int:
    """Run a simulated device through steps of time [s] as fast as it goes; nothing outside is looked at."""
    now = start_s
    for k in range(steps.size):
        now += steps[k]
        compiled_tick(io, servo, now, steps[k], 0.0, 0)
        if _over(servo, watch):
            return _reason(servo)
    return ENDED_TICKS
