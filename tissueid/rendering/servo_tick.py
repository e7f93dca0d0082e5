"""One tick of the servo: read, velocity, force law, passivity, watchdogs, guard, command, record.

Every loop calls :func:`tick`, so that what is tested in virtual time is what runs on a device; it allocates
nothing.  The law sees the measured time since the last tick: a late tick is no wrong force.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import tick_kernel, tick_part
from tissueid.errors import DeviceError
from tissueid.haptics import device as devices
from tissueid.haptics import guard as machine
from tissueid.haptics.foreign import store_release
from tissueid.haptics.parameter_block import COMMAND_ENGAGE, ParameterBlock, take, waiting
from tissueid.haptics.parameter_block import command as ordered
from tissueid.haptics.ring import PUBLISHED_AT, Ring
from tissueid.haptics.states import Lamp
from tissueid.rendering import environment as env
from tissueid.rendering import passivity_control as passivity
from tissueid.rendering.environment import environment_step, put_at_rest

#: Parameters of one version: the environment's, then the passivity controller's.
BLOCK_SIZE = env.ENVIRONMENT_SIZE + passivity.CONTROL_SIZE

#: Counters: ticks so far, ticks skipped, version of the parameters, whether a position was seen, whether a
#: signal asked for the end.
TICKS, MISSED, VERSION, SEEN, TOLD_TO_END = range(5)
COUNTERS_SIZE = 5
#: Readings at the start of a loop that show no motion: each command is answered once, so that only the
#: first can be old.
FRESH_READINGS = 2
#: Longest step the force law is given [s]: after a second nothing of a stall is left in tissue.
LONGEST_STEP_S = 1.0
#: Shortest step [s]: a late tick and a punctual one lie so close that their difference is noise.
SHORTEST_STEP_S = 1e-5
#: Largest number of skipped ticks a record can hold.
MISSED_LIMIT = 65_535
COUNT_LIMIT = 32_767

_PASSIVITY = int(Lamp.PASSIVITY)


class Servo(NamedTuple):
    """Everything a tick remembers, as arrays that compiled code shares with Python."""

    #: Of :mod:`tissueid.haptics.guard`; the device's own.
    guard_memory: FloatArray
    limits: FloatArray
    #: Of :mod:`tissueid.rendering.environment`.
    environment: FloatArray
    environment_memory: FloatArray
    #: Of :mod:`tissueid.rendering.passivity_control`.
    control: FloatArray
    control_memory: FloatArray
    #: [m], [m/s], [N]; shape (3,).
    position: FloatArray
    last_position: FloatArray
    velocity: FloatArray
    force: FloatArray
    out: FloatArray
    info: FloatArray  # what the environment said
    since_valid: FloatArray  # time since the last valid reading [s], shape (1,)
    #: Encoder counts; words of a reading.
    counts: IntArray
    last_counts: IntArray
    moved: IntArray
    words: IntArray
    counters: IntArray
    #: Of :class:`tissueid.haptics.ring.Ring`.
    ring_head: IntArray
    records: NDArray[Any]
    #: Of :class:`tissueid.haptics.parameter_block.ParameterBlock`.
    block_head: IntArray
    block_values: FloatArray
    staged: FloatArray  # (BLOCK_SIZE,), a version while it is taken over


def new_servo(device: devices.HapticDevice, ring: Ring, block: ParameterBlock) -> Servo:
    """A servo at rest in free air, until parameters are published."""
    return Servo(
        guard_memory=device.guard_memory,
        limits=device.limits.block(),
        environment=np.zeros(env.ENVIRONMENT_SIZE),
        environment_memory=np.zeros(env.MEMORY_SIZE),
        control=np.zeros(passivity.CONTROL_SIZE),
        control_memory=np.zeros(passivity.CONTROL_MEMORY_SIZE),
        position=np.zeros(3),
        last_position=np.zeros(3),
        velocity=np.zeros(3),
        force=np.zeros(3),
        out=np.zeros(3),
        info=np.zeros(env.INFO_SIZE),
        since_valid=np.zeros(1),
        counts=np.zeros(3, np.int64),
        last_counts=np.zeros(3, np.int64),
        moved=np.zeros(3, np.int64),
        words=np.zeros(devices.WORDS_SIZE, np.int64),
        counters=np.zeros(COUNTERS_SIZE, np.int64),
        ring_head=ring.head,
        records=ring.records,
        block_head=block.head,
        block_values=block.values,
        staged=np.zeros(BLOCK_SIZE),
    )


class PythonIO(NamedTuple):
    """A device with methods in Python, and a force law in Python where there is one."""

    device: devices.HapticDevice
    law: Callable[..., Any] | None = None


class ServoHere(NamedTuple):
    """A servo in this process, and what it shares with its owner."""

    io: Any
    servo: Servo
    ring: Ring
    block: ParameterBlock


@contextlib.contextmanager
def servo_here(device: devices.HapticDevice) -> Iterator[ServoHere]:
    """Open a device and put a servo on it; all is closed afterwards."""
    ring, block = Ring.create(), ParameterBlock.create(BLOCK_SIZE)
    try:
        with device:
            given = device.compiled()
            io = PythonIO(device) if given is None else devices.compiled_io(given)
            yield ServoHere(io, new_servo(device, ring, block), ring, block)
    finally:
        ring.close()
        block.close()


# -- a device: one reading and one command a tick, compiled for those the servo knows --------------


def _sense_python(io: PythonIO, position: FloatArray, counts: IntArray, words: IntArray) -> None:
    """One reading of a plug-in."""
    try:
        sample = io.device.sample()
    except DeviceError:
        words[devices.REPLY] = machine.REPLY_LOST
        return
    without = machine.REPLY_DAMAGED if sample.damaged else machine.REPLY_NONE
    words[devices.REPLY] = machine.REPLY_VALID if sample.valid else without
    words[devices.HOMED] = int(sample.homed)
    words[devices.PRESSED] = sample.buttons
    if sample.valid:
        position[:] = sample.position_m
        counts[:] = sample.counts


def sense(io: Any, dt: float, position: FloatArray, counts: IntArray, words: IntArray) -> None:
    """Read a device once, without waiting: ``position`` [m] and ``counts`` of a valid reply, ``words``."""
    if isinstance(io, PythonIO):
        _sense_python(io, position, counts, words)
    else:
        devices.access_of(type(io)).sense(io, dt, position, counts, words)


def command(io: Any, guard_memory: FloatArray, limits: FloatArray, force: FloatArray) -> None:
    """Send a force [N] that passed the guard; called by :func:`send` alone."""
    devices.access_of(type(io)).command(io, guard_memory, limits, force)


@overload(sense)
def _compiled_sense(io, dt, position, counts, words):  # type: ignore[no-untyped-def] # noqa: ARG001
    """The reading of this kind of device, built into the loop."""
    kernel = devices.access_of(io.instance_class).sense
    return lambda io, dt, position, counts, words: kernel(io, dt, position, counts, words)


@overload(command)
def _compiled_command(io, guard_memory, limits, force):  # type: ignore[no-untyped-def] # noqa: ARG001
    """The command of this kind of device, built into the loop."""
    kernel = devices.access_of(io.instance_class).command
    return lambda io, guard_memory, limits, force: kernel(io, guard_memory, limits, force)


# -- the tick: kernels take the few arrays they work on, for passing the servo costs more than most of them


@tick_part
def _count_motion(fresh: bool, valid: bool, counts: IntArray, last_counts: IntArray, moved: IntArray) -> None:
    """Encoder counts since the last valid reading."""
    for i in range(3):
        moved[i] = counts[i] - last_counts[i] if valid and not fresh else 0
        if valid:
            last_counts[i] = counts[i]


@tick_part
def _obey(guard_memory: FloatArray, limits: FloatArray, block_head: IntArray, counters: IntArray) -> bool:
    """Want force or none as the owner or a signal does; True where new parameters may be taken now."""
    wanted = ordered(block_head) == COMMAND_ENGAGE and counters[TOLD_TO_END] == 0
    if wanted and guard_memory[machine.WANTED] == 0.0:
        machine.transition(guard_memory, limits, machine.ENGAGE)
    elif not wanted and guard_memory[machine.WANTED] != 0.0:
        machine.transition(guard_memory, limits, machine.DISENGAGE)
    return bool(waiting(block_head) and machine.transition(guard_memory, limits, machine.SWAP))


@tick_kernel
def _exchange(
    block_head: IntArray,
    block_values: FloatArray,
    staged: FloatArray,
    environment: FloatArray,
    environment_memory: FloatArray,
    control: FloatArray,
) -> int:
    """Take new parameters over, with tissue at rest; returns their version."""
    version = take(block_head, block_values, staged)
    for i in range(env.ENVIRONMENT_SIZE):
        environment[i] = staged[i]
    for i in range(passivity.CONTROL_SIZE):
        control[i] = staged[env.ENVIRONMENT_SIZE + i]
    put_at_rest(environment_memory)
    return int(version)


def apply_law(io: Any, position: FloatArray, velocity: FloatArray, dt: float, force: FloatArray) -> bool:
    """Put the force of a law in Python in the place of the environment's; False where there is none."""
    law = io.law if isinstance(io, PythonIO) else None
    if law is None:
        return False
    force[:] = law(position.copy(), velocity.copy(), dt)
    return True


