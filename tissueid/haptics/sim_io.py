"""The simulated device in the compiled loop: its arm moves when it is read."""

from __future__ import annotations

from typing import NamedTuple

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import tick_kernel
from tissueid.haptics.device_facts import CompiledIO
from tissueid.haptics.servo_access import HOMED, PRESSED, REPLY, Access, register
from tissueid.haptics.sim_kernels import HOMED as SAID_HOMED
from tissueid.haptics.sim_kernels import simulated_advance, simulated_command, simulated_sample
from tissueid.haptics.simulated_layout import BUTTONS
from tissueid.haptics.watchdogs import REPLY_LOST, REPLY_NONE, REPLY_VALID


class SimulatedIO(NamedTuple):
    """Blocks of :mod:`tissueid.haptics.sim_kernels`."""

    parameters: FloatArray
    memory: FloatArray


@tick_kernel
def _sense(io: SimulatedIO, dt: float, position: FloatArray, counts: IntArray, words: IntArray) -> None:
    """Let the arm move for ``dt`` and read its encoders."""
    simulated_advance(io.memory, io.parameters, dt)
    said = simulated_sample(io.memory, io.parameters, position, counts)
    words[REPLY] = REPLY_LOST if said < 0 else (REPLY_VALID if said > 0 else REPLY_NONE)
    words[HOMED] = 1 if said > 0 and (said & SAID_HOMED) != 0 else 0
    words[PRESSED] = int(io.parameters[BUTTONS])


@tick_kernel
def _command(io: SimulatedIO, guard_memory: FloatArray, limits: FloatArray, force: FloatArray) -> None:
    """Put the force on its way."""
    simulated_command(io.memory, io.parameters, force)


def _made(given: CompiledIO) -> SimulatedIO:
    return SimulatedIO(given.constants, given.memory)


#: The simulated device.
SIMULATED = register(Access(SimulatedIO, _made, _sense, _command))
