"""A device of the Force Dimension driver in the compiled loop, by the addresses of its functions.

Counts are given in steps of its usual resolution, so that the watchdogs for jumps and frozen encoders work.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import tick_kernel
from tissueid.haptics.device import HOMED, PRESSED, REPLY, STEP_M, Access, CompiledIO, register
from tissueid.haptics.forcedimension.device import DONE, ORIGIN_M, ROTATION, SATURATED, wire_buttons
from tissueid.haptics.foreign import by_address
from tissueid.haptics.guard import REPLY_LOST, REPLY_VALID

_get_position = by_address(types.int32, types.int64, types.int64, types.int64, types.int8)
_set_force = by_address(types.int32, types.float64, types.float64, types.float64, types.int8)
_get_buttons = by_address(types.uint32, types.int8)


class ForceDimensionIO(NamedTuple):
    """Addresses of the driver's functions, its number of the device, and room for its numbers."""

    get_position: int
    set_force: int
    get_buttons: int
    identity: int
    driver: FloatArray
    flags: IntArray


def _made(given: CompiledIO) -> ForceDimensionIO:
    """The tuple of a device."""
    return ForceDimensionIO._make((*given.handles.tolist(), np.zeros(3), np.zeros(1, np.int64)))


@tick_kernel
def _sense(io: ForceDimensionIO, dt: float, position: FloatArray, counts: IntArray, words: IntArray) -> None:
    """Ask the driver for the position and the buttons."""
    at = io.driver.ctypes.data
    result = _get_position(io.get_position, (at, at + 8, at + 16, io.identity))
    words[HOMED] = 1
    if result < 0 or io.flags[0] != 0:
        words[REPLY] = REPLY_LOST
        return
    words[REPLY] = REPLY_VALID
    words[PRESSED] = wire_buttons(int(_get_buttons(io.get_buttons, (io.identity,))))
    for i in range(3):
        position[i] = ORIGIN_M[i]
        for j in range(3):
            position[i] += ROTATION[i, j] * io.driver[j]
        counts[i] = math.floor(position[i] / STEP_M)


@tick_kernel
def _command(io: ForceDimensionIO, guard_memory: FloatArray, limits: FloatArray, force: FloatArray) -> None:
    """Give the driver a force in its own frame."""
    for j in range(3):
        io.driver[j] = 0.0
        for i in range(3):
            io.driver[j] += ROTATION[i, j] * force[i]
    result = _set_force(io.set_force, (io.driver[0], io.driver[1], io.driver[2], io.identity))
    if result < DONE or result > SATURATED:
        io.flags[0] = 1


#: A device of the Force Dimension driver.
SDK = register(Access(ForceDimensionIO, _made, _sense, _command))
