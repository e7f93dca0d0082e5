"""The guard: the one compiled function through which every force passes on its way to a device.

Precedence, strongest first: a fault takes the force to zero within ``fault_ramp_s``; the clamp, direction
kept; the slew, of a rise alone, since a symmetric limit would make a passive law active (what counts is the
force along its new direction: one that turns round starts from zero); the sustained limit, which folds the
clamp back.  Outside ENGAGED and FAULT the force is zero.  In ENGAGED it is crossfaded with damping at
engaging, after a stall or a silence, and after the dead-man button: ``F = g F_wanted - (1 - g) b v``.
A force that is not finite is FAULT.  The memory is one float64 block; the indices below are its fields.
"""

from __future__ import annotations

import math

import numpy as np

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import tick_kernel, tick_part
from tissueid.haptics import limits as bar
from tissueid.haptics.states import Fault, Lamp, State

#: Time constant [s]: one 45 um count in a 1 ms tick, 45 mm/s unfiltered, is then 8 mm/s.
VELOCITY_FILTER_S = 0.005
#: Slower is rest [m/s]: a velocity that only fades would reach denormal numbers, which slow a tick.
REST_M_PER_S = 1e-12


@tick_part
def velocity_step(velocity: FloatArray, position: FloatArray, last: FloatArray, dt: float) -> None:
    """Low-passed difference quotient (3,) [m/s], exact for any step; ``last`` becomes ``position``."""
    share = -math.expm1(-dt / VELOCITY_FILTER_S) if dt > 0.0 else 0.0
    for i in range(3):
        if share > 0.0:
            velocity[i] += share * ((position[i] - last[i]) / dt - velocity[i])
            if abs(velocity[i]) < REST_M_PER_S:
                velocity[i] = 0.0
        last[i] = position[i]


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
CLOSED, OPEN, FIRMWARE, HOMING, ARMED, ENGAGED, FAULTED = (float(state) for state in State)
_HEARTBEAT, _PARENT_DIED, _TRANSPORT = (
    float(Fault.HEARTBEAT), float(Fault.PARENT_DIED), float(Fault.TRANSPORT),
)  # fmt: skip

#: Phases of GAIN: up to 1; down, then ARMED; down, then up again; down, then damping, then FAULT.
RISING, RELEASING, RECOVERING, YIELDING = 0.0, 1.0, 2.0, 3.0

#: Events of :func:`transition`.
OPENED, FIRMWARE_OK, HOME, ENGAGE, DISENGAGE = 0.0, 1.0, 2.0, 3.0, 4.0
RELEASE, SWAP, HEARTBEAT_LOST, PARENT_DIED, TRANSPORT_LOST, SHUT = 5.0, 6.0, 7.0, 8.0, 9.0, 10.0


def new_guard() -> FloatArray:
    """Memory of a device that is closed, shape (GUARD_SIZE,)."""
    return np.zeros(GUARD_SIZE)


@tick_part
def fail(memory: FloatArray, fault: float) -> None:
    """Go to FAULT, once: the first is the one reported; its ramp starts from the force that was sent last."""
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
            memory[RISE_RATE] = 1.0 / limits[bar.RECOVERY_S]


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
    memory[RISE_RATE] = 1.0 / limits[bar.RAMP_S]
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
    """Tell the guard what happened outside a tick; True where the event was accepted in this state.

    ENGAGE: force comes once the tool is free or the force small, and the dead-man button is held; SWAP asks
    whether parameters may be exchanged now, and changes nothing; SHUT leads from any state to CLOSED.
    """
    state = memory[STATE]
    if event == OPENED:
        return _opened(memory)
    if event == FIRMWARE_OK:
        return _advance(memory, OPEN, FIRMWARE)
    if event == HOME:
        memory[HOMED_REPLIES] = 0.0
        return _advance(memory, FIRMWARE, HOMING)
    if event == ENGAGE:
        memory[WANTED] = 1.0 if state not in (FAULTED, CLOSED) else 0.0
        return bool(memory[WANTED] == 1.0)
    if event == DISENGAGE:
        memory[WANTED] = 0.0
        return let_down(memory)
    if event == RELEASE:
        return bool(limits[bar.DEAD_MAN] != 0.0 and let_down(memory))
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
_FROZEN, _APART = float(Fault.ENCODER_FROZEN), float(Fault.LEGS_APART)
_JUMP, _OVERSPEED, _NOT_HOMED = float(Fault.ENCODER_JUMP), float(Fault.OVERSPEED), float(Fault.NOT_HOMED)


