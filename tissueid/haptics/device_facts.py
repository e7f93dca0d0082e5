"""Facts, samples and needs of a device, as frozen data: nothing here moves."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tissueid.arrays import FloatArray, IntArray

#: Integers of :attr:`CompiledIO.handles`.
HANDLES_SIZE = 8


@dataclass(frozen=True, slots=True)
class AskedDevice:
    """Options that a user gave on the way to a device."""

    port: str | None = None  # serial port or pseudo-terminal instead of USB
    firmware: str | None = None  # a file
    calibration: Path | None = None  # a file instead of the user's own
    hands_off: bool = False  # the grip moves by itself, in a measurement of the free device
    homing_timeout_s: float | None = None

    def given(self) -> tuple[str, ...]:
        """Names of those that not every device has."""
        named = {"port": self.port, "firmware": self.firmware, "calibration": self.calibration}
        return tuple(name for name, value in named.items() if value is not None)


@dataclass(frozen=True, slots=True)
class DetectedDevice:
    """A device that could be opened, or the reason why not."""

    name: str  # name in the registry
    where: str  # USB node, file or "this program"
    note: str = ""  # what stands in the way and how to remove it; empty if nothing does


@dataclass(frozen=True, slots=True)
class DeviceSample:
    """One reading."""

    time_s: float  # CLOCK_MONOTONIC [s], or the device's virtual time
    position_m: FloatArray  # (3,)
    counts: IntArray  # (3,), encoder counts; zeros where a device has none
    buttons: int
    homed: bool
    valid: bool  # whether a whole reply came; without one the other fields repeat the last
    damaged: int = 0  # damaged replies dropped since the last reading


@dataclass(frozen=True, slots=True)
class Capabilities:
    """Abilities of a device, and if anybody measured them."""

    name: str
    clamp_N: float  # largest force the guard lets through [nominal N]
    calibrated: bool  # whether that newton was weighed on this unit
    damping_N_s_per_m: float  # viscous damping of the arm
    delay_ticks: float  # from a position to the force it causes
    #: Least and largest x, y and z [m].
    workspace_m: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    hardware: bool = True  # whether motors move something: then consent and the dead-man button are asked for


@dataclass(frozen=True, slots=True)
class CompiledIO:
    """Handles and constants by which the compiled servo reaches a device without Python."""

    kind: str  # ``module:name`` of the :class:`~tissueid.haptics.servo_access.Access` that takes them
    #: (HANDLES_SIZE,): descriptors, addresses and identities.
    handles: IntArray = field(default_factory=lambda: np.zeros(HANDLES_SIZE, np.int64))
    constants: FloatArray = field(default_factory=lambda: np.zeros(1))
    memory: FloatArray = field(default_factory=lambda: np.zeros(1))  # changed by the loop