@overload(apply_law)
def _no_law(io, position, velocity, dt, force):  # type: ignore[no-untyped-def] # noqa: ARG001
    """A compiled loop has compiled laws only."""
    return lambda io, position, velocity, dt, force: False  # noqa: ARG005


def send(
    io: Any, guard_memory: FloatArray, limits: FloatArray, force: FloatArray, dt: float, out: FloatArray
) -> None:
    """Pass the guard and command the device: the only way from a force to a transport."""
    if isinstance(io, PythonIO):
        out[:] = 0.0
        # a device that is gone gets nothing; its next reading says so to the watchdogs
        with contextlib.suppress(DeviceError):
            out[:] = io.device.write_force(force, dt)
    else:
        _send(io, guard_memory, limits, force, dt, out)


@tick_kernel
def _send(
    io: Any, guard_memory: FloatArray, limits: FloatArray, force: FloatArray, dt: float, out: FloatArray
) -> None:
    machine.guard(guard_memory, limits, force, dt, out)
    command(io, guard_memory, limits, out)


@overload(send)
def _compiled_send(io, guard_memory, limits, force, dt, out):  # type: ignore[no-untyped-def] # noqa: ARG001
    """Guard and command of a device the servo knows."""
    return lambda io, guard_memory, limits, force, dt, out: _send(io, guard_memory, limits, force, dt, out)


