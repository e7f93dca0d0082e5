"""Passivity observer and controller in the time domain (compiled); Hannaford & Ryu, doi 10.1109/70.988969.

The ledger E[k] = E[k-1] - f[k-1] . (x[k] - x[k-1]) of a touch begins with it: what one press dissipated does
not pay for the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel, tick_part
from tissueid.haptics.guard import velocity_step

# -- parameters: without ON the observer counts, and nothing is corrected
CONTROL_SIZE = 6
ON, COUNT_M, STIFFNESS, LARGEST_DAMPING, LARGEST_CORRECTION_N, LARGEST_CHANGE_N = range(CONTROL_SIZE)

# -- memory
CONTROL_MEMORY_SIZE = 20
STARTED, POSITION, SENT, VELOCITY, CORRECTION = 0, 1, 4, 7, 10
#: Energy taken from the hand since the touch began, and since the session began [J]; deficit that is allowed
#: for [J]; 1 in ticks that were corrected; braking coefficient of the last tick [N s/m].
TOUCH_J, TOTAL_J, ALLOWANCE_J, ACTIVE, DAMPING = range(13, 18)

#: Deficit that a single rounding of the ledger may show [J].
SMALLEST_ALLOWANCE_J = 1e-6
#: Speeds below this have no direction to brake [m/s].
AT_REST_M_S = 1e-6
#: No limit may allow more in a tick [N].
LARGEST_CHANGE_ALLOWED_N = 0.5


@dataclass(frozen=True, slots=True)
class PassivityLimits:
    """Limits of the controller."""

    on: bool = True  # without it the observer counts and nothing is corrected
    count_m: float = 45e-6  # encoder count of the device [m]
    stiffness_N_per_m: float = 500.0  # largest stiffness felt at the device
    #: Braking coefficient; a hand feels twice a Falcon's own, and 1.5 ticks late it is still stable.
    largest_damping_N_s_per_m: float = 2.0
    #: Of the braking force, and of its change in a tick.
    largest_correction_N: float = 1.0
    largest_change_N: float = 0.5

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = float(getattr(self, entry.name))
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{entry.name} must be finite and not negative, is {value}")
        if self.largest_change_N > LARGEST_CHANGE_ALLOWED_N:
            raise ValueError(
                f"largest_change_N is {self.largest_change_N}, at most {LARGEST_CHANGE_ALLOWED_N} is allowed"
            )

    def block(self) -> FloatArray:
        """The limits for the kernel, shape (CONTROL_SIZE,)."""
        return np.array([float(getattr(self, entry.name)) for entry in fields(self)])


@tick_kernel
def passivity_step(
    memory: FloatArray, parameters: FloatArray, position: FloatArray, force: FloatArray, dt: float
) -> None:
    """Count the energy of the last tick and brake where the hand got back more than it gave.

    Positions are rounded to encoder counts: 1 uJ and k q^2 / 2 for each count q travelled are allowed
    for. Beyond that f_c = -alpha v, alpha = deficit / (|v|^2 dt), is added to ``force`` [N], with alpha,
    |f_c| and its change capped. A grip at rest keeps alpha while v fades, one that turned is not braked, and
    the sum never points against ``force``: a brake takes a push away, and pulls at nothing.
    """
    travelled = 0.0
    onward = 0.0
    taken = 0.0
    if memory[STARTED] > 0.0:
        for i in range(3):
            moved = position[i] - memory[POSITION + i]
            taken -= memory[SENT + i] * moved
            travelled += moved * moved
            onward += memory[VELOCITY + i] * moved
    memory[STARTED] = 1.0
    # the time constant of the measured velocity: a count in a tick is no speed
    velocity_step(memory[VELOCITY : VELOCITY + 3], position, memory[POSITION : POSITION + 3], dt)
    square = 0.0
    for i in range(3):
        square += memory[VELOCITY + i] * memory[VELOCITY + i]
    memory[TOTAL_J] += taken
    memory[TOUCH_J] += taken
    count = parameters[COUNT_M]
    memory[ALLOWANCE_J] += 0.5 * parameters[STIFFNESS] * count * math.sqrt(travelled)
    deficit = -memory[TOUCH_J] - memory[ALLOWANCE_J]
    damping = 0.0
    slow = square <= AT_REST_M_S * AT_REST_M_S
    if parameters[ON] > 0.0 and deficit > 0.0 and onward >= 0.0 and dt > 0.0 and not slow:
        damping = memory[DAMPING]
        if travelled > 0.0:
            damping = min(deficit / (square * dt), parameters[LARGEST_DAMPING])
    memory[DAMPING] = damping
    _brake(memory, parameters, damping, math.sqrt(square))
    _pull_at_nothing(memory, force)
    if force[0] == 0.0 and force[1] == 0.0 and force[2] == 0.0:
        # out of contact: what is left of the ledger was dissipated
        memory[TOUCH_J] = 0.0
        memory[ALLOWANCE_J] = SMALLEST_ALLOWANCE_J
    for i in range(3):
        force[i] += memory[CORRECTION + i]
        memory[SENT + i] = force[i]


@tick_part
def _brake(memory: FloatArray, parameters: FloatArray, damping: float, speed: float) -> None:
    """Move the correction toward ``-damping v``, within its size and its change."""
    scale = -damping
    if damping * speed > parameters[LARGEST_CORRECTION_N]:
        scale = -parameters[LARGEST_CORRECTION_N] / speed
    change = 0.0
    for i in range(3):
        difference = scale * memory[VELOCITY + i] - memory[CORRECTION + i]
        change += difference * difference
    change = math.sqrt(change)
    share = 1.0
    if change > parameters[LARGEST_CHANGE_N]:
        share = parameters[LARGEST_CHANGE_N] / change
    for i in range(3):
        memory[CORRECTION + i] += share * (scale * memory[VELOCITY + i] - memory[CORRECTION + i])


@tick_part
def _pull_at_nothing(memory: FloatArray, force: FloatArray) -> None:
    """Shorten the correction until its sum with ``force`` does not point against it; none without force."""
    square = 0.0
    along = 0.0
    for i in range(3):
        square += force[i] * force[i]
        along += force[i] * memory[CORRECTION + i]
    share = 1.0
    if square == 0.0:
        share = 0.0
    elif along < -square:
        share = -square / along
    memory[ACTIVE] = 0.0
    for i in range(3):
        memory[CORRECTION + i] *= share
        if memory[CORRECTION + i] != 0.0:
            memory[ACTIVE] = 1.0


@tick_part
def note_sent(memory: FloatArray, sent: FloatArray) -> None:
    """Tell the observer what the guard really let through [N]: energy is counted on that."""
    for i in range(3):
        memory[SENT + i] = sent[i]
