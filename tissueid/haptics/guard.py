"""The guard: the one compiled function through which every force passes on its way to a device.

Precedence, strongest first:

1. a fault takes the force to zero within ``fault_ramp_s``;
2. the clamp: |F| <= ``clamp_N``, direction kept;
3. the slew: |F| rises by at most ``slew_N_per_tick`` in a tick.  Falling is free: a symmetric limit would
   make a passive law active.  What counts as rising is the force along its new direction, so that a force
   that turns round starts from zero;
4. the sustained (root mean square) limit, which folds the clamp back.

Outside ENGAGED and FAULT the force is zero.  In ENGAGED the wanted force is crossfaded with damping: at
engaging, after a stall or a silence of the device, and after the dead-man button::

    F = g F_wanted - (1 - g) b v,     g from 0 to 1 or back

A force that is not finite is FAULT: what was sent last is ramped to zero.

:class:`tissueid.haptics.device.HapticDevice` and the compiled servo both call :func:`guard`; nothing else
reaches a transport.
"""

from __future__ import annotations

import math

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_part
from tissueid.haptics.guard_states import (
    ARMED,
    DAMPED_S,
    DELAYED_TICKS,
    ENGAGED,
    FAULT,
    FAULT_AGE_S,
    FAULT_FORCE,
    FAULTED,
    GAIN,
    GUARD_SIZE,
    LAMPS,
    LET_GO,
    MEAN_SQUARE,
    PENDING_FAULT,
    PENETRATION,
    PHASE,
    PREVIOUS,
    READY,
    RECOVERING,
    RELEASING,
    RISE_RATE,
    RISING,
    SILENT_S,
    STATE,
    VELOCITY,
    YIELDING,
    engage_now,
    fail,
    new_guard,
    pause,
    transition,
)
from tissueid.haptics.limits import (
    CLAMP_N,
    DAMPING,
    DAMPING_S,
    DEAD_MAN_S,
    DELAY_TICKS,
    ENGAGE_BELOW_N,
    FAULT_RAMP_S,
    LIMITS_SIZE,
    PAUSE_RAMP_S,
    PAUSE_S,
    RECOVERY_S,
    RMS_LIMIT_N,
    RMS_WINDOW_S,
    SLEW_N,
    STALL_S,
    GuardLimits,
    uncalibrated_clamp_N,
)
from tissueid.haptics.states import Fault, Lamp
from tissueid.haptics.watchdogs import LONGEST_STALL_S, observe, observe_wire

__all__ = [
    "FAULT",
    "GUARD_SIZE",
    "LAMPS",
    "LIMITS_SIZE",
    "STATE",
    "GuardLimits",
    "guard",
    "new_guard",
    "observe",
    "observe_wire",
    "transition",
    "uncalibrated_clamp_N",
]

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
    """The force that may be sent.

    ``memory`` (GUARD_SIZE,): of this device, :func:`new_guard`; updated in place; ``limits`` (LIMITS_SIZE,):
    :meth:`GuardLimits.block`; ``force`` (3,): wanted force [N]; may hold anything; ``dt``: measured time
    since the last tick [s]; anything that is not a good tick counts as a stall; ``out`` (3,): **Written**:
    force [N], finite, within every limit.
    """
    stalled = not 0.0 < dt <= limits[STALL_S]
    step = limits[STALL_S] if stalled else dt
    lamps = _STALLED if stalled else 0
    if memory[LET_GO] != 0.0:
        lamps |= _LET_GO
    if memory[SILENT_S] >= limits[PAUSE_S]:
        lamps |= _SILENT
    if memory[DELAYED_TICKS] > 0.0:
        lamps |= _LATENCY
    finite = math.isfinite(force[0]) and math.isfinite(force[1]) and math.isfinite(force[2])
    out[0] = 0.0
    out[1] = 0.0
    out[2] = 0.0
    # an unknown depth (NaN) is not a free tool
    free = memory[PENETRATION] <= 0.0 or (finite and _length(force) < limits[ENGAGE_BELOW_N])
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
        most = limits[DELAY_TICKS] / (limits[DELAY_TICKS] + memory[DELAYED_TICKS])
        risen = min(most, memory[GAIN] + step * memory[RISE_RATE])
        memory[GAIN] = max(risen, memory[GAIN] - step / limits[RECOVERY_S])
        return
    silent = memory[SILENT_S] >= limits[PAUSE_S]
    time = limits[FAULT_RAMP_S]
    if silent:
        time = limits[PAUSE_RAMP_S]
    elif memory[PHASE] == RELEASING:
        time = limits[DEAD_MAN_S]
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
        if memory[DAMPED_S] >= limits[DAMPING_S]:
            fail(memory, memory[PENDING_FAULT])


@tick_part
def _engaged(memory: FloatArray, limits: FloatArray, force: FloatArray, out: FloatArray) -> int:
    """Crossfade with damping, then clamp, slew and sustained limit; the lamps of what bit."""
    gain = memory[GAIN]
    damping = (1.0 - gain) * limits[DAMPING]
    for i in range(3):
        out[i] = gain * force[i] - damping * memory[VELOCITY + i]
    lamps = _RAMPING if gain < 1.0 else 0
    length = _length(out)
    if length == math.inf:
        # only the direction is left of it, longer than the clamp
        largest = max(abs(out[0]), abs(out[1]), abs(out[2]))
        for i in range(3):
            out[i] = out[i] / largest * (2.0 * limits[CLAMP_N])
        length = _length(out)
    bound = length
    if bound > limits[CLAMP_N]:
        bound = limits[CLAMP_N]
        lamps |= _CLIPPED
    if length > 0.0:
        along = (
            memory[PREVIOUS] * out[0] + memory[PREVIOUS + 1] * out[1] + memory[PREVIOUS + 2] * out[2]
        ) / length
        risen = max(along, 0.0) + limits[SLEW_N]
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
    share = memory[MEAN_SQUARE] / (limits[RMS_LIMIT_N] * limits[RMS_LIMIT_N])
    fold = min(max((share - FOLD_FROM) / (1.0 - FOLD_FROM), 0.0), 1.0)
    lowest = min(limits[RMS_LIMIT_N], limits[CLAMP_N])
    return float(limits[CLAMP_N] - fold * (limits[CLAMP_N] - lowest))


@tick_part
def _fade(memory: FloatArray, limits: FloatArray, dt: float, out: FloatArray) -> int:
    """Ramp of a fault: from what was sent last to zero."""
    memory[FAULT_AGE_S] += dt
    silent = memory[SILENT_S] >= limits[PAUSE_S]
    left = 1.0 - memory[FAULT_AGE_S] / limits[PAUSE_RAMP_S if silent else FAULT_RAMP_S]
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
    share = step / limits[RMS_WINDOW_S]
    memory[MEAN_SQUARE] += (square - memory[MEAN_SQUARE]) * min(share, 1.0)
    if memory[MEAN_SQUARE] > OVERHEATED * limits[RMS_LIMIT_N] * limits[RMS_LIMIT_N]:
        fail(memory, _OVERHEATED)