@tick_part
def _lamps(guard_memory: FloatArray, control_memory: FloatArray, info: FloatArray) -> int:
    """Lamps of guard, environment and controller."""
    lamps = int(guard_memory[machine.LAMPS]) | int(info[env.INFO_FLAGS])
    return lamps | _PASSIVITY if control_memory[passivity.ACTIVE] != 0.0 else lamps


@tick_kernel
def _record(servo: Servo, now_s: float, dt: float, late_s: float, lamps: int) -> None:
    """Write the record of this tick and publish it."""
    counters = servo.counters
    count = counters[TICKS]
    record = servo.records[count % servo.records.size]
    record["tick"] = count
    record["time_s"] = now_s
    record["dt_s"] = dt
    for i in range(3):
        record["position_m"][i] = servo.position[i]
        record["force_N"][i] = servo.out[i]
        record["counts"][i] = min(max(servo.counts[i], -COUNT_LIMIT), COUNT_LIMIT)
    record["depth_mm"] = servo.info[env.INFO_DEPTH_MM]
    record["tissue_force_N"] = servo.info[env.INFO_TISSUE_FORCE_N]
    record["speed_mm_per_s"] = servo.info[env.INFO_SPEED_MM_S]
    record["surface_mm"] = servo.info[env.INFO_SURFACE_MM]
    record["energy_J"] = servo.control_memory[passivity.TOTAL_J]
    record["lamps"] = lamps
    record["state"] = int(servo.guard_memory[machine.STATE])
    record["fault"] = int(servo.guard_memory[machine.FAULT])
    record["buttons"] = servo.words[devices.PRESSED]
    record["late_s"] = late_s
    record["version"] = counters[VERSION]
    record["missed"] = min(counters[MISSED], MISSED_LIMIT)
    record["label"] = int(servo.info[env.INFO_LABEL])
    counters[TICKS] = count + 1
    # this record is whole: now readers may see it
    store_release(servo.ring_head[PUBLISHED_AT : PUBLISHED_AT + 1], count + 1)