@tick_part
def _bounded(limits: FloatArray, dt: float) -> float:
    """A step of time as far as a stall, which a step that is no time counts as."""
    return float(dt if 0.0 < dt <= limits[bar.STALL_S] else limits[bar.STALL_S])


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
    """Take in what a tick saw, before :func:`guard`.

    Only with REPLY_VALID do ``homed`` (all legs), ``buttons``, ``counts_moved`` (3,) since the last valid
    reply and ``velocity`` (3,) [m/s] say anything; ``penetration``: depth of the tool [m], NaN where nobody
    knows.
    """
    memory[READY] = 0.0
    state = memory[STATE]
    if state < HOMING or state == FAULTED:
        return
    # our own stall is not the device's silence: a tick counts for no more than the longest good one
    step = _bounded(limits, dt)
    gap = memory[SILENT_S] + dt
    _count_replies(memory, limits, reply, step)
    if memory[STATE] == FAULTED or reply != REPLY_VALID:
        return
    memory[PENETRATION] = penetration
    for i in range(3):
        memory[VELOCITY + i] = velocity[i] if abs(velocity[i]) <= FASTEST_M_PER_S else 0.0
    if state == HOMING:
        memory[HOMED_REPLIES] = memory[HOMED_REPLIES] + 1.0 if homed else 0.0
        if memory[HOMED_REPLIES] >= limits[bar.HOMED_NEEDED]:
            memory[STATE] = ARMED
        return
    _check_motion(memory, limits, homed, counts_moved, velocity, gap)
    if memory[STATE] == ENGAGED:
        _check_frozen(memory, limits, counts_moved, step)
    _dead_man(memory, limits, buttons)


@tick_part
def observe_wire(memory: FloatArray, limits: FloatArray, unanswered: int, dt: float) -> None:
    """Take in how late answers come, by the commands not answered before this tick: it lowers the force."""
    more = unanswered - max(limits[bar.DELAY_TICKS] - bar.DEFAULT_DELAY_TICKS, 0.0)
    # in a silence nothing is late yet: it may be lost
    late = more >= LATE_COMMANDS and memory[SILENT_S] == 0.0
    step = _bounded(limits, dt)
    memory[LATE_S] = memory[LATE_S] + step if late else 0.0
    memory[DELAYED_TICKS] = max(0.0, memory[DELAYED_TICKS] - FORGOTTEN_PER_S * step)
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
    patience = (
        limits[bar.NO_REPLY_S] if memory[STATE] != HOMING else max(limits[bar.NO_REPLY_S], HOMING_SILENCE_S)
    )
    if memory[SILENT_S] >= limits[bar.PAUSE_S]:
        pause(memory, limits)
        # nobody knows it any more, and damping by an old one would be a force of its own
        for i in range(3):
            memory[VELOCITY + i] = 0.0
    if memory[DAMAGED] >= limits[bar.BAD_PACKETS]:
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
    allowed = limits[bar.JUMP_COUNTS]
    if gap > limits[bar.JUMP_S]:
        allowed *= min(gap, LONGEST_STALL_S) / limits[bar.JUMP_S]
    for i in range(3):
        if abs(counts_moved[i]) > allowed:
            fail(memory, _JUMP)
            return
    speed2 = 0.0
    absurd = False
    for i in range(3):
        absurd = absurd or not abs(velocity[i]) <= FASTEST_M_PER_S
        speed2 += memory[VELOCITY + i] * memory[VELOCITY + i]
    if memory[STATE] == ENGAGED and (absurd or speed2 > limits[bar.OVERSPEED] * limits[bar.OVERSPEED]):
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
    least = limits[bar.FROZEN_CHANGE_N]
    if memory[STILL_CHANGE_N] > least and force2 > least * least:
        memory[STILL_S] += step
    if memory[STILL_S] >= limits[bar.FROZEN_S]:
        yield_to(memory, _FROZEN)


