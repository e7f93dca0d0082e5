"""A slow force law in Python and what it recorded: for measurements, not for rendering."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError
from tissueid.haptics.device import HapticDevice
from tissueid.haptics.states import FAULT_WORDS, State
from tissueid.haptics.velocity import velocity_step

#: ``law(time since the start [s], position [m], velocity [m/s]) -> force [N]``.
Law = Callable[[float, FloatArray, FloatArray], FloatArray]
#: Waits until a time of the device's clock; a device in virtual time needs none.
Pace = Callable[[float], None]

TICK_S = 0.001
#: How long a device may take from "force is wanted" to force [s].
ENGAGE_S = 5.0
#: The start-up ramp of the guard, with room [s].
RAMP_S = 1.2


def wait_for(deadline_s: float) -> None:
    """Sleep until a time of CLOCK_MONOTONIC."""
    left = deadline_s - time.monotonic()
    if left > 0.0:
        time.sleep(left)


@dataclass(frozen=True)
class Motion:
    """Recorded ticks."""

    time_s: FloatArray  # (n,), since the start
    #: (n, 3): where the grip was, and the force sent right after: what the guard let through.
    position_m: FloatArray
    force_N: FloatArray  # (n, 3)


def record(device: HapticDevice, law: Law, duration_s: float, pace: Pace = wait_for) -> Motion:
    """Run a force law for some time.

    ``device``: homed; ``pace``: how to wait for the next tick.  Raises DeviceError: on a fault, or when the
    device is lost.
    """
    times: list[float] = []
    positions: list[FloatArray] = []
    forces: list[FloatArray] = []
    velocity = np.zeros(3)
    last: FloatArray | None = None
    begin = before = 0.0
    while not times or times[-1] < duration_s:
        sample = device.read()
        if device.state is State.FAULT:
            msg = f"{device.name}: {FAULT_WORDS[device.fault]}"
            raise DeviceError(msg)
        if last is None:
            last, begin, before = sample.position_m.copy(), sample.time_s, sample.time_s - TICK_S
        dt = sample.time_s - before
        before = sample.time_s
        velocity_step(velocity, sample.position_m, last, dt)
        now = sample.time_s - begin
        times.append(now)
        positions.append(sample.position_m.copy())
        forces.append(device.write_force(law(now, sample.position_m, velocity), dt))
        pace(before + TICK_S)
    return Motion(np.array(times), np.array(positions), np.array(forces))


def engage(device: HapticDevice, pace: Pace = wait_for) -> None:
    """Ask for force and wait through the guard's start-up ramp, with a law that wants none.

    Raises DeviceError: if the guard does not engage: not homed, or the dead-man button is not held.
    """
    zero = np.zeros(3)
    device.engage()
    waited = 0.0
    while device.state is not State.ENGAGED and waited < ENGAGE_S:
        record(device, lambda _t, _p, _v: zero, 0.0, pace)
        waited += TICK_S
    if device.state is not State.ENGAGED:
        msg = f"{device.name}: no force within {ENGAGE_S:g} s: is it homed, and the dead-man button held?"
        raise DeviceError(msg)
    record(device, lambda _t, _p, _v: zero, RAMP_S, pace)
