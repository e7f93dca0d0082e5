"""A device's arm in a hand: mass, viscous damping, Coulomb friction, and a hand's spring and damper.

::

    m dv/dt = F_motor + F_hand - b v - f,      f = fc v/|v| while it slides, |f| <= fc while it sticks
    F_hand  = -g k (x - x_t) - g c (v - v_t)   x_t(t): where the hand wants to be, g(t): its grip, 0 to 1

Steps are Moreau-Jean with theta = 1/2 (Acary & Brogliato 2008, doi 10.1007/978-3-540-75392-6, section 10.1):
a resting arm stays at rest exactly, and the energies close to rounding.  SI units.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel
from tissueid.haptics import shared_hand as layout

# --- memory
TIME, POSITION, VELOCITY = 0, 1, 4
TARGET, TARGET_VELOCITY, HAND_FORCE = 7, 10, 13
MOTOR_WORK, HAND_WORK, DAMPING_LOSS, FRICTION_LOSS = 16, 17, 18, 19
CURSOR, POINTED = 20, 21  # pointed: 21, 22, 23
ARM_MEMORY = 24

#: Longest sub-step [s]: a 1000 N/m hand on 0.1 kg turns by 0.005 rad in it, its frequency is off by 2e-6.
DEFAULT_SUBSTEP_S = 5e-5
#: A pointer arrives at tens of pictures a second; the hand follows it with this time constant [s] ...
POINTER_TIME_S = 0.03
#: ... and no faster than this [m/s].
POINTER_SPEED = 0.5
#: A tremor grows to its amplitude in this time [s]: it must not begin with a jump.
TREMOR_RISE_S = 0.2


@dataclass(frozen=True, slots=True)
class Arm:
    """Mechanics of a device's arm, without the hand."""

    #: Inertia felt at the grip.  0.25 kg is an assumption: no device was weighed.
    mass_kg: float = 0.25
    #: Viscous damping; 0.5 N s/m is the preset every passivity figure is computed with.
    damping_N_s_per_m: float = 0.5
    friction_N: float = 0.1  # coulomb friction, the same in all directions
    substep_s: float = DEFAULT_SUBSTEP_S  # longest step of the integration [s]

    def __post_init__(self) -> None:
        if not (self.mass_kg > 0.0 and self.substep_s > 0.0):
            msg = f"mass_kg and substep_s must be positive, are {self.mass_kg} and {self.substep_s}"
            raise ValueError(msg)
        if not (self.damping_N_s_per_m >= 0.0 and self.friction_N >= 0.0):
            raise ValueError(
                f"damping and friction can't be negative, are {self.damping_N_s_per_m} and {self.friction_N}"
            )

    def block(self) -> FloatArray:
        """Parameters of an arm that no hand holds, shape (ARM_PARAMETERS,); a hand writes itself into it."""
        block = np.zeros(layout.ARM_PARAMETERS)
        block[[layout.MASS, layout.DAMPING, layout.FRICTION, layout.SUBSTEP]] = astuple(self)
        return block


def new_arm(position_m: FloatArray) -> FloatArray:
    """Memory of an arm at rest at a position [m], shape (ARM_MEMORY,)."""
    memory = np.zeros(ARM_MEMORY)
    for start in (POSITION, TARGET, POINTED):
        memory[start : start + 3] = position_m
    return memory


@tick_kernel
def _scripted(parameters: FloatArray, knot: int, axis: int, time: float) -> float:
    """Coordinate of the script at a time on the stretch that begins with ``knot``."""
    at = layout.FIRST_KNOT + layout.KNOT_COLUMNS * knot
    value = parameters[at + 1 + axis]
    if knot + 1 >= int(parameters[layout.KNOTS]):
        return float(value)
    after = at + layout.KNOT_COLUMNS
    length = parameters[after] - parameters[at]
    if time <= parameters[at] or length <= 0.0:
        return float(value)
    return float(value + (parameters[after + 1 + axis] - value) * (time - parameters[at]) / length)


@tick_kernel
def _move_target(memory: FloatArray, parameters: FloatArray, h: float) -> float:
    """Move the hand's target on by ``h`` and return its grip over that step."""
    time = memory[TIME] + h
    count = int(parameters[layout.KNOTS])
    knot = int(memory[CURSOR])
    grip = 1.0
    if count > 0:
        while knot + 1 < count and parameters[layout.FIRST_KNOT + layout.KNOT_COLUMNS * (knot + 1)] <= time:
            knot += 1
        memory[CURSOR] = knot
        grip = parameters[layout.FIRST_KNOT + layout.KNOT_COLUMNS * knot + 4]
    shake = 0.0
    if parameters[layout.TREMOR] != 0.0:
        shake = parameters[layout.TREMOR] * min(time / TREMOR_RISE_S, 1.0)
        shake *= math.sin(
            2.0 * math.pi * parameters[layout.TREMOR_HZ] * time + parameters[layout.TREMOR_PHASE]
        )
    follow = -math.expm1(-h / POINTER_TIME_S) if parameters[layout.POINTER_ON] > 0.0 else 0.0
    for i in range(3):
        if parameters[layout.POINTER_ON] > 0.0:
            step = follow * (parameters[layout.POINTER + i] - memory[POINTED + i])
            memory[POINTED + i] += min(max(step, -POINTER_SPEED * h), POINTER_SPEED * h)
            wanted = memory[POINTED + i]
        elif count > 0:
            wanted = _scripted(parameters, knot, i, time)
            memory[POINTED + i] = wanted
        else:
            wanted = memory[POINTED + i]
        wanted += shake * parameters[layout.TREMOR_AXIS + i]
        memory[TARGET_VELOCITY + i] = (wanted - memory[TARGET + i]) / h
        memory[TARGET + i] = wanted
    return float(grip)


