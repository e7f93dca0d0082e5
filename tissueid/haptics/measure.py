"""Measurements on a user's device: its link, its newton by a mass, its grip's weight, its arm's mechanics.

Weighing leads the grip to and fro: over whole periods friction takes as much as it gives.  Mass m, damping b
and friction c come from how it swings on a weak spring whose rest point jumps along z: over windows
``m dv = integral of F dt - b dz - c integral of sign(v) dt + d dt``, with F shifted by the delay: a spring of
stiffness K felt late would else pass for a damping of -K delay.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tissueid.arrays import FloatArray
from tissueid.documents.devices import Test
from tissueid.errors import DeviceError
from tissueid.haptics.device import HapticDevice
from tissueid.haptics.guard import velocity_step
from tissueid.haptics.states import FAULT_WORDS, Fault, State

#: ``law(time since the start [s], position [m], velocity [m/s]) -> force [N]``.
Law = Callable[[float, FloatArray, FloatArray], FloatArray]

#: Tick of the servo [s].
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


def record(device: HapticDevice, law: Law, duration_s: float) -> Motion:
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
            raise DeviceError(f"{device.name}: {FAULT_WORDS[device.fault]}")
        if last is None:
            last, begin, before = sample.position_m.copy(), sample.time_s, sample.time_s - TICK_S
        dt = sample.time_s - before
        before = sample.time_s
        velocity_step(velocity, sample.position_m, last, dt)
        now = sample.time_s - begin
        times.append(now)
        positions.append(sample.position_m.copy())
        forces.append(device.write_force(law(now, sample.position_m, velocity), dt))
        wait_for(before + TICK_S)
    return Motion(np.array(times), np.array(positions), np.array(forces))


def no_force(_time_s: float, _position: FloatArray, _velocity: FloatArray) -> FloatArray:
    """The law of free air."""
    return np.zeros(3)


def engage(device: HapticDevice) -> None:
    """Ask for force and wait through the start-up ramp; DeviceError if the guard does not engage."""
    device.engage()
    waited = 0.0
    while device.state is not State.ENGAGED and waited < ENGAGE_S:
        record(device, no_force, 0.0)
        waited += TICK_S
    if device.state is not State.ENGAGED:
        msg = f"{device.name}: no force within {ENGAGE_S:g} s: is it homed, and the dead-man button held?"
        raise DeviceError(msg)
    record(device, no_force, RAMP_S)


#: After this time an answer is lost, not late [s].
PATIENCE_S = 0.05
#: Share of the answers that make the delay: the slowest are stalls of this machine, which the guard sees to.
USUAL_SHARE = 0.95
#: What passes inside the device, between wire, encoders and motors, is not seen here: allowed for [ticks].
UNSEEN_TICKS = 0.5


def measure_link(device: HapticDevice, duration_s: float = 5.0) -> Test:
    """Send zero force and wait for the answer, over and over; DeviceError where none comes, or it is lost.

    The delay is from a position to the force it causes, in a loop of 1 kHz that reads at each tick what was
    answered to the last; the slowest 5 % are left out.
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
        raise DeviceError(f"the device answered none of {commands} commands; is its power supply plugged in?")
    median, high, largest = np.quantile(trips, [0.5, 0.95, 1.0])
    usual = sorted(trips)[: math.ceil(USUAL_SHARE * len(trips))]
    ticks = np.mean([max(1, math.ceil(trip / TICK_S)) for trip in usual])
    return Test(
        name=device.name,
        duration_s=elapsed,
        commands=commands,
        replies=len(trips),
        damaged=damaged,
        rate_hz=len(trips) / elapsed,
        round_trip_ms=(1e3 * float(median), 1e3 * float(high), 1e3 * float(largest)),
        delay_ticks=float(ticks) + UNSEEN_TICKS,
    )


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


def weigh(device: HapticDevice, mass_kg: float, hang: Callable[[], None]) -> Weighing:
    """Hold the grip, then the grip with a mass: the difference is the mass alone.

    ``device``: homed; its dead-man button off, since no hand may hold the grip; ``hang``: returns when the
    user has hung the mass on the grip.  Raises DeviceError: the clamp is reached, the mass is not felt, or a
    fault.
    """
    empty = _held(device)
    device.disengage()
    record(device, no_force, PERIOD_S)
    hang()
    loaded = _held(device)
    device.disengage()
    weight = mass_kg * GRAVITY
    difference = float(np.mean(loaded) - np.mean(empty))
    error = math.sqrt((np.var(loaded, ddof=1) + np.var(empty, ddof=1)) / PERIODS)
    if not difference > 4.0 * error:
        raise DeviceError(
            f"the mass was not felt: the grip was held with {np.mean(empty):.2f} N without it and "
            f"{np.mean(loaded):.2f} N with it; does it hang freely on the grip?"
        )
    held = float(np.mean(empty)), float(np.mean(loaded))
    return Weighing(*held, weight, difference / weight, error / weight)


def _held(device: HapticDevice) -> FloatArray:
    """Mean upward force of each period, shape (PERIODS,)."""
    engage(device)
    holder = _Holder(device.read().position_m, APPROACH_S, PERIOD_S, np.eye(3)[UP], np.eye(3)[UP])
    holder.go(np.array(MIDDLE_M))
    try:
        motion = record(device, holder, APPROACH_S + (SETTLING + PERIODS) * PERIOD_S)
    except DeviceError as error:
        if device.fault is not Fault.ENCODER_FROZEN:
            raise
        msg = f"{device.limits.clamp_N:.2f} N, all that the guard allows, did not lift the grip: {LIGHTER}"
        raise DeviceError(msg) from error
    clamp = device.limits.clamp_N
    clipped = np.mean(np.linalg.norm(motion.force_N, axis=1) > NEARLY * clamp)
    if clipped > MOST_CLIPPED:
        raise DeviceError(
            f"the grip needs the whole {clamp:.2f} N that the guard allows, {100 * clipped:.0f} % of the "
            f"time: {LIGHTER}"
        )
    begins = APPROACH_S + PERIOD_S * np.arange(SETTLING, SETTLING + PERIODS)
    return np.array([_means(motion, begin, begin + PERIOD_S)[1, UP] for begin in begins])


