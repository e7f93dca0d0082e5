"""Damping, mass and friction of a device's arm, from how it swings on a weak spring that the device makes.

The spring's rest point jumps to and fro along z.  Over windows momentum is balanced, linear in mass m,
damping b, friction c and a constant d (weight): ``m dv = integral of F dt - b dz - c integral of sign(v) dt +
d dt``. F is shifted by the delay: a spring of stiffness K felt late would else pass for a damping of -K
delay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError
from tissueid.haptics.device import HapticDevice
from tissueid.haptics.measure.motion import Motion, Pace, engage, record, wait_for

ALONG = 2
MIDDLE_M = np.array([0.0, 0.0, 0.130])
#: Spring along z; spring and damper that keep the grip on the axis [N/m, N/m, N s/m].
SOFT, STIFF, SIDE_DAMPING = 60.0, 150.0, 2.0
#: Half a jump of the rest point [m], time between two [s], and how many.
JUMP_M, REST_S, JUMPS = 0.010, 1.5, 8
#: Time in which the rest point goes to the middle first [s].
APPROACH_S = 2.0
#: Damping that a delay wrong by half a tick takes or gives, SOFT times 0.5 ms [N s/m].
SYSTEMATIC = SOFT * 5e-4
#: Half width of the parabola that gives velocities, and length of a window [samples].
HALF_WIDTH, WINDOW = 12, 30
#: Slower than this the direction of the motion, and with it friction, is not known [m/s].
SLOW = 0.010


@dataclass(frozen=True)
class ArmEstimate:
    """Mechanics of the arm along z.  Damping is known no better than the delay, see :data:`SYSTEMATIC`."""

    mass_kg: float
    damping_N_s_per_m: float
    friction_N: float
    damping_stderr: float  # from the spread between the jumps

    @property
    def safe_damping(self) -> float:
        """Damping to rely on [N s/m]: less two standard errors and what delay may hide, never negative."""
        return max(self.damping_N_s_per_m - 2.0 * self.damping_stderr - SYSTEMATIC, 0.0)


def ring_down(device: HapticDevice, delay_s: float, pace: Pace = wait_for) -> ArmEstimate:
    """Let the free grip of a homed device swing, and estimate its mechanics.

    ``delay_s``: from a position to the force it causes [s]; the dead-man button is off, since a hand would be
    measured too.  Raises DeviceError: the grip does not swing, or a fault.
    """
    engage(device, pace)
    start = device.read().position_m

    def law(time_s: float, position: FloatArray, velocity: FloatArray) -> FloatArray:
        share = min(time_s / APPROACH_S, 1.0)
        rest = start + share * (MIDDLE_M - start)
        if time_s > APPROACH_S:
            jump = math.floor((time_s - APPROACH_S) / REST_S)
            rest[ALONG] += JUMP_M if jump % 2 == 0 else -JUMP_M
        force = STIFF * (rest - position) - SIDE_DAMPING * velocity
        force[ALONG] = SOFT * (rest[ALONG] - position[ALONG])
        return np.asarray(force)

    motion = record(device, law, APPROACH_S + JUMPS * REST_S, pace)
    device.disengage()
    return estimate_arm(motion, delay_s)


def estimate_arm(motion: Motion, delay_s: float) -> ArmEstimate:
    """Mass, damping and friction from a recorded swing; DeviceError if the grip did not move enough."""
    balances = [_balance(motion, APPROACH_S + jump * REST_S, delay_s) for jump in range(JUMPS)]
    rows = np.concatenate([left for left, _ in balances])
    right = np.concatenate([force for _, force in balances])
    if len(right) < 4 * JUMPS:
        msg = "the grip hardly moved: is it free, and the device engaged?"
        raise DeviceError(msg)
    mass, damping, friction, _ = np.linalg.lstsq(rows, right, rcond=None)[0]
    # the windows of one jump share errors: leave each jump out in turn
    without = [
        np.linalg.lstsq(
            np.concatenate([left for k, (left, _) in enumerate(balances) if k != jump]),
            np.concatenate([force for k, (_, force) in enumerate(balances) if k != jump]),
            rcond=None,
        )[0][1]
        for jump in range(JUMPS)
    ]
    stderr = math.sqrt((JUMPS - 1) * float(np.var(without)))
    if not mass > 0.0:
        msg = f"the swing makes no sense (a mass of {mass:.3f} kg): was a hand on the grip?"
        raise DeviceError(msg)
    return ArmEstimate(float(mass), float(damping), float(friction), stderr)


def _balance(motion: Motion, begin: float, delay_s: float) -> tuple[FloatArray, FloatArray]:
    """Rows ``(dv, dz, integral of sign(v), -dt)`` and impulses of the windows of one jump."""
    inside = np.flatnonzero((motion.time_s >= begin) & (motion.time_s < begin + REST_S))
    time = motion.time_s[inside]
    place, speed = _smooth(time, motion.position_m[inside, ALONG])
    impulse = _impulse(motion, time - delay_s)
    rows, right = [], []
    last = len(time) - HALF_WIDTH - 1
    for i in range(HALF_WIDTH, last - WINDOW, WINDOW):
        j = i + WINDOW
        # a window in which the grip turns or rests has no direction
        if np.min(np.abs(speed[i : j + 1])) < SLOW:
            continue
        dt = time[j] - time[i]
        rows.append([speed[j] - speed[i], place[j] - place[i], math.copysign(dt, speed[i]), -dt])
        right.append(impulse[j] - impulse[i])
    return np.array(rows).reshape(-1, 4), np.array(right)


def _smooth(time: FloatArray, place: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Position and velocity by a parabola through the neighbours of each sample; none near the ends."""
    width = 2 * HALF_WIDTH + 1
    middle = slice(HALF_WIDTH, len(time) - HALF_WIDTH)
    near = sliding_window_view(time, width) - time[middle, None]
    # in units of the window's length, so that the powers are of one size
    scale = near[:, -1:] - near[:, :1]
    powers = (near / scale)[:, :, None] ** np.arange(3)
    left = np.einsum("nij,nik->njk", powers, powers)
    right = np.einsum("nij,ni->nj", powers, sliding_window_view(place, width))
    found = np.linalg.solve(left, right[:, :, None])[:, :, 0]
    smooth, speed = place.copy(), np.zeros_like(place)
    smooth[middle], speed[middle] = found[:, 0], found[:, 1] / scale[:, 0]
    return smooth, speed


def _impulse(motion: Motion, time: FloatArray) -> FloatArray:
    """Integral of the sent force along z up to some times; each force holds until the next."""
    steps = np.diff(motion.time_s)
    total = np.concatenate([[0.0], np.cumsum(motion.force_N[:-1, ALONG] * steps)])
    return np.asarray(np.interp(time, motion.time_s, total))
