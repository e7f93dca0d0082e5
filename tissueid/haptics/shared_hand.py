"""The hand of a simulated device in shared memory, so that a pointer in another process can lead it.

The memory holds the parameters of :mod:`tissueid.haptics.simulated_layout`, which the simulated device reads
at every tick.  A target is three float64 words, each written whole; a tick that meets the new x with the old
y sees a target between the two, and the hand follows any target smoothly (30 ms, 0.5 m/s at most).  No other
device has such a memory: what has motors can't be led.
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
from tissueid.haptics.shared_memory import shared_memory
from tissueid.haptics.simulated_layout import LED_AT, POINTER, POINTER_ON, SIM_PARAMETERS

BYTES = 8 * SIM_PARAMETERS


@dataclass(frozen=True, slots=True)
class SharedHand:
    """Parameters of a simulated device, mapped into this process."""

    descriptor: int  # of the memory; another process is sent one of its own
    parameters: NDArray[np.float64]  # (SIM_PARAMETERS,)

    @classmethod
    def create(cls) -> SharedHand:
        """New memory; a simulated device fills it when it takes it.

        Raises DeviceError: the system has no such memory.
        """
        return cls._mapped(shared_memory("hand", BYTES))

    @classmethod
    def attach(cls, descriptor: int) -> SharedHand:
        """The memory behind a descriptor.

        Raises DeviceError: it has another size.
        """
        if os.fstat(descriptor).st_size != BYTES:
            msg = f"descriptor {descriptor} is no hand of a simulated device"
            raise DeviceError(msg)
        return cls._mapped(descriptor)

    @classmethod
    def _mapped(cls, descriptor: int) -> SharedHand:
        return cls(descriptor, np.frombuffer(mmap.mmap(descriptor, BYTES), np.float64))

    def point_at(self, position_m: Sequence[float]) -> None:
        """Lead the hand to a point.

        ``position_m``: device frame [m].  Raises ValueError: not three finite numbers.
        """
        point = np.asarray(position_m, dtype=np.float64)
        if point.shape != (3,) or not np.isfinite(point).all():
            msg = f"a pointer needs three finite coordinates, not {position_m!r}"
            raise ValueError(msg)
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

    def close(self) -> None:
        """Give the descriptor back; the mapping lives as long as its array."""
        os.close(self.descriptor)