@tick_part
def _dead_man(memory: FloatArray, limits: FloatArray, buttons: int) -> None:
    """Release, and readiness to engage."""
    held = limits[bar.DEAD_MAN] == 0.0 or (buttons & int(limits[bar.DEAD_MAN_BUTTONS])) != 0
    memory[LET_GO] = 0.0 if held else 1.0
    if memory[STATE] == ENGAGED:
        if not held:
            let_down(memory)
        elif memory[PHASE] == RELEASING and memory[WANTED] == 1.0:
            memory[PHASE] = RISING
            memory[RISE_RATE] = 1.0 / limits[bar.RAMP_S]
    elif memory[STATE] == ARMED and held:
        memory[READY] = memory[WANTED]


#: The clamp begins to fold back at this share of the mean square that the motors bear.
FOLD_FROM = 0.8
#: Over this multiple of it the motors are in danger whatever the fold did.
OVERHEATED = 1.25
#: Squares of larger forces overflow [N].
LARGEST_N = 1e150

_CLIPPED, _SLEWED, _RMS = int(Lamp.CLIPPED), int(Lamp.SLEWED), int(Lamp.RMS_LIMITED)
_STALLED, _RAMPING, _LET_GO = int(Lamp.STALLED), int(Lamp.RAMPING), int(Lamp.DEAD_MAN)
_SILENT, _LATENCY = int(Lamp.SILENT), int(Lamp.LATENCY)
_NOT_A_NUMBER, _OVERHEATED = float(Fault.NOT_A_NUMBER), float(Fault.OVERHEATED)


@tick_part
def guard(memory: FloatArray, limits: FloatArray, force: FloatArray, dt: float, out: FloatArray) -> None:
    """Write the force (3,) that may be sent: finite, within every limit.

    ``force`` (3,): wanted [N]; may hold anything; ``dt``: measured time since the last tick [s]; anything
    that is not a good tick counts as a stall.
    """
    stalled = not 0.0 < dt <= limits[bar.STALL_S]
    step = _bounded(limits, dt)
    lamps = _STALLED if stalled else 0
    if memory[LET_GO] != 0.0:
        lamps |= _LET_GO
    if memory[SILENT_S] >= limits[bar.PAUSE_S]:
        lamps |= _SILENT
    if memory[DELAYED_TICKS] > 0.0:
        lamps |= _LATENCY
    finite = math.isfinite(force[0]) and math.isfinite(force[1]) and math.isfinite(force[2])
    out[0] = out[1] = out[2] = 0.0
    # an unknown depth (NaN) is not a free tool
    free = memory[PENETRATION] <= 0.0 or (finite and _length(force) < limits[bar.ENGAGE_BELOW_N])
    if memory[STATE] == ARMED and memory[READY] != 0.0 and free:
        engage_now(memory, limits)
    if memory[STATE] == ENGAGED:
        if finite:
            _advance_gain(memory, limits, step, stalled)
        else:
            fail(memory, _NOT_A_NUMBER)
    if memory[STATE] == ENGAGED:
        lamps |= _engaged(memory, limits, force, out)
    if memory[STATE] == FAULTED:
        # time itself counts here, not the clamped step: a fault never waits for our own stall
        age = step
        if dt > step:
            age = min(dt, LONGEST_STALL_S)
        lamps |= _fade(memory, limits, age, out)
    _remember(memory, limits, step, out)
    memory[LAMPS] = lamps


@tick_part
def _length(vector: FloatArray) -> float:
    """Euclidean length; infinite where the squares would overflow."""
    if max(abs(vector[0]), abs(vector[1]), abs(vector[2])) > LARGEST_N:
        return math.inf
    return math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])


