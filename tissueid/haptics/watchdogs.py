"""Watchdogs: a tick's view of the device, and what follows from it."""

from __future__ import annotations

import math

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import tick_part
from tissueid.haptics.guard_states import (
    ARMED,
    DAMAGED,
    DELAYED_TICKS,
    ENGAGED,
    FAULTED,
    HOMED_REPLIES,
    HOMING,
    LATE_S,
    LET_GO,
    PENETRATION,
    PHASE,
    PREVIOUS,
    READY,
    RELEASING,
    RISE_RATE,
    RISING,
    SILENT_S,
    STATE,
    STILL_CHANGE_N,
    STILL_FORCE,
    STILL_S,
    VELOCITY,
    WANTED,
    fail,
    let_down,
    pause,
    yield_to,
)
from tissueid.haptics.limits import (
    BAD_PACKETS,
    DEAD_MAN,
    DEAD_MAN_BUTTONS,
    DEFAULT_DELAY_TICKS,
    DELAY_TICKS,
    FROZEN_CHANGE_N,
    FROZEN_S,
    HOMED_NEEDED,
    JUMP_COUNTS,
    JUMP_S,
    NO_REPLY_S,
    OVERSPEED,
    PAUSE_S,
    RAMP_S,
    STALL_S,
)
from tissueid.haptics.states import Fault

#: What came from the device since the last tick: a whole reply; nothing; only damaged bytes; an error; one
#: whose encoders contradict each other.
REPLY_VALID, REPLY_NONE, REPLY_DAMAGED, REPLY_LOST, REPLY_APART = 1, 0, -1, -2, -3

#: Silence that is borne while a hand homes the device and no force is sent [s].
HOMING_SILENCE_S = 0.5

#: What is faster is no velocity but a broken number [m/s].
FASTEST_M_PER_S = 1e3
#: Commands without an answer from which a wire is late, for how long before that counts [s], and how fast it
#: is forgotten [ticks/s].
LATE_COMMANDS, LATE_FOR_S, FORGOTTEN_PER_S = 3, 0.02, 4.0
#: A longer stall allows a hand no more counts [s].
LONGEST_STALL_S = 1.0

_NO_REPLY, _BAD_PACKETS = float(Fault.NO_REPLY), float(Fault.BAD_PACKETS)
_TRANSPORT, _FROZEN, _APART = float(Fault.TRANSPORT), float(Fault.ENCODER_FROZEN), float(Fault.LEGS_APART)
_JUMP, _OVERSPEED, _NOT_HOMED = float(Fault.ENCODER_JUMP), float(Fault.OVERSPEED), float(Fault.NOT_HOMED)


@tick_part
def observe(
    memory: FloatArray,
    limits: FloatArray,
    reply: int,
    homed: bool,
    buttons: int,
    counts_moved: IntArray,
    velocity: FloatArray,
    penetration: float,
    dt: float,
) -> None:
    """Take in what a tick saw, before :func:`tissueid.haptics.guard.guard`.

    ``memory``, ``limits``: of the guard; ``memory`` is updated in place; ``reply``: REPLY_VALID, REPLY_NONE,
    REPLY_DAMAGED, REPLY_LOST or REPLY_APART; only with the first do the next four say anything; ``homed``:
    whether all legs say that they are homed; ``buttons``: bits of the buttons held; ``counts_moved`` (3,):
    encoder counts since the last valid reply; ``velocity`` (3,): of the grip [m/s]; ``penetration``: depth of
    the tool in what is rendered [m]; NaN where nobody knows; ``dt``: time since the last tick [s].
    """
    memory[READY] = 0.0
    state = memory[STATE]
    if state < HOMING or state == FAULTED:
        return
    # our own stall is not the device's silence: a tick counts for no more than the longest good one
    step = dt if 0.0 < dt <= limits[STALL_S] else limits[STALL_S]
    gap = memory[SILENT_S] + dt
    _count_replies(memory, limits, reply, step)
    if memory[STATE] == FAULTED or reply != REPLY_VALID:
        return
    memory[PENETRATION] = penetration
    for i in range(3):
        memory[VELOCITY + i] = velocity[i] if abs(velocity[i]) <= FASTEST_M_PER_S else 0.0
    if state == HOMING:
        memory[HOMED_REPLIES] = memory[HOMED_REPLIES] + 1.0 if homed else 0.0
        if memory[HOMED_REPLIES] >= limits[HOMED_NEEDED]:
            memory[STATE] = ARMED
        return
    _check_motion(memory, limits, homed, counts_moved, velocity, gap)
    if memory[STATE] == ENGAGED:
        _check_frozen(memory, limits, counts_moved, step)
    _dead_man(memory, limits, buttons)


