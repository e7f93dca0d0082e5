"""The hand of a simulated device in shared memory, so that a pointer in another process can lead it.

It loads no compiler.  A target is three float64 words, each written whole; a tick that meets the new x with
the old y sees a target between the two, and the hand follows any target smoothly (30 ms, 0.5 m/s at most).
"""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import DeviceError
from tissueid.haptics.ring import Shared, shared_memory

# --- the arm's
MASS, DAMPING, FRICTION, SUBSTEP = 0, 1, 2, 3
HAND_STIFFNESS, HAND_DAMPING, RIGID = 4, 5, 6
TREMOR, TREMOR_HZ, TREMOR_PHASE, TREMOR_AXIS = 7, 8, 9, 10  # axis: 10, 11, 12
POINTER_ON, POINTER = 13, 14  # pointer: 14, 15, 16
KNOTS = 17
LED_AT = 18  # monotonic time [s] at which whoever leads the hand was last there; no kernel reads it
FIRST_KNOT = 20
#: Columns of a knot of the hand's script: time, x, y, z, grip from here on.
KNOT_COLUMNS = 5
MAX_KNOTS = 64
ARM_PARAMETERS = FIRST_KNOT + KNOT_COLUMNS * MAX_KNOTS

# --- behind them
QUANTUM, PHASE = ARM_PARAMETERS, ARM_PARAMETERS + 1  # phase: 3 values, in counts
DELAY = ARM_PARAMETERS + 4
SIM_PARAMETERS = ARM_PARAMETERS + 5
BYTES = 8 * SIM_PARAMETERS


@dataclass(frozen=True, slots=True)
class SharedHand(Shared):
    """Parameters of a simulated device, mapped into this process."""

    parameters: NDArray[np.float64]  # (SIM_PARAMETERS,)

    @classmethod
    def create(cls) -> SharedHand:
        """New memory, which a simulated device fills; DeviceError where the system has none."""
        return cls._mapped(shared_memory("hand", BYTES))

    @classmethod
    def attach(cls, descriptor: int) -> SharedHand:
        """The memory behind a descriptor; DeviceError if it has another size."""
        if os.fstat(descriptor).st_size != BYTES:
            raise DeviceError(f"descriptor {descriptor} is no hand of a simulated device")
        return cls._mapped(descriptor)

    @classmethod
    def _mapped(cls, descriptor: int) -> SharedHand:
        return cls(descriptor, np.frombuffer(mmap.mmap(descriptor, BYTES), np.float64))

    def point_at(self, position_m: Sequence[float]) -> None:
        """Lead the hand to a point of the device's frame [m]; ValueError: not three finite numbers."""
        point = np.asarray(position_m, dtype=np.float64)
        if point.shape != (3,) or not np.isfinite(point).all():
            raise ValueError(f"a pointer needs three finite coordinates, not {position_m!r}")
        for axis in range(3):
            self.parameters[POINTER + axis] = point[axis]
        self.parameters[POINTER_ON] = 1.0

    def stay(self) -> None:
        """Say that whoever leads the hand is still there."""
        self.parameters[LED_AT] = time.monotonic()

    def silent_s(self) -> float:
        """Time since that was last said [s]; 0 where it never was."""
        said = float(self.parameters[LED_AT])
        return time.monotonic() - said if said > 0.0 else 0.0