@tick_part
def _advance_gain(memory: FloatArray, limits: FloatArray, step: float, stalled: bool) -> None:
    """Move the share of the wanted force that is let through, and what follows when it is gone."""
    if stalled:
        pause(memory, limits)
    if memory[PHASE] == RISING:
        # the stiffness that a delay bears is in inverse proportion to it
        most = limits[bar.DELAY_TICKS] / (limits[bar.DELAY_TICKS] + memory[DELAYED_TICKS])
        risen = min(most, memory[GAIN] + step * memory[RISE_RATE])
        memory[GAIN] = max(risen, memory[GAIN] - step / limits[bar.RECOVERY_S])
        return
    silent = memory[SILENT_S] >= limits[bar.PAUSE_S]
    time = limits[bar.FAULT_RAMP_S]
    if silent:
        time = limits[bar.PAUSE_RAMP_S]
    elif memory[PHASE] == RELEASING:
        time = limits[bar.DEAD_MAN_S]
    memory[GAIN] -= step / time
    if memory[GAIN] > 0.0:
        return
    memory[GAIN] = 0.0
    if memory[PHASE] == RELEASING:
        memory[STATE] = ARMED
    elif memory[PHASE] == RECOVERING:
        # in a silence the watchdogs put it back
        memory[PHASE] = RISING
    elif memory[PHASE] == YIELDING:
        memory[DAMPED_S] += step
        if memory[DAMPED_S] >= limits[bar.DAMPING_S]:
            fail(memory, memory[PENDING_FAULT])


@tick_part
def _engaged(memory: FloatArray, limits: FloatArray, force: FloatArray, out: FloatArray) -> int:
    """Crossfade with damping, then clamp, slew and sustained limit; the lamps of what bit."""
    gain = memory[GAIN]
    damping = (1.0 - gain) * limits[bar.DAMPING]
    for i in range(3):
        out[i] = gain * force[i] - damping * memory[VELOCITY + i]
    lamps = _RAMPING if gain < 1.0 else 0
    length = _length(out)
    if length == math.inf:
        # only the direction is left of it, longer than the clamp
        largest = max(abs(out[0]), abs(out[1]), abs(out[2]))
        for i in range(3):
            out[i] = out[i] / largest * (2.0 * limits[bar.CLAMP_N])
        length = _length(out)
    bound = length
    if bound > limits[bar.CLAMP_N]:
        bound = limits[bar.CLAMP_N]
        lamps |= _CLIPPED
    if length > 0.0:
        along = (
            memory[PREVIOUS] * out[0] + memory[PREVIOUS + 1] * out[1] + memory[PREVIOUS + 2] * out[2]
        ) / length
        risen = max(along, 0.0) + limits[bar.SLEW_N]
        if bound > risen:
            bound = risen
            lamps |= _SLEWED
    sustained = _sustained(memory, limits)
    if bound > sustained:
        bound = sustained
        lamps |= _RMS
    if bound < length:
        scale = bound / length
        for i in range(3):
            out[i] = out[i] * scale
    return lamps


@tick_part
def _sustained(memory: FloatArray, limits: FloatArray) -> float:
    """Clamp [N] that the motors' past allows: the clamp itself, folded back to the limit of their mean."""
    share = memory[MEAN_SQUARE] / (limits[bar.RMS_LIMIT_N] * limits[bar.RMS_LIMIT_N])
    fold = min(max((share - FOLD_FROM) / (1.0 - FOLD_FROM), 0.0), 1.0)
    lowest = min(limits[bar.RMS_LIMIT_N], limits[bar.CLAMP_N])
    return float(limits[bar.CLAMP_N] - fold * (limits[bar.CLAMP_N] - lowest))


@tick_part
def _fade(memory: FloatArray, limits: FloatArray, dt: float, out: FloatArray) -> int:
    """Ramp of a fault: from what was sent last to zero."""
    memory[FAULT_AGE_S] += dt
    silent = memory[SILENT_S] >= limits[bar.PAUSE_S]
    left = 1.0 - memory[FAULT_AGE_S] / limits[bar.PAUSE_RAMP_S if silent else bar.FAULT_RAMP_S]
    # rounding must not leave a femtonewton at the end of the ramp
    if left < 1e-9:
        return 0
    for i in range(3):
        out[i] = left * memory[FAULT_FORCE + i]
    return _RAMPING


@tick_part
def _remember(memory: FloatArray, limits: FloatArray, step: float, out: FloatArray) -> None:
    """Keep the force that was sent, and its mean square."""
    square = 0.0
    for i in range(3):
        memory[PREVIOUS + i] = out[i]
        square += out[i] * out[i]
    share = step / limits[bar.RMS_WINDOW_S]
    memory[MEAN_SQUARE] += (square - memory[MEAN_SQUARE]) * min(share, 1.0)
    if memory[MEAN_SQUARE] > OVERHEATED * limits[bar.RMS_LIMIT_N] * limits[bar.RMS_LIMIT_N]:
        fail(memory, _OVERHEATED)