@tick_part
def observe_wire(memory: FloatArray, limits: FloatArray, unanswered: int, dt: float) -> None:
    """Take in how late the answers of a device come; the guard lowers the force by it.

    ``memory``, ``limits``: of the guard; ``memory`` is updated in place; ``unanswered``: commands that were
    sent before this tick and are not answered yet; ``dt``: time since the last tick [s].
    """
    more = unanswered - max(limits[DELAY_TICKS] - DEFAULT_DELAY_TICKS, 0.0)
    # in a silence nothing is late yet: it may be lost
    late = more >= LATE_COMMANDS and memory[SILENT_S] == 0.0
    memory[LATE_S] = memory[LATE_S] + dt if late else 0.0
    memory[DELAYED_TICKS] = max(0.0, memory[DELAYED_TICKS] - FORGOTTEN_PER_S * dt)
    if memory[LATE_S] >= LATE_FOR_S:
        memory[DELAYED_TICKS] = max(memory[DELAYED_TICKS], more)


@tick_part
def _count_replies(memory: FloatArray, limits: FloatArray, reply: int, step: float) -> None:
    """Silence, damage and loss of the transport."""
    if reply == REPLY_LOST:
        fail(memory, _TRANSPORT)
        return
    if reply == REPLY_VALID:
        memory[SILENT_S] = 0.0
        memory[DAMAGED] = 0.0
        return
    memory[SILENT_S] += step
    if reply in (REPLY_DAMAGED, REPLY_APART):
        memory[DAMAGED] += 1.0
    patience = limits[NO_REPLY_S] if memory[STATE] != HOMING else max(limits[NO_REPLY_S], HOMING_SILENCE_S)
    if memory[SILENT_S] >= limits[PAUSE_S]:
        pause(memory, limits)
        # nobody knows it any more, and damping by an old one would be a force of its own
        for i in range(3):
            memory[VELOCITY + i] = 0.0
    if memory[DAMAGED] >= limits[BAD_PACKETS]:
        fail(memory, _APART if reply == REPLY_APART else _BAD_PACKETS)
    elif memory[SILENT_S] >= patience:
        fail(memory, _NO_REPLY)


@tick_part
def _check_motion(
    memory: FloatArray,
    limits: FloatArray,
    homed: bool,
    counts_moved: IntArray,
    velocity: FloatArray,
    gap: float,
) -> None:
    """Homing lost, a jump since the last reply ``gap`` seconds ago, a speed no hand has."""
    if not homed:
        fail(memory, _NOT_HOMED)
        return
    # after a long gap a hand may have gone further: the limit is a speed, and never less than one tick's
    allowed = limits[JUMP_COUNTS]
    if gap > limits[JUMP_S]:
        allowed *= min(gap, LONGEST_STALL_S) / limits[JUMP_S]
    for i in range(3):
        if abs(counts_moved[i]) > allowed:
            fail(memory, _JUMP)
            return
    speed2 = 0.0
    absurd = False
    for i in range(3):
        absurd = absurd or not abs(velocity[i]) <= FASTEST_M_PER_S
        speed2 += memory[VELOCITY + i] * memory[VELOCITY + i]
    if memory[STATE] == ENGAGED and (absurd or speed2 > limits[OVERSPEED] * limits[OVERSPEED]):
        fail(memory, _OVERSPEED)


@tick_part
def _check_frozen(memory: FloatArray, limits: FloatArray, counts_moved: IntArray, step: float) -> None:
    """Encoders that stand still although the force changed."""
    if counts_moved[0] != 0 or counts_moved[1] != 0 or counts_moved[2] != 0:
        memory[STILL_S] = 0.0
        memory[STILL_CHANGE_N] = 0.0
        for i in range(3):
            memory[STILL_FORCE + i] = memory[PREVIOUS + i]
        return
    change2 = 0.0
    force2 = 0.0
    for i in range(3):
        change = memory[PREVIOUS + i] - memory[STILL_FORCE + i]
        change2 += change * change
        force2 += memory[PREVIOUS + i] * memory[PREVIOUS + i]
    memory[STILL_CHANGE_N] = max(memory[STILL_CHANGE_N], math.sqrt(change2))
    # counted from the change on: an arm at rest needs some ticks to answer a new force with a count, and
    # one that was stopped (at the end of its reach) and gets no force rests by right
    least = limits[FROZEN_CHANGE_N]
    if memory[STILL_CHANGE_N] > least and force2 > least * least:
        memory[STILL_S] += step
    if memory[STILL_S] >= limits[FROZEN_S]:
        yield_to(memory, _FROZEN)


@tick_part
def _dead_man(memory: FloatArray, limits: FloatArray, buttons: int) -> None:
    """Release, and readiness to engage."""
    held = limits[DEAD_MAN] == 0.0 or (buttons & int(limits[DEAD_MAN_BUTTONS])) != 0
    memory[LET_GO] = 0.0 if held else 1.0
    if memory[STATE] == ENGAGED:
        if not held:
            let_down(memory)
        elif memory[PHASE] == RELEASING and memory[WANTED] == 1.0:
            memory[PHASE] = RISING
            memory[RISE_RATE] = 1.0 / limits[RAMP_S]
    elif memory[STATE] == ARMED and held:
        memory[READY] = memory[WANTED]
