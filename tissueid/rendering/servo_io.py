"""Access of the servo to a device: one reading and one command a tick, compiled for the devices it knows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from numba.extending import overload

from tissueid.arrays import FloatArray, IntArray
from tissueid.errors import DeviceError
from tissueid.haptics.device import HOMED, PRESSED, REPLY, HapticDevice, access_of
from tissueid.haptics.guard import REPLY_DAMAGED, REPLY_LOST, REPLY_NONE, REPLY_VALID


class PythonIO(NamedTuple):
    """A device with methods in Python, and a force law in Python where there is one."""

    device: HapticDevice
    law: Callable[..., Any] | None = None


def _sense_python(io: PythonIO, dt: float, position: FloatArray, counts: IntArray, words: IntArray) -> None:
    """One reading of a plug-in."""
    try:
        sample = io.device.sample()
    except DeviceError:
        words[REPLY] = REPLY_LOST
        return
    words[REPLY] = REPLY_VALID if sample.valid else (REPLY_DAMAGED if sample.damaged else REPLY_NONE)
    words[HOMED] = int(sample.homed)
    words[PRESSED] = sample.buttons
    if sample.valid:
        position[:] = sample.position_m
        counts[:] = sample.counts


def sense(io: Any, dt: float, position: FloatArray, counts: IntArray, words: IntArray) -> None:
    """Read a device once, without waiting: ``position`` [m] and ``counts`` of a valid reply, ``words``."""
    way = _sense_python if isinstance(io, PythonIO) else access_of(type(io)).sense
    way(io, dt, position, counts, words)


def command(io: Any, guard_memory: FloatArray, limits: FloatArray, force: FloatArray) -> None:
    """Send a force [N] that passed the guard; called by :func:`tissueid.rendering.servo_tick.send` alone."""
    access_of(type(io)).command(io, guard_memory, limits, force)


@overload(sense)
def _compiled_sense(io, dt, position, counts, words):  # type: ignore[no-untyped-def]
    """The reading of this kind of device, built into the loop."""
    kernel = access_of(io.instance_class).sense
    return lambda io, dt, position, counts, words: kernel(io, dt, position, counts, words)


@overload(command)
def _compiled_command(io, guard_memory, limits, force):  # type: ignore[no-untyped-def]
    """The command of this kind of device, built into the loop."""
    kernel = access_of(io.instance_class).command
    return lambda io, guard_memory, limits, force: kernel(io, guard_memory, limits, force)
