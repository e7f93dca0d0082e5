"""A slow force law in Python and what it recorded: for measurements, not for rendering."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError
from tissueid.haptics.device import HapticDevice
from tissueid.haptics.guard import velocity_step
from tissueid.haptics.states import FAULT_WORDS, State

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
    """Run a force law on a homed device for some time; DeviceError on a fault, or when the device is lost."""
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
    """Ask for force and wait through the start-up ramp; DeviceError if the guard does not engage."""
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


#: Tick of the servo [s].
TICK_S = 0.001
#: After this time an answer is lost, not late [s].
PATIENCE_S = 0.05
#: Share of the answers that make the delay: the slowest are stalls of this machine, which the guard sees to.
USUAL_SHARE = 0.95
#: What passes inside the device, between wire, encoders and motors, is not seen here: allowed for [ticks].
UNSEEN_TICKS = 0.5


@dataclass(frozen=True)
class LinkReport:
    """Result of :func:`measure_link`."""

    duration_s: float
    #: Sent, and answered.
    commands: int
    replies: int
    damaged: int  # replies that began and were none
    rate_hz: float  # replies a second when each command waits for its answer
    round_trip_ms: tuple[float, float, float]  # median, 95 % and largest time from a command to its answer
    #: From a position to the force it causes, in a loop of 1 kHz that reads at each tick what was answered to
    #: the last: whole ticks until the answer, plus :data:`UNSEEN_TICKS`; the slowest 5 % are left out.
    delay_ticks: float


def measure_link(device: HapticDevice, duration_s: float = 5.0) -> LinkReport:
    """Send zero force to an open device and wait for the answer, over and over.

    Raises DeviceError: the device is lost, or answers nothing at all.
    """
    zero = np.zeros(3)
    trips: list[float] = []
    commands = damaged = 0
    # the answer to what opening sent must not count as a fast one
    device.sample()
    begin = time.monotonic()
    while (sent := time.monotonic()) - begin < duration_s:
        device.write_force(zero, TICK_S)
        commands += 1
        sample = device.sample()
        # a late answer must not count as a quick one to the next command
        while not (sample.valid or sample.damaged) and time.monotonic() - sent < PATIENCE_S:
            sample = device.sample()
        damaged += sample.damaged
        if sample.valid:
            trips.append(time.monotonic() - sent)
    elapsed = time.monotonic() - begin
    if not trips:
        msg = f"the device answered none of {commands} commands; is its power supply plugged in?"
        raise DeviceError(msg)
    median, high, largest = np.quantile(trips, [0.5, 0.95, 1.0])
    usual = sorted(trips)[: math.ceil(USUAL_SHARE * len(trips))]
    ticks = np.mean([max(1, math.ceil(trip / TICK_S)) for trip in usual])
    return LinkReport(
        duration_s=elapsed,
        commands=commands,
        replies=len(trips),
        damaged=damaged,
        rate_hz=len(trips) / elapsed,
        round_trip_ms=(1e3 * float(median), 1e3 * float(high), 1e3 * float(largest)),
        delay_ticks=float(ticks) + UNSEEN_TICKS,
    )
