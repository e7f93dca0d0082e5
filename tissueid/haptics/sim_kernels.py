"""The simulated device, compiled: an arm behind encoders that round and a wire that delays.

A tick of a loop is ``simulated_sample`` (what the encoders say now), the force law and the guard, then
``simulated_command`` (the force is under way) and ``simulated_advance`` (time goes on until the next
sample).  A force is felt ``delay_s`` after it was commanded and until the next one arrives, so that a delay
of 1.5 ticks changes the force in the middle of a tick; the arm is integrated piece by piece.
Nothing here reads a clock: in virtual time ``dt`` is the period, in real time what was measured.

The memory begins with the arm's (:mod:`tissueid.haptics.arm`), the parameters with the arm's parameters.
SI units.
"""

from __future__ import annotations

import math

import numpy as np

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import tick_kernel, tick_part
from tissueid.haptics.arm import ARM_MEMORY, POSITION, TIME, arm_step
from tissueid.haptics.simulated_layout import DELAY, FAULT_AT, FAULT_KIND, FAULT_SIZE, PHASE, QUANTUM

#: Kinds of scripted faults: none; the device is gone; it is silent; its encoders stand still; encoder 1 jumps
#: by FAULT_SIZE counts; it is no longer homed.
FAULT_NONE, FAULT_GONE, FAULT_SILENT, FAULT_FROZEN, FAULT_JUMP, FAULT_UNHOMED = 0, 1, 2, 3, 4, 5

# --- memory behind the arm's
FELT = ARM_MEMORY  # force at the grip now: 3
HELD = ARM_MEMORY + 3  # counts last read: 3
HEAD, PENDING, LOST = ARM_MEMORY + 6, ARM_MEMORY + 7, ARM_MEMORY + 8
#: Forces under way: time of arrival and three components each.
QUEUE = ARM_MEMORY + 10
QUEUE_COLUMNS = 4
#: A delay of more ticks than this loses forces; :class:`~tissueid.haptics.sim.SimulatedDevice` refuses it.
QUEUE_LENGTH = 32
SIM_MEMORY = QUEUE + QUEUE_COLUMNS * QUEUE_LENGTH

#: Bits of what :func:`simulated_sample` returns; 0 is "no answer", negative "the device is gone".
VALID, HOMED = 1, 2


def new_simulated(arm_memory: FloatArray) -> FloatArray:
    """Memory of a simulated device whose arm is in the state given, no force under way."""
    memory = np.zeros(SIM_MEMORY)
    memory[:ARM_MEMORY] = arm_memory
    return memory


@tick_part
def simulated_sample(
    memory: FloatArray, parameters: FloatArray, position: FloatArray, counts: IntArray
) -> int:
    """Sample of the device at this moment.

    ``memory``, ``parameters``: of the device; ``memory`` keeps the last counts; ``position`` (3,):
    **Written**: counts times the quantum [m]; ``counts`` (3,): **Written**: encoder counts.  Returns bits
    VALID and HOMED; 0 without an answer, -1 where the device is gone.
    """
    kind = int(parameters[FAULT_KIND])
    if kind != FAULT_NONE and memory[TIME] < parameters[FAULT_AT]:
        kind = FAULT_NONE
    if kind == FAULT_GONE:
        return -1
    if kind == FAULT_SILENT:
        return 0
    quantum = parameters[QUANTUM]
    for i in range(3):
        if kind != FAULT_FROZEN:
            memory[HELD + i] = math.floor(memory[POSITION + i] / quantum + parameters[PHASE + i])
        said = memory[HELD + i]
        if kind == FAULT_JUMP and i == 0:
            said += parameters[FAULT_SIZE]
        counts[i] = int(said)
        # the middle of the count, so that rounding has no mean
        position[i] = (said + 0.5 - parameters[PHASE + i]) * quantum
    return VALID if kind == FAULT_UNHOMED else VALID | HOMED


@tick_part
def simulated_command(memory: FloatArray, parameters: FloatArray, force: FloatArray) -> None:
    """Send a force [N]; it is felt ``delay_s`` later."""
    pending = int(memory[PENDING])
    if pending >= QUEUE_LENGTH:
        memory[LOST] += 1.0
        return
    at = QUEUE + QUEUE_COLUMNS * ((int(memory[HEAD]) + pending) % QUEUE_LENGTH)
    memory[at] = memory[TIME] + parameters[DELAY]
    for i in range(3):
        memory[at + 1 + i] = force[i]
    memory[PENDING] = pending + 1


@tick_kernel
def simulated_advance(memory: FloatArray, parameters: FloatArray, dt: float) -> None:
    """Let ``dt`` seconds pass: forces arrive, the arm moves."""
    end = memory[TIME] + dt
    felt = memory[FELT : FELT + 3]
    while memory[PENDING] > 0.0:
        head = int(memory[HEAD])
        at = QUEUE + QUEUE_COLUMNS * head
        arrival = memory[at]
        if arrival > end:
            break
        arm_step(memory, parameters, felt, arrival - memory[TIME])
        for i in range(3):
            felt[i] = memory[at + 1 + i]
        memory[HEAD] = (head + 1) % QUEUE_LENGTH
        memory[PENDING] -= 1.0
    arm_step(memory, parameters, felt, end - memory[TIME])
