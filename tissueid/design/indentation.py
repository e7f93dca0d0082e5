"""One indentation: the path a machine will take, and how long it takes.

The tool starts ``standoff`` above the tissue, accelerates at a constant rate to the speed, slows down at the
same rate to rest at the depth, holds, and returns.  Time and depth are counted from contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.design.machine import Machine

SECONDS_PER_MINUTE = 60.0


@dataclass(frozen=True, slots=True, order=True)
class Indentation:
    """Request to the machine for one log."""

    #: ``hold_s`` 0 is a ramp alone.
    speed_mm_min: float
    depth_mm: float
    hold_s: float = 0.0

    @property
    def speed_mm_s(self) -> float:
        """Speed [mm/s]."""
        return self.speed_mm_min / SECONDS_PER_MINUTE

    @property
    def words(self) -> str:
        """As on a test sheet."""
        hold = f", hold {self.hold_s:g} s" if self.hold_s > 0.0 else ""
        return f"{self.depth_mm:g} mm at {self.speed_mm_min:g} mm/min{hold}"


@dataclass(frozen=True, slots=True)
class Ramp:
    """Speed against time from contact to rest: linear up, constant, linear down."""

    #: Speed at contact, and the greatest.
    start_mm_s: float
    top_mm_s: float
    #: Lengths of the three parts.
    up_s: float
    flat_s: float
    down_s: float

    @property
    def seconds(self) -> float:
        """From contact to rest."""
        return self.up_s + self.flat_s + self.down_s

    def depth(self, time_s: FloatArray) -> FloatArray:
        """Depth at times from contact on; constant after the ramp [mm]."""
        up = np.clip(time_s, 0.0, self.up_s)
        flat = np.clip(time_s - self.up_s, 0.0, self.flat_s)
        down = np.clip(time_s - self.up_s - self.flat_s, 0.0, self.down_s)
        gain = (self.top_mm_s - self.start_mm_s) / self.up_s if self.up_s > 0.0 else 0.0
        loss = self.top_mm_s / self.down_s if self.down_s > 0.0 else 0.0
        return np.asarray(
            self.start_mm_s * up + 0.5 * gain * up**2 + self.top_mm_s * flat
            + self.top_mm_s * down - 0.5 * loss * down**2
        )  # fmt: skip


def ramp_of(test: Indentation, machine: Machine) -> Ramp:
    """The loading of an indentation on a machine of finite acceleration."""
    a, depth, wanted = machine.acceleration_mm_s2, test.depth_mm, test.speed_mm_s
    # on the stand-off it can gather so much, and within the depth it must be able to stop
    start = min(wanted, math.sqrt(2.0 * a * machine.standoff_mm), math.sqrt(2.0 * a * depth))
    top = min(wanted, math.sqrt(a * depth + 0.5 * start**2))
    up, down = (top - start) / a, top / a
    way = 0.5 * (start + top) * up + 0.5 * top * down
    return Ramp(start, top, up, max(depth - way, 0.0) / top, down)


def seconds_of(test: Indentation, machine: Machine) -> float:
    """Machine time of one log without rest: approach, ramp, hold, return."""
    speed = test.speed_mm_s
    back = (machine.return_speed_mm_min or machine.max_speed_mm_min) / SECONDS_PER_MINUTE
    approach = machine.standoff_mm / speed + 0.5 * speed / machine.acceleration_mm_s2
    home = (test.depth_mm + machine.standoff_mm) / back + back / machine.acceleration_mm_s2
    return approach + ramp_of(test, machine).seconds + test.hold_s + home
