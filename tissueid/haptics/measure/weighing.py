"""Force constant by a known mass: the device holds a known mass up, and says how strong it thinks it is.

The grip is held by a spring with an integrating part, and led up and down a few millimetres: over whole
periods friction takes as much as it gives, so that the mean of the force sent is the weight held.  Once
without and once with the mass, the difference is the mass alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError
from tissueid.haptics.device import HapticDevice
from tissueid.haptics.measure.motion import Motion, Pace, engage, record, wait_for
from tissueid.haptics.states import Fault

#: Standard gravity [m/s^2]; it varies by 0.3 % over the globe, a kitchen scale by more.
GRAVITY = 9.80665
#: Where the mass is held: the middle of the workspace [m].
MIDDLE_M = (0.0, 0.0, 0.130)
UP = 1
#: Spring, damper and integrating part that hold it [N/m, N s/m, N/(m s)]: slow beside 1.5 ticks of delay.
STIFFNESS, DAMPING, INTEGRAL = 150.0, 2.0, 300.0
#: The setpoint goes to the middle in this time, then swings by this much and this often [s, m, s].
APPROACH_S, SWING_M, PERIOD_S = 2.0, 0.004, 2.0
#: Periods that are left out and used.
SETTLING, PERIODS = 1, 4
#: Share of samples at the guard's clamp above which the mass is too heavy for it.
MOST_CLIPPED = 0.02
LIGHTER = "take a smaller mass"
#: A sample counts as clipped at this share of the clamp.
NEARLY = 0.99


@dataclass(frozen=True)
class Weighing:
    """Result of :func:`weigh`."""

    #: Nominal force that held the grip alone, and with the mass.
    empty_N: float
    loaded_N: float
    weight_N: float  # what the mass weighs
    ratio: float  # nominal force for one true newton
    stderr: float  # standard error of the ratio, from the spread of the periods


def weigh(device: HapticDevice, mass_kg: float, hang: Callable[[], None], pace: Pace = wait_for) -> Weighing:
    """Hold the grip, then the grip with a mass.

    ``device``: homed; its dead-man button off, since no hand may hold the grip; ``hang``: returns when the
    user has hung the mass on the grip; the device sends no force meanwhile; ``pace``: how to wait for the
    next tick.  Raises DeviceError: the clamp is reached, the mass is not felt, or a fault.
    """
    empty = _held(device, pace)
    device.disengage()
    record(device, lambda _t, _p, _v: np.zeros(3), PERIOD_S, pace)
    hang()
    loaded = _held(device, pace)
    device.disengage()
    weight = mass_kg * GRAVITY
    difference = float(np.mean(loaded) - np.mean(empty))
    error = math.sqrt((np.var(loaded, ddof=1) + np.var(empty, ddof=1)) / PERIODS)
    if not difference > 4.0 * error:
        msg = (
            f"the mass was not felt: the grip was held with {np.mean(empty):.2f} N without it and "
            f"{np.mean(loaded):.2f} N with it; does it hang freely on the grip?"
        )
        raise DeviceError(msg)
    return Weighing(
        float(np.mean(empty)), float(np.mean(loaded)), weight, difference / weight, error / weight
    )


def _held(device: HapticDevice, pace: Pace) -> FloatArray:
    """Mean upward force of each period, shape (PERIODS,)."""
    engage(device, pace)
    start = device.read().position_m
    end = APPROACH_S + (SETTLING + PERIODS) * PERIOD_S
    try:
        motion = record(device, _Holder(start), end, pace)
    except DeviceError as error:
        if device.fault is not Fault.ENCODER_FROZEN:
            raise
        msg = f"{device.limits.clamp_N:.2f} N, all that the guard allows, did not lift the grip: {LIGHTER}"
        raise DeviceError(msg) from error
    _check_clamp(device, motion)
    means = []
    for period in range(SETTLING, SETTLING + PERIODS):
        begin = APPROACH_S + period * PERIOD_S
        inside = (motion.time_s >= begin) & (motion.time_s < begin + PERIOD_S)
        means.append(_time_mean(motion.time_s[inside], motion.force_N[inside, UP]))
    return np.array(means)


def _time_mean(time_s: FloatArray, force_N: FloatArray) -> float:
    """Mean over time of a force that holds until the next tick."""
    steps = np.diff(time_s)
    return float(np.sum(force_N[:-1] * steps) / np.sum(steps))


def _check_clamp(device: HapticDevice, motion: Motion) -> None:
    clamp = device.limits.clamp_N
    clipped = np.mean(np.linalg.norm(motion.force_N, axis=1) > NEARLY * clamp)
    if clipped > MOST_CLIPPED:
        msg = (
            f"the grip needs the whole {clamp:.2f} N that the guard allows, {100 * clipped:.0f} % of the "
            f"time: {LIGHTER}"
        )
        raise DeviceError(msg)


class _Holder:
    """The holding law, with its integral."""

    def __init__(self, start: FloatArray) -> None:
        self._start = start
        self._integral = 0.0
        self._before = 0.0

    def __call__(self, time_s: float, position: FloatArray, velocity: FloatArray) -> FloatArray:
        share = min(time_s / APPROACH_S, 1.0)
        wanted = self._start + share * (np.array(MIDDLE_M) - self._start)
        wanted[UP] += SWING_M * math.sin(2.0 * math.pi * max(time_s - APPROACH_S, 0.0) / PERIOD_S)
        error = wanted - position
        self._integral += INTEGRAL * error[UP] * (time_s - self._before)
        self._before = time_s
        force = STIFFNESS * error - DAMPING * velocity
        force[UP] += self._integral
        return np.asarray(force)