def _means(motion: Motion, begin_s: float, end_s: float) -> FloatArray:
    """Mean position and force over a stretch of time, shape (2, 3); a force holds until the next tick."""
    inside = np.flatnonzero((motion.time_s >= begin_s) & (motion.time_s < end_s))
    steps = np.diff(motion.time_s[inside])
    both = np.stack([motion.position_m, motion.force_N])[:, inside[:-1]]
    return np.asarray(np.average(both, axis=1, weights=steps))


def weigh_poses(device: HapticDevice) -> GripWeight:
    """Hold the free grip of a homed device, no dead-man button, at every pose; DeviceError on a fault."""
    engage(device)
    diagonal = np.full(3, 3.0**-0.5)
    holder = _Holder(device.read().position_m, POSE_APPROACH_S, POSE_PERIOD_S, diagonal, np.ones(3))
    settled_s = POSE_APPROACH_S + POSE_SETTLING * POSE_PERIOD_S
    means = []
    for pose in POSES_M:
        holder.go(np.array(pose))
        motion = record(device, holder, settled_s + POSE_PERIODS * POSE_PERIOD_S)
        means.append(_means(motion, settled_s, math.inf))
    device.disengage()
    places, forces = np.array(means).transpose(1, 0, 2)
    return fitted(places, forces)


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


ALONG = 2
#: Spring along z; spring and damper that keep the grip on the axis [N/m, N/m, N s/m].
SOFT, STIFF, SIDE_DAMPING = 60.0, 150.0, 2.0
#: Half a jump of the rest point [m], time between two [s], and how many.
JUMP_M, REST_S, JUMPS = 0.010, 1.5, 8
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


def ring_down(device: HapticDevice, delay_s: float) -> ArmEstimate:
    """Let the free grip of a homed device swing, and estimate its mechanics.

    ``delay_s``: from a position to the force it causes [s]; the dead-man button is off, since a hand would be
    measured too.  Raises DeviceError: the grip does not swing, or a fault.
    """
    engage(device)
    start = device.read().position_m

    def law(time_s: float, position: FloatArray, velocity: FloatArray) -> FloatArray:
        share = min(time_s / APPROACH_S, 1.0)
        rest = start + share * (np.array(MIDDLE_M) - start)
        if time_s > APPROACH_S:
            jump = math.floor((time_s - APPROACH_S) / REST_S)
            rest[ALONG] += JUMP_M if jump % 2 == 0 else -JUMP_M
        force = STIFF * (rest - position) - SIDE_DAMPING * velocity
        force[ALONG] = SOFT * (rest[ALONG] - position[ALONG])
        return np.asarray(force)

    motion = record(device, law, APPROACH_S + JUMPS * REST_S)
    device.disengage()
    return estimate_arm(motion, delay_s)


def estimate_arm(motion: Motion, delay_s: float) -> ArmEstimate:
    """Mass, damping and friction from a recorded swing; DeviceError if the grip did not move enough."""
    balances = [_balance(motion, APPROACH_S + jump * REST_S, delay_s) for jump in range(JUMPS)]
    rows = np.concatenate([left for left, _ in balances])
    right = np.concatenate([force for _, force in balances])
    if len(right) < 4 * JUMPS:
        raise DeviceError("the grip hardly moved: is it free, and the device engaged?")
    mass, damping, friction, _ = np.linalg.lstsq(rows, right, rcond=None)[0]
    # the windows of one jump share errors: leave each jump out in turn
    of_jump = np.repeat(np.arange(JUMPS), [force.size for _, force in balances])
    without = [
        np.linalg.lstsq(rows[of_jump != jump], right[of_jump != jump], rcond=None)[0][1]
        for jump in range(JUMPS)
    ]
    stderr = math.sqrt((JUMPS - 1) * float(np.var(without)))
    if not mass > 0.0:
        raise DeviceError(f"the swing makes no sense (a mass of {mass:.3f} kg): was a hand on the grip?")
    return ArmEstimate(float(mass), float(damping), float(friction), stderr)


def _balance(motion: Motion, begin: float, delay_s: float) -> tuple[FloatArray, FloatArray]:
    """Rows ``(dv, dz, integral of sign(v), -dt)`` and impulses of the windows of one jump."""
    inside = np.flatnonzero((motion.time_s >= begin) & (motion.time_s < begin + REST_S))
    time = motion.time_s[inside]
    place, speed = _smooth(time, motion.position_m[inside, ALONG])
    # of the sent force, each of which holds until the next
    sent = np.concatenate([[0.0], np.cumsum(motion.force_N[:-1, ALONG] * np.diff(motion.time_s))])
    impulse = np.interp(time - delay_s, motion.time_s, sent)
    begins = np.arange(HALF_WIDTH, len(time) - HALF_WIDTH - 1 - WINDOW, WINDOW)
    # a window in which the grip turns or rests has no direction
    i = begins[sliding_window_view(np.abs(speed), WINDOW + 1)[begins].min(axis=1) >= SLOW]
    j = i + WINDOW
    dt = time[j] - time[i]
    rows = np.column_stack([speed[j] - speed[i], place[j] - place[i], np.copysign(dt, speed[i]), -dt])
    return rows, impulse[j] - impulse[i]


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
