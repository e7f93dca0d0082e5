"""Access of the servo to a device: one reading and one command a tick, compiled for the devices it knows.

:func:`sense` and :func:`command` take one of the tuples below.  Compiled, the tuple's type decides what is
built into the loop, so that a simulated device never loads a driver; a plug-in device with methods in
Python (:class:`PythonIO`) runs through the same two functions uncompiled.

:func:`command` is called by :func:`tissueid.rendering.servo_tick.send` alone, with what the guard let
through.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from tissueid.compiled import tick_kernel
from tissueid.errors import DeviceError
from tissueid.haptics import device as devices
from tissueid.haptics.device import CompiledIO, HapticDevice
from tissueid.haptics.sim_kernels import (
    HOMED as SIM_HOMED,
)
from tissueid.haptics.sim_kernels import (
    simulated_advance,
    simulated_command,
    simulated_sample,
)
from tissueid.haptics.simulated_layout import BUTTONS as SIM_BUTTONS
from tissueid.haptics.watchdogs import REPLY_DAMAGED, REPLY_LOST, REPLY_NONE, REPLY_VALID
from tissueid.rendering.falcon_io import (
    DescriptorIO,
    UsbIO,
    command_descriptor,
    command_usb,
    descriptor_io,
    sense_descriptor,
    sense_usb,
    usb_io,
)
from tissueid.rendering.force_dimension_io import (
    ForceDimensionIO,
    command_force_dimension,
    force_dimension_io,
    sense_force_dimension,
)

__all__ = ["HOMED", "PRESSED", "REPLY", "PythonIO", "SimulatedIO", "command", "compiled_io", "sense"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Words of a reading: what came (:mod:`tissueid.haptics.watchdogs`), whether homed, buttons.
REPLY, HOMED, PRESSED, UNANSWERED = 0, 1, 2, 3
WORDS_SIZE = 4


class SimulatedIO(NamedTuple):
    """Blocks of :mod:`tissueid.haptics.sim_kernels`."""

    parameters: FloatArray
    memory: FloatArray


class PythonIO(NamedTuple):
    """A device with methods in Python, and a force law in Python where there is one."""

    device: HapticDevice
    law: Callable[..., Any] | None = None


@tick_kernel
def sense_simulated(
    io: SimulatedIO, dt: float, position: FloatArray, counts: IntArray, words: IntArray
) -> None:
    """Let the arm move for ``dt`` and read its encoders."""
    simulated_advance(io.memory, io.parameters, dt)
    said = simulated_sample(io.memory, io.parameters, position, counts)
    words[REPLY] = REPLY_LOST if said < 0 else (REPLY_VALID if said > 0 else REPLY_NONE)
    words[HOMED] = 1 if said > 0 and (said & SIM_HOMED) != 0 else 0
    words[PRESSED] = int(io.parameters[SIM_BUTTONS])


@tick_kernel
def command_simulated(
    io: SimulatedIO, guard_memory: FloatArray, limits: FloatArray, force: FloatArray
) -> None:
    """Put the force on its way."""
    simulated_command(io.memory, io.parameters, force)


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


_SENSE: dict[type, Callable[..., None]] = {
    SimulatedIO: sense_simulated,
    DescriptorIO: sense_descriptor,
    UsbIO: sense_usb,
    ForceDimensionIO: sense_force_dimension,
    PythonIO: _sense_python,
}
_COMMAND: dict[type, Callable[..., None]] = {
    SimulatedIO: command_simulated,
    DescriptorIO: command_descriptor,
    UsbIO: command_usb,
    ForceDimensionIO: command_force_dimension,
}


def sense(io: Any, dt: float, position: FloatArray, counts: IntArray, words: IntArray) -> None:
    """Read a device once, without waiting.

    Parameters
    ----------
    io : tuple
        One of this module's and its neighbours'.
    dt : float
        Time since the last reading [s].
    position : ndarray, shape (3,)
        **Written** where a valid reply came [m].
    counts : ndarray of int64, shape (3,)
        **Written** likewise.
    words : ndarray of int64, shape (WORDS_SIZE,)
        **Written**: REPLY, HOMED, PRESSED; UNANSWERED where the device answers each command.
    """
    _SENSE[type(io)](io, dt, position, counts, words)


def command(io: Any, guard_memory: FloatArray, limits: FloatArray, force: FloatArray) -> None:
    """Send a force that passed the guard.

    Parameters
    ----------
    io : tuple
    guard_memory, limits : ndarray
        Of the guard; a device shows its state.
    force : ndarray, shape (3,)
        [N].
    """
    _COMMAND[type(io)](io, guard_memory, limits, force)


@overload(sense)
def _compiled_sense(io, dt, position, counts, words):  # type: ignore[no-untyped-def]
    """The reading of this kind of device, built into the loop."""
    kernel = _SENSE[io.instance_class]
    return lambda io, dt, position, counts, words: kernel(io, dt, position, counts, words)


@overload(command)
def _compiled_command(io, guard_memory, limits, force):  # type: ignore[no-untyped-def]
    """The command of this kind of device, built into the loop."""
    kernel = _COMMAND[io.instance_class]
    return lambda io, guard_memory, limits, force: kernel(io, guard_memory, limits, force)


def compiled_io(given: CompiledIO) -> Any:
    """The tuple for what a device says of itself.

    Raises
    ------
    DeviceError
        Its kind is none the servo knows.
    """
    if given.kind == devices.SIMULATED:
        return SimulatedIO(given.constants, given.memory)
    if given.kind == devices.FALCON_FD:
        return descriptor_io(given)
    if given.kind == devices.FALCON_USB:
        return usb_io(given)
    if given.kind == devices.FORCE_DIMENSION:
        return force_dimension_io(given)
    msg = f"the compiled servo knows no device of kind {given.kind}; return None from compiled()"
    raise DeviceError(msg)
