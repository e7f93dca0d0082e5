"""State machine of the guard: its memory, the events that move it, and how it fails.

The memory is one float64 block, so that a compiled loop, a device and a test share it; the indices below
are its fields.  :mod:`tissueid.haptics.guard` has the force, :mod:`tissueid.haptics.watchdogs` what a tick
saw.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel, tick_part
from tissueid.haptics.limits import DEAD_MAN, RAMP_S, RECOVERY_S
from tissueid.haptics.states import Fault, State

#: Fields of the memory: state, fault and lamps as the numbers of :mod:`tissueid.haptics.states`.
STATE, FAULT, LAMPS = 0, 1, 2
#: Force that was sent last [N]: 3 values.
PREVIOUS = 3
#: Force the fault ramp starts from [N]: 3 values, and the time since the fault [s].
FAULT_FORCE, FAULT_AGE_S = 6, 9
#: Velocity of the grip [m/s]: 3 values.
VELOCITY = 10
#: Share of the wanted force that is let through, what it does, and how fast it rises [1/s].
GAIN, PHASE, RISE_RATE = 13, 14, 15
#: Fault that follows damping alone, and how long it has been damped [s].
PENDING_FAULT, DAMPED_S = 16, 17
#: Whether force is wanted at all; whether nothing but the tool's place keeps it back; depth of the tool [m].
WANTED, READY, PENETRATION = 18, 19, 20
#: Counters: homed replies in a row, damaged replies in a row, silence [s], counts standing still [s].
HOMED_REPLIES, DAMAGED, SILENT_S, STILL_S = 21, 22, 23, 24
#: Force when a count was last seen [N]: 3 values, and the largest change since then [N].
STILL_FORCE, STILL_CHANGE_N = 25, 28
#: Mean square of the force [N^2]; 1 where the dead-man button is let go.
MEAN_SQUARE, LET_GO = 29, 30
#: How long answers have been late [s], and by how many ticks more than stability was worked out for.
LATE_S, DELAYED_TICKS = 31, 32
GUARD_SIZE = 33

# numbers that compiled functions are called with are floats: numba would compile a function anew for every
# integer constant it is called with
CLOSED, OPEN, FIRMWARE = float(State.CLOSED), float(State.OPEN), float(State.FIRMWARE)
HOMING, ARMED, ENGAGED, FAULTED = (
    float(State.HOMING),
    float(State.ARMED),
    float(State.ENGAGED),
    float(State.FAULT),
)
_HEARTBEAT, _PARENT_DIED = float(Fault.HEARTBEAT), float(Fault.PARENT_DIED)
_TRANSPORT = float(Fault.TRANSPORT)

#: Phases of GAIN: up to 1; down, then ARMED; down, then up again; down, then damping, then FAULT.
RISING, RELEASING, RECOVERING, YIELDING = 0.0, 1.0, 2.0, 3.0

#: Events of :func:`transition`.
OPENED, FIRMWARE_OK, HOME, HOMED, ENGAGE, DISENGAGE = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0
RELEASE, SWAP, HEARTBEAT_LOST, PARENT_DIED, TRANSPORT_LOST, SHUT = 6.0, 7.0, 8.0, 9.0, 10.0, 11.0


def new_guard() -> FloatArray:
    """Memory of a device that is closed, shape (GUARD_SIZE,)."""
    return np.zeros(GUARD_SIZE)


@tick_part
def fail(memory: FloatArray, fault: float) -> None:
    """Go to FAULT, once: the first fault is the one that is reported.

    The force that was sent last is where the ramp to zero starts.
    """
    if memory[STATE] == FAULTED or memory[STATE] == CLOSED:
        return
    memory[STATE] = FAULTED
    memory[FAULT] = fault
    memory[FAULT_AGE_S] = 0.0
    memory[WANTED] = 0.0
    for i in range(3):
        memory[FAULT_FORCE + i] = memory[PREVIOUS + i]


@tick_part
def pause(memory: FloatArray, limits: FloatArray) -> None:
    """Take the force away until ticks and answers are good again, and give it back from zero."""
    if memory[PHASE] == RISING:
        memory[PHASE] = RECOVERING
        if memory[GAIN] >= 1.0:
            memory[RISE_RATE] = 1.0 / limits[RECOVERY_S]


@tick_kernel
def yield_to(memory: FloatArray, fault: float) -> None:
    """Damping alone, then FAULT: for faults that leave a device answering with a hand in its grip."""
    if memory[STATE] != ENGAGED:
        fail(memory, fault)
    elif memory[PHASE] != YIELDING:
        memory[PHASE] = YIELDING
        memory[PENDING_FAULT] = fault
        memory[DAMPED_S] = 0.0
        memory[WANTED] = 0.0


@tick_kernel
def engage_now(memory: FloatArray, limits: FloatArray) -> None:
    """ARMED to ENGAGED, from zero force."""
    memory[STATE] = ENGAGED
    memory[PHASE] = RISING
    memory[GAIN] = 0.0
    memory[RISE_RATE] = 1.0 / limits[RAMP_S]
    memory[STILL_S] = 0.0
    memory[STILL_CHANGE_N] = 0.0
    for i in range(3):
        memory[PREVIOUS + i] = 0.0
        memory[STILL_FORCE + i] = 0.0


@tick_kernel
def _advance(memory: FloatArray, source: float, target: float) -> bool:
    """One step of the way up, from ``source`` only."""
    if memory[STATE] != source:
        return False
    memory[STATE] = target
    return True


@tick_kernel
def _opened(memory: FloatArray) -> bool:
    """CLOSED to OPEN, with everything forgotten."""
    if memory[STATE] != CLOSED:
        return False
    for i in range(memory.size):
        memory[i] = 0.0
    memory[STATE] = OPEN
    return True


@tick_kernel
def let_down(memory: FloatArray) -> bool:
    """Take the force away over the dead-man ramp; back to ARMED at its end."""
    if memory[STATE] != ENGAGED:
        return False
    if memory[PHASE] != YIELDING:
        memory[PHASE] = RELEASING
    return True


@tick_kernel
def transition(memory: FloatArray, limits: FloatArray, event: float) -> bool:
    """Tell the guard what happened outside a tick.

    ``memory`` (GUARD_SIZE,): updated in place; ``limits`` (LIMITS_SIZE,):
    :meth:`tissueid.haptics.limits.GuardLimits.block`; ``event``: OPENED, FIRMWARE_OK, HOME (homing begins),
    HOMED; ENGAGE (force is wanted: it comes once the tool is free or the force small, and the dead-man button
    is held), DISENGAGE, RELEASE (the button); SWAP (asks whether parameters may be exchanged now, and changes
    nothing); HEARTBEAT_LOST, PARENT_DIED, TRANSPORT_LOST; SHUT (from any state).  Returns whether the event
    was accepted in this state.
    """
    state = memory[STATE]
    if event == OPENED:
        return _opened(memory)
    if event == FIRMWARE_OK:
        return _advance(memory, OPEN, FIRMWARE)
    if event == HOME:
        memory[HOMED_REPLIES] = 0.0
        return _advance(memory, FIRMWARE, HOMING)
    if event == HOMED:
        return _advance(memory, HOMING, ARMED)
    if event == ENGAGE:
        memory[WANTED] = 1.0 if state not in (FAULTED, CLOSED) else 0.0
        return bool(memory[WANTED] == 1.0)
    if event == DISENGAGE:
        memory[WANTED] = 0.0
        return let_down(memory)
    if event == RELEASE:
        return bool(limits[DEAD_MAN] != 0.0 and let_down(memory))
    if event == SWAP:
        return bool(state != ENGAGED or memory[PENETRATION] <= 0.0)
    if event == HEARTBEAT_LOST:
        yield_to(memory, _HEARTBEAT)
    elif event == PARENT_DIED:
        fail(memory, _PARENT_DIED)
    elif event == TRANSPORT_LOST:
        fail(memory, _TRANSPORT)
    elif event == SHUT:
        memory[STATE] = CLOSED
        for i in range(3):
            memory[PREVIOUS + i] = 0.0
    else:
        return False
    return True