def tick(io: Any, servo: Servo, now_s: float, dt: float, late_s: float, late_lamp: int) -> None:
    """One tick, with its time, the time since the last one, and after its deadline [s].

    ``late_lamp``: ``Lamp.LATE`` where the tick's period was off by more than a tenth, else 0.
    """
    memory, limits, environment = servo.guard_memory, servo.limits, servo.environment
    position, velocity, force, info, words = (
        servo.position, servo.velocity, servo.force, servo.info, servo.words,
    )  # fmt: skip
    sense(io, dt, position, servo.counts, words)
    valid = words[devices.REPLY] == machine.REPLY_VALID
    # until homing ends coordinates jump, and the first reading may be an answer from before the loop began,
    # seconds old: nothing moved
    fresh = servo.counters[SEEN] < FRESH_READINGS or memory[machine.STATE] <= machine.HOMING
    _count_motion(fresh, valid, servo.counts, servo.last_counts, servo.moved)
    servo.since_valid[0] += dt
    if valid:
        servo.counters[SEEN] = min(servo.counters[SEEN] + 1, FRESH_READINGS)
        for i in range(3):
            if fresh:
                servo.last_position[i] = position[i]
                velocity[i] = 0.0
        # over the whole gap where readings were missing, or a slow hand would look fast after it
        machine.velocity_step(velocity, position, servo.last_position, servo.since_valid[0])
        servo.since_valid[0] = 0.0
    if _obey(memory, limits, servo.block_head, servo.counters):
        servo.counters[VERSION] = _exchange(
            servo.block_head, servo.block_values, servo.staged, environment, servo.environment_memory,
            servo.control,
        )  # fmt: skip
    step = min(max(dt, SHORTEST_STEP_S), LONGEST_STEP_S)
    environment_step(environment, servo.environment_memory, position, velocity, step, force, info)
    if apply_law(io, position, velocity, step, force):
        # such a law knows no depth: engaging waits for a small force, an exchange for no force at all
        info[env.INFO_PENETRATION_M] = np.nan
    passivity.passivity_step(servo.control_memory, servo.control, position, force, dt)
    homed, buttons, depth = words[devices.HOMED] != 0, words[devices.PRESSED], info[env.INFO_PENETRATION_M]
    machine.observe(memory, limits, words[devices.REPLY], homed, buttons, servo.moved, velocity, depth, dt)
    machine.observe_wire(memory, limits, words[devices.UNANSWERED], dt)
    send(io, memory, limits, force, dt, servo.out)
    passivity.note_sent(servo.control_memory, servo.out)
    _record(servo, now_s, dt, late_s, _lamps(memory, servo.control_memory, info) | late_lamp)


#: One tick, compiled for the type of its ``io``; loops in Python call :func:`tick` itself.
compiled_tick = tick_kernel(tick)


@overload(tick)
def _tick_in_loop(io, servo, now_s, dt, late_s, late_lamp):  # type: ignore[no-untyped-def] # noqa: ARG001
    """A compiled loop takes the compiled tick."""
    return lambda io, servo, now_s, dt, late_s, late_lamp: compiled_tick(
        io, servo, now_s, dt, late_s, late_lamp
    )
