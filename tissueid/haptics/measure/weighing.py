"""The newton of a device by a known mass, and the weight of its grip, pose by pose.

The grip is held by a spring with an integrating part and led to and fro a few millimetres: over whole periods
friction takes as much as it gives, so that the mean of the force sent is what holds it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError
from tissueid.haptics.device import HapticDevice
from tissueid.haptics.measure.motion import Motion, Pace, engage, record, wait_for
from tissueid.haptics.states import Fault

#: Standard gravity [m/s^2]; it varies by 0.3 % over the globe, a kitchen scale by more.
GRAVITY = 9.80665
#: Middle of the workspace, where the mass is held, and the corners of a cube around it [m].
MIDDLE_M = (0.0, 0.0, 0.130)
REACH_M = 0.02
POSES_M = (
    MIDDLE_M,
    *(
        tuple(np.add(MIDDLE_M, np.multiply(REACH_M, corner)).tolist())
        for corner in product((-1, 1), repeat=3)
    ),
)
UP = 1
#: Spring, damper and integrating part that hold it [N/m, N s/m, N/(m s)]: slow beside 1.5 ticks of delay.
STIFFNESS, DAMPING, INTEGRAL = 150.0, 2.0, 300.0
SWING_M = 0.004
#: The setpoint goes to the middle in this time, then swings this often [s]; periods left out, and used.
APPROACH_S, PERIOD_S = 2.0, 2.0
SETTLING, PERIODS = 1, 4
#: The same from pose to pose.
POSE_APPROACH_S, POSE_PERIOD_S = 1.5, 1.0
POSE_SETTLING, POSE_PERIODS = 2, 2
#: Share of samples at the guard's clamp (NEARLY of it) above which the mass is too heavy for it.
MOST_CLIPPED, NEARLY = 0.02, 0.99
LIGHTER = "take a smaller mass"


@dataclass(frozen=True)
class Weighing:
    """Result of :func:`weigh`."""

    #: Nominal force that held the grip alone, and with the mass.
    empty_N: float
    loaded_N: float
    weight_N: float  # what the mass weighs
    ratio: float  # nominal force for one true newton
    stderr: float  # standard error of the ratio, from the spread of the periods


@dataclass(frozen=True)
class GripWeight:
    """Plane ``F(p) = w + S (p - middle)`` through the forces that hold the grip: arms and a cable lift it."""

    weight_N: tuple[float, float, float]  # in the middle of the workspace, nominal [N]
    slope_N_per_m: tuple[tuple[float, float, float], ...]  # a row a component of the force
    residual_N: float  # root mean square of what the plane leaves
    stderr_N: float  # standard error of a component in the middle
    poses: int


class _Holder:
    """The holding law: along ``swing`` to and fro, integrating along ``integrated``, from place to place."""

    def __init__(
        self, start: FloatArray, approach_s: float, period_s: float, swing: FloatArray, integrated: FloatArray
    ) -> None:
        self._from = self._to = start.copy()
        self._approach_s, self._period_s = approach_s, period_s
        self._swing, self._integrated = swing, integrated
        self._integral = np.zeros(3)
        self._before = 0.0

    def go(self, place: FloatArray) -> None:
        """Take another place as the next one; the integral goes on."""
        self._from, self._to, self._before = self._to, place, 0.0

    def __call__(self, time_s: float, position: FloatArray, velocity: FloatArray) -> FloatArray:
        wanted = self._from + min(time_s / self._approach_s, 1.0) * (self._to - self._from)
        swung = math.sin(2.0 * math.pi * max(time_s - self._approach_s, 0.0) / self._period_s)
        error = wanted + SWING_M * swung * self._swing - position
        self._integral += INTEGRAL * error * self._integrated * (time_s - self._before)
        self._before = time_s
        return np.asarray(STIFFNESS * error - DAMPING * velocity + self._integral)


def weigh(device: HapticDevice, mass_kg: float, hang: Callable[[], None], pace: Pace = wait_for) -> Weighing:
    """Hold the grip, then the grip with a mass: the difference is the mass alone.

    ``device``: homed; its dead-man button off, since no hand may hold the grip; ``hang``: returns when the
    user has hung the mass on the grip.  Raises DeviceError: the clamp is reached, the mass is not felt, or a
    fault.
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
    holder = _Holder(device.read().position_m, APPROACH_S, PERIOD_S, np.eye(3)[UP], np.eye(3)[UP])
    holder.go(np.array(MIDDLE_M))
    try:
        motion = record(device, holder, APPROACH_S + (SETTLING + PERIODS) * PERIOD_S, pace)
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
        # a force holds until the next tick
        steps = np.diff(motion.time_s[inside])
        means.append(np.average(motion.force_N[inside, UP][:-1], weights=steps))
    return np.array(means)


def _check_clamp(device: HapticDevice, motion: Motion) -> None:
    """Refuse a mass that the guard's clamp does not hold."""
    clamp = device.limits.clamp_N
    clipped = np.mean(np.linalg.norm(motion.force_N, axis=1) > NEARLY * clamp)
    if clipped > MOST_CLIPPED:
        msg = (
            f"the grip needs the whole {clamp:.2f} N that the guard allows, {100 * clipped:.0f} % of the "
            f"time: {LIGHTER}"
        )
        raise DeviceError(msg)


def weigh_poses(device: HapticDevice, pace: Pace = wait_for) -> GripWeight:
    """Hold the grip at every pose.

    ``device``: homed; its dead-man button off, since no hand may hold the grip.  Raises DeviceError: on a
    fault, or when the device is lost.
    """
    engage(device, pace)
    diagonal = np.full(3, 3.0**-0.5)
    holder = _Holder(device.read().position_m, POSE_APPROACH_S, POSE_PERIOD_S, diagonal, np.ones(3))
    settled_s = POSE_APPROACH_S + POSE_SETTLING * POSE_PERIOD_S
    places, forces = [], []
    for pose in POSES_M:
        holder.go(np.array(pose))
        motion = record(device, holder, settled_s + POSE_PERIODS * POSE_PERIOD_S, pace)
        used = motion.time_s >= settled_s
        steps = np.diff(motion.time_s[used], append=motion.time_s[-1])
        places.append(np.average(motion.position_m[used], axis=0, weights=steps))
        forces.append(np.average(motion.force_N[used], axis=0, weights=steps))
    device.disengage()
    return fitted(np.array(places), np.array(forces))


def fitted(places_m: FloatArray, forces_N: FloatArray) -> GripWeight:
    """The plane through holding forces (n, 3), by least squares: at least five poses that lie in no plane."""
    count = places_m.shape[0]
    design = np.column_stack([np.ones(count), places_m - np.array(MIDDLE_M)])
    solution, *_ = np.linalg.lstsq(design, forces_N, rcond=None)
    left = forces_N - design @ solution
    variance = float((left**2).sum()) / (3 * (count - design.shape[1]))
    x, y, z = (float(value) for value in solution[0])
    return GripWeight(
        weight_N=(x, y, z),
        slope_N_per_m=tuple((float(a), float(b), float(c)) for a, b, c in solution[1:].T),
        residual_N=float(np.sqrt((left**2).mean())),
        stderr_N=float(np.sqrt(variance * np.linalg.inv(design.T @ design)[0, 0])),
        poses=count,
    )