@tick_kernel
def _free_step(memory: FloatArray, parameters: FloatArray, force: FloatArray, h: float, grip: float) -> None:
    """One step of an arm in a hand that is a spring and a damper."""
    mass, damping, friction = parameters[layout.MASS], parameters[layout.DAMPING], parameters[layout.FRICTION]
    stiffness = grip * parameters[layout.HAND_STIFFNESS]
    drag = grip * parameters[layout.HAND_DAMPING]
    inertia = mass + 0.5 * h * (damping + drag) + 0.25 * h * h * stiffness
    square = 0.0
    for i in range(3):
        v = memory[VELOCITY + i]
        middle = memory[TARGET + i] - 0.5 * h * memory[TARGET_VELOCITY + i]
        smooth = (
            force[i]
            - 0.5 * (damping + drag) * v
            - stiffness * (memory[POSITION + i] + 0.25 * h * v - middle)
            + drag * memory[TARGET_VELOCITY + i]
        )
        momentum = mass * v + h * smooth
        memory[HAND_FORCE + i] = momentum  # borrowed until the friction is known
        square += momentum * momentum
    length = math.sqrt(square)
    sliding = length > h * friction
    for i in range(3):
        momentum = memory[HAND_FORCE + i]
        rubbed = friction * momentum / length if sliding else momentum / h
        before = memory[VELOCITY + i]
        after = (momentum - h * rubbed) / inertia if sliding else 0.0
        mean = 0.5 * (before + after)
        middle = memory[TARGET + i] - 0.5 * h * memory[TARGET_VELOCITY + i]
        hand = -stiffness * (memory[POSITION + i] + 0.5 * h * mean - middle) - drag * (
            mean - memory[TARGET_VELOCITY + i]
        )
        memory[VELOCITY + i] = after
        memory[POSITION + i] += h * mean
        memory[HAND_FORCE + i] = hand
        memory[MOTOR_WORK] += h * force[i] * mean
        memory[HAND_WORK] += h * hand * mean
        memory[DAMPING_LOSS] += h * damping * mean * mean
        memory[FRICTION_LOSS] += h * rubbed * mean


@tick_kernel
def _carried_step(memory: FloatArray, parameters: FloatArray, force: FloatArray, h: float) -> None:
    """One step of an arm that a machine carries along the target, whatever the force."""
    mass, damping, friction = parameters[layout.MASS], parameters[layout.DAMPING], parameters[layout.FRICTION]
    speed = 0.0
    for i in range(3):
        v = (memory[TARGET + i] - memory[POSITION + i]) / h
        speed += v * v
    speed = math.sqrt(speed)
    for i in range(3):
        v = (memory[TARGET + i] - memory[POSITION + i]) / h
        before = memory[VELOCITY + i]
        rubbed = friction * v / speed if speed > 0.0 else 0.0
        memory[HAND_FORCE + i] = mass * (v - before) / h + damping * v + rubbed - force[i]
        memory[VELOCITY + i] = v
        memory[POSITION + i] = memory[TARGET + i]
        memory[MOTOR_WORK] += h * force[i] * v
        memory[DAMPING_LOSS] += h * damping * v * v
        memory[FRICTION_LOSS] += h * rubbed * v
        # the speed changes at once at a corner of the path: the machine gives exactly the kinetic energy
        memory[HAND_WORK] += (
            0.5 * mass * (v * v - before * before) + h * (damping * v + rubbed - force[i]) * v
        )


@tick_kernel
def arm_step(memory: FloatArray, parameters: FloatArray, force: FloatArray, dt: float) -> None:
    """Move the arm on by ``dt`` [s] under a constant force (3,) of its motors; not back in time."""
    if not dt > 0.0:
        return
    steps = max(1, math.ceil(dt / parameters[layout.SUBSTEP] - 1e-9))
    h = dt / steps
    for _ in range(steps):
        grip = _move_target(memory, parameters, h)
        if parameters[layout.RIGID] > 0.0 and grip > 0.0:
            _carried_step(memory, parameters, force, h)
        else:
            _free_step(memory, parameters, force, h, grip)
        memory[TIME] += h
