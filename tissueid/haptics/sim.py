"""Devices that are computed: an arm in a hand, behind encoders that round and a wire that delays; a log.

Equal settings and forces give equal samples, bit for bit.  In virtual time no clock is read: each
``write_force`` lets one period pass.  One mass in all directions, no gravity, no stops; positions are rounded
along x, y and z, not at the legs, and no bytes are exchanged (the emulator has both).  SI units.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import tick_kernel, tick_part
from tissueid.errors import DeviceError, refuse
from tissueid.haptics import shared_hand as layout
from tissueid.haptics.arm import ARM_MEMORY, HAND_FORCE, POSITION, TIME, Arm, arm_step, new_arm
from tissueid.haptics.device import (
    HOMED,
    REPLY,
    STEP_M,
    Access,
    Capabilities,
    CompiledIO,
    DetectedDevice,
    DeviceSample,
    HapticDevice,
    register,
    steps_of,
)
from tissueid.haptics.guard import REPLY_VALID
from tissueid.haptics.hand import Hand
from tissueid.haptics.limits import DEFAULT_DELAY_TICKS, GuardLimits
from tissueid.haptics.shared_hand import SharedHand

# --- memory behind the arm's
FELT = ARM_MEMORY  # force at the grip now: 3
HEAD, PENDING, LOST = ARM_MEMORY + 3, ARM_MEMORY + 4, ARM_MEMORY + 5
#: Forces under way: time of arrival and three components each.
QUEUE = ARM_MEMORY + 6
QUEUE_COLUMNS = 4
#: A delay of more ticks than this loses forces; :class:`~tissueid.haptics.sim.SimulatedDevice` refuses it.
QUEUE_LENGTH = 32
SIM_MEMORY = QUEUE + QUEUE_COLUMNS * QUEUE_LENGTH


@tick_part
def simulated_sample(
    memory: FloatArray, parameters: FloatArray, position: FloatArray, counts: IntArray
) -> None:
    """Write counts (3,) and their position (3,) [m]."""
    quantum = parameters[layout.QUANTUM]
    for i in range(3):
        counts[i] = math.floor(memory[POSITION + i] / quantum + parameters[layout.PHASE + i])
        # the middle of the count, so that rounding has no mean
        position[i] = (counts[i] + 0.5 - parameters[layout.PHASE + i]) * quantum


@tick_part
def simulated_command(memory: FloatArray, parameters: FloatArray, force: FloatArray) -> None:
    """Send a force [N]; it is felt ``delay_s`` later."""
    pending = int(memory[PENDING])
    if pending >= QUEUE_LENGTH:
        memory[LOST] += 1.0
        return
    at = QUEUE + QUEUE_COLUMNS * ((int(memory[HEAD]) + pending) % QUEUE_LENGTH)
    memory[at] = memory[TIME] + parameters[layout.DELAY]
    for i in range(3):
        memory[at + 1 + i] = force[i]
    memory[PENDING] = pending + 1


@tick_kernel
def simulated_advance(memory: FloatArray, parameters: FloatArray, dt: float) -> None:
    """Let ``dt`` seconds pass: forces arrive, the arm moves."""
    end = memory[TIME] + dt
    felt = memory[FELT : FELT + 3]
    while memory[PENDING] > 0.0:
        head = int(memory[HEAD])
        at = QUEUE + QUEUE_COLUMNS * head
        arrival = memory[at]
        if arrival > end:
            break
        arm_step(memory, parameters, felt, arrival - memory[TIME])
        for i in range(3):
            felt[i] = memory[at + 1 + i]
        memory[HEAD] = (head + 1) % QUEUE_LENGTH
        memory[PENDING] -= 1.0
    arm_step(memory, parameters, felt, end - memory[TIME])


class SimulatedIO(NamedTuple):
    """Blocks of :mod:`tissueid.haptics.sim`."""

    parameters: FloatArray
    memory: FloatArray


@tick_kernel
def _sense(io: SimulatedIO, dt: float, position: FloatArray, counts: IntArray, words: IntArray) -> None:
    """Let the arm move for ``dt`` and read its encoders."""
    simulated_advance(io.memory, io.parameters, dt)
    simulated_sample(io.memory, io.parameters, position, counts)
    words[REPLY], words[HOMED] = REPLY_VALID, 1


@tick_kernel
def _command(io: SimulatedIO, _guard: FloatArray, _limits: FloatArray, force: FloatArray) -> None:
    """Put the force on its way."""
    simulated_command(io.memory, io.parameters, force)


#: The simulated device.
SIMULATED = register(
    Access(SimulatedIO, lambda given: SimulatedIO(given.constants, given.memory), _sense, _command)
)


#: One count of a Falcon's encoders is 38 to 48 um at the grip.
DEFAULT_QUANTUM_M = STEP_M
DEFAULT_PERIOD_S = 1e-3
#: Centre of the largest sphere a Falcon reaches, and the radius that is used of it [m].
CENTRE_M = (0.0, 0.0, 0.130)
WORKING_RADIUS_M = 0.040
#: Change of force [N] that no guard lets through: the watchdog for frozen encoders then never bites.
NO_CHANGE_N = 1e3


def carried(limits: GuardLimits) -> GuardLimits:
    """Limits for a grip that is carried exactly: it may rest while the force on it changes."""
    return replace(limits, frozen_change_N=NO_CHANGE_N)


def computed(device: HapticDevice, *, damping_N_s_per_m: float, delay_ticks: float) -> Capabilities:
    """Abilities of a device that is computed: its newtons are exact, and nothing moves."""
    (x, y, z), r = CENTRE_M, WORKING_RADIUS_M
    return Capabilities(
        name=device.name,
        clamp_N=device.limits.clamp_N,
        calibrated=True,
        damping_N_s_per_m=damping_N_s_per_m,
        delay_ticks=delay_ticks,
        workspace_m=((x - r, x + r), (y - r, y + r), (z - r, z + r)),
        hardware=False,
    )


class SimulatedDevice(HapticDevice):
    """Simulated device: 5 N and no dead-man button, and a hand that rests at the centre, by default.

    ``real_time``: move with ``clock`` instead of with the forces written; ``quantum_m``: resolution [m];
    ``delay_ticks``: from sample to felt force; ``seed``: of where the counts lie relative to the workspace.
    """

    name = "sim"

    def __init__(
        self,
        limits: GuardLimits | None = None,
        *,
        arm: Arm | None = None,
        hand: Hand | None = None,
        real_time: bool = False,
        quantum_m: float = DEFAULT_QUANTUM_M,
        delay_ticks: float = DEFAULT_DELAY_TICKS,
        period_s: float = DEFAULT_PERIOD_S,
        seed: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        limits = limits or GuardLimits.simulated()
        super().__init__(carried(limits) if hand is not None and hand.rigid else limits)
        if not (quantum_m > 0.0 and period_s > 0.0 and 0.0 <= delay_ticks <= QUEUE_LENGTH - 2):
            raise ValueError(
                f"a simulated device needs a positive quantum and period, and a delay of 0 to "
                f"{QUEUE_LENGTH - 2} ticks; they are {quantum_m}, {period_s} and {delay_ticks}"
            )
        self.arm = arm or Arm()
        self.hand = hand or Hand((0.0,), (CENTRE_M,), (1.0,))
        self.period_s = period_s
        self.delay_ticks = delay_ticks
        self.real_time = real_time
        #: Flat blocks of :mod:`tissueid.haptics.sim`; the compiled servo works on the same.
        self.parameters = np.zeros(layout.SIM_PARAMETERS)
        block = self.hand.write(self.arm.block())
        self.parameters[: block.size] = block
        self.parameters[layout.QUANTUM] = quantum_m
        self.parameters[layout.PHASE : layout.PHASE + 3] = np.random.default_rng(seed).random(3)
        self.parameters[layout.DELAY] = delay_ticks * period_s
        self.memory = np.zeros(SIM_MEMORY)
        self.memory[:ARM_MEMORY] = new_arm(self.hand.start_m)
        self._clock = clock
        self._clock_s: float | None = None

    @classmethod
    def detect(cls) -> list[DetectedDevice]:
        """It is always there."""
        return [DetectedDevice(cls.name, "this program")]

    @property
    def capabilities(self) -> Capabilities:
        """Of the arm as it is computed: newtons are exact here."""
        return computed(self, damping_N_s_per_m=self.arm.damping_N_s_per_m, delay_ticks=self.delay_ticks)

    @property
    def time_s(self) -> float:
        """Time of the device [s]."""
        return float(self.memory[TIME])

    @property
    def true_position_m(self) -> FloatArray:
        """Position before it is rounded [m], shape (3,)."""
        return self.memory[POSITION : POSITION + 3].copy()

    @property
    def sensed_force_N(self) -> FloatArray:
        """Force of the hand on the grip now [N], shape (3,): an ideal sensor, which a Falcon has not."""
        return self.memory[HAND_FORCE : HAND_FORCE + 3].copy()

    def share(self, hand: SharedHand) -> None:
        """Work on parameters in shared memory from now on, so that another process can lead the hand."""
        hand.parameters[:] = self.parameters
        self.parameters = hand.parameters

    def compiled(self) -> CompiledIO:
        """The blocks of this device, for a compiled loop."""
        return CompiledIO("tissueid.haptics.sim:SIMULATED", constants=self.parameters, memory=self.memory)

    def _open(self) -> None:
        self._clock_s = None

    def _close(self) -> None:
        """Nothing to let go of."""

    def _read(self) -> DeviceSample:
        if self.real_time:
            now = self._clock()
            if self._clock_s is not None:
                simulated_advance(self.memory, self.parameters, now - self._clock_s)
            self._clock_s = now
        place, counts = np.zeros(3), np.zeros(3, np.int64)
        simulated_sample(self.memory, self.parameters, place, counts)
        return DeviceSample(self.time_s, place, counts, buttons=0, homed=True, valid=True)

    def _write(self, force_N: FloatArray) -> None:
        simulated_command(self.memory, self.parameters, force_N)
        if not self.real_time:
            simulated_advance(self.memory, self.parameters, self.period_s)


class ReplayDevice(HapticDevice):
    """A device that moves as a log did, ``render --replay LOG``; DeviceError where it holds no motion.

    Between two records it is on their line, outside them at rest; no force changes the motion.
    """

    name = "replay"

    def __init__(
        self,
        limits: GuardLimits | None = None,
        *,
        log: str | os.PathLike[str] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(carried(limits or GuardLimits.simulated()))
        self._clock = clock
        self._started_s: float | None = None
        self._log = log
        if log is not None:
            self._load(Path(log))

    @classmethod
    def detect(cls) -> list[DetectedDevice]:
        """It is there where a log is named."""
        return [DetectedDevice(cls.name, "this program", "needs the log of a session: --replay LOG")]

    @property
    def capabilities(self) -> Capabilities:
        """Of a motion that no force changes: nothing to hurt, nothing to damp."""
        return computed(self, damping_N_s_per_m=np.inf, delay_ticks=0.0)

    def _load(self, path: Path) -> None:
        from tissueid.store.session_log import read_session_log

        records = read_session_log(path).records
        times = np.asarray(records["time_s"], dtype=np.float64)
        places = np.asarray(records["position_m"], dtype=np.float64)
        sound = np.isfinite(times) & np.isfinite(places).all(axis=1)
        times, places = times[sound], places[sound]
        if times.size < 2 or (np.diff(times) <= 0.0).any():
            msg = f"{path}: its {times.size} usable records hold no motion that goes forward in time"
            raise DeviceError(msg)
        self._time_s, self._position_m = times - times[0], places
        self._buttons = np.zeros(times.size, np.int64)
        if "buttons" in (records.dtype.names or ()):
            self._buttons = records["buttons"][sound].astype(np.int64)

    def _open(self) -> None:
        if self._log is None:
            refuse("replay: no log was named; give one with --replay LOG")
        self._started_s = None

    def _close(self) -> None:
        """Nothing to let go of."""

    def _read(self) -> DeviceSample:
        if self._started_s is None:
            self._started_s = self._clock()
        now = self._clock() - self._started_s
        place = np.array([np.interp(now, self._time_s, self._position_m[:, axis]) for axis in range(3)])
        at = int(np.searchsorted(self._time_s, now, side="right")) - 1
        return DeviceSample(
            time_s=now,
            position_m=place,
            counts=steps_of(place),
            buttons=int(self._buttons[at]),
            homed=True,
            valid=True,
        )

    def _write(self, force_N: FloatArray) -> None:
        """No force changes a recorded motion."""
