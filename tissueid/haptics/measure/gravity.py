"""The weight of the grip, pose by pose: the force that holds it still at places all over the workspace.

At each pose the grip is held by a spring with an integrating part and led to and fro a few millimetres along
a diagonal: over whole periods friction takes as much as it gives along every axis, so that the mean of the
force sent is what holds the grip.  Arms that lift with the grip, and a cable, make that force change from
place to place; a plane through the poses is kept::

    F(p) = w + S (p - middle)
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.haptics.device import HapticDevice
from tissueid.haptics.measure.motion import Pace, engage, record, wait_for

#: Middle of the workspace, and the corners of a cube around it [m].
MIDDLE_M = (0.0, 0.0, 0.130)
REACH_M = 0.02
POSES_M = (
    MIDDLE_M,
    *(
        tuple(np.add(MIDDLE_M, np.multiply(REACH_M, corner)).tolist())
        for corner in product((-1, 1), repeat=3)
    ),
)
#: Spring, damper and integrating part that hold it [N/m, N s/m, N/(m s)]: slow beside 1.5 ticks of delay.
STIFFNESS, DAMPING, INTEGRAL = 150.0, 2.0, 300.0
#: The setpoint goes to a pose in this time, then swings by this much and this often [s, m, s].
APPROACH_S, SWING_M, PERIOD_S = 1.5, 0.004, 1.0
#: Periods that are left out and used.
SETTLING, PERIODS = 2, 2
DIAGONAL = np.full(3, 3.0**-0.5)


@dataclass(frozen=True)
class GripWeight:
    """Result of :func:`weigh_poses`."""

    #: Force that holds the grip in the middle of the workspace, nominal [N].
    weight_N: tuple[float, float, float]
    #: Its change with the position: a row a component of the force.
    slope_N_per_m: tuple[tuple[float, float, float], ...]
    residual_N: float  # root mean square of what the plane leaves
    stderr_N: float  # standard error of a component in the middle
    poses: int


def weigh_poses(device: HapticDevice, pace: Pace = wait_for) -> GripWeight:
    """Hold the grip at every pose.

    ``device``: homed; its dead-man button off, since no hand may hold the grip; ``pace``: how to wait for the
    next tick.  Raises DeviceError: on a fault, or when the device is lost.
    """
    engage(device, pace)
    holder = _Holder(device.read().position_m)
    places, forces = [], []
    for pose in POSES_M:
        holder.go(np.array(pose))
        motion = record(device, holder, APPROACH_S + (SETTLING + PERIODS) * PERIOD_S, pace)
        used = motion.time_s >= APPROACH_S + SETTLING * PERIOD_S
        steps = np.diff(motion.time_s[used], append=motion.time_s[-1])
        places.append(np.average(motion.position_m[used], axis=0, weights=steps))
        forces.append(np.average(motion.force_N[used], axis=0, weights=steps))
    device.disengage()
    return fitted(np.array(places), np.array(forces))


def fitted(places_m: FloatArray, forces_N: FloatArray) -> GripWeight:
    """The plane through holding forces, by least squares.

    ``places_m``, ``forces_N`` (n, 3): at least five poses that lie in no plane.
    """
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


class _Holder:
    """The holding law; its integral goes on from pose to pose."""

    def __init__(self, start: FloatArray) -> None:
        self._from = self._to = start.copy()
        self._integral = np.zeros(3)
        self._before = 0.0

    def go(self, pose: FloatArray) -> None:
        """Take another pose as the next one."""
        self._from, self._to, self._before = self._to, pose, 0.0

    def __call__(self, time_s: float, position: FloatArray, velocity: FloatArray) -> FloatArray:
        share = min(time_s / APPROACH_S, 1.0)
        wanted = self._from + share * (self._to - self._from)
        swing = np.sin(2.0 * np.pi * max(time_s - APPROACH_S, 0.0) / PERIOD_S)
        error = wanted + SWING_M * swing * DIAGONAL - position
        self._integral += INTEGRAL * error * (time_s - self._before)
        self._before = time_s
        return np.asarray(STIFFNESS * error - DAMPING * velocity + self._integral)
