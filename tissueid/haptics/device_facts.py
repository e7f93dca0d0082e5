"""Facts, samples and needs of a device, as frozen data: nothing here moves."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "HANDLES_SIZE",
    "AskedDevice",
    "Capabilities",
    "CompiledIO",
    "DetectedDevice",
    "DeviceSample",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Integers of :attr:`CompiledIO.handles`.
HANDLES_SIZE = 8


@dataclass(frozen=True, slots=True)
class AskedDevice:
    """Options that a user gave on the way to a device.

    Attributes
    ----------
    port : str or None
        Serial port or pseudo-terminal instead of USB.
    firmware : str or None
        A file.
    calibration : Path or None
        A file instead of the user's own.
    hands_off : bool
        The grip moves by itself, in a measurement of the free device.
    homing_timeout_s : float or None
    """

    port: str | None = None
    firmware: str | None = None
    calibration: Path | None = None
    hands_off: bool = False
    homing_timeout_s: float | None = None

    def given(self) -> tuple[str, ...]:
        """Names of those that not every device has."""
        named = {"port": self.port, "firmware": self.firmware, "calibration": self.calibration}
        return tuple(name for name, value in named.items() if value is not None)


@dataclass(frozen=True, slots=True)
class DetectedDevice:
    """A device that could be opened, or the reason why not.

    Attributes
    ----------
    name : str
        Name in the registry.
    where : str
        USB node, file or "this program".
    note : str
        What stands in the way and how to remove it; empty if nothing does.
    """

    name: str
    where: str
    note: str = ""


@dataclass(frozen=True, slots=True)
class DeviceSample:
    """One reading.

    Attributes
    ----------
    time_s : float
        CLOCK_MONOTONIC [s], or the device's virtual time.
    position_m : ndarray, shape (3,)
    counts : ndarray of int64, shape (3,)
        Encoder counts; zeros where a device has none.
    buttons : int
    homed : bool
    valid : bool
        Whether a whole reply came; without one the other fields repeat the last.
    damaged : int
        Damaged replies dropped since the last reading.
    """

    time_s: float
    position_m: FloatArray
    counts: IntArray
    buttons: int
    homed: bool
    valid: bool
    damaged: int = 0


@dataclass(frozen=True, slots=True)
class Capabilities:
    """Abilities of a device, and if anybody measured them.

    Attributes
    ----------
    name : str
    clamp_N : float
        Largest force the guard lets through [nominal N].
    calibrated : bool
        Whether that newton was weighed on this unit.
    damping_N_s_per_m : float
        Viscous damping of the arm.
    delay_ticks : float
        From a position to the force it causes.
    workspace_m : tuple of three pairs of float
        Least and largest x, y and z [m].
    hardware : bool
        Whether motors move something: then consent and the dead-man button are asked for.
    """

    name: str
    clamp_N: float
    calibrated: bool
    damping_N_s_per_m: float
    delay_ticks: float
    workspace_m: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    hardware: bool = True


@dataclass(frozen=True, slots=True)
class CompiledIO:
    """Handles and constants by which the compiled servo reaches a device without Python.

    Attributes
    ----------
    kind : str
        ``module:name`` of the :class:`~tissueid.haptics.servo_access.Access` that takes them.
    handles : ndarray of int64, shape (HANDLES_SIZE,)
        Descriptors, addresses and identities.
    constants : ndarray
    memory : ndarray
        Changed by the loop.
    """

    kind: str
    handles: IntArray = field(default_factory=lambda: np.zeros(HANDLES_SIZE, np.int64))
    constants: FloatArray = field(default_factory=lambda: np.zeros(1))
    memory: FloatArray = field(default_factory=lambda: np.zeros(1))
