"""Numbers of a Falcon: two geometries from the literature and what a calibration adds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.haptics.falcon.kinematic_kernels import COSINES, GEOMETRY_SIZE, SINES

#: Azimuths of legs 1 (top), 2 (right) and 3 (left), seen from the front [deg].
AZIMUTHS_DEG = (105.0, -15.0, -135.0)
#: Lines of the encoder wheel, each counted four times.
COUNTS_PER_TURN = 320 * 4


@dataclass(frozen=True)
class Geometry:
    """Lengths and angles of the legs, in the letters of Stamper (1997)."""

    name: str
    #: a, b, c, d + e, f, r and s [m].
    thigh_m: float
    shin_m: float
    c_m: float
    pins_m: float
    f_m: float
    r_m: float
    s_m: float
    gear: float  # turns of the encoder wheel for one turn of the arm
    #: Leg angle at count zero.  35, 40 and 50 have been reported: calibrate.
    zero_angle_deg: float
    source: str = field(repr=False)  # where the numbers are from

    @property
    def radians_per_count(self) -> float:
        """Leg angle of one encoder count [rad]."""
        return 2.0 * math.pi / (COUNTS_PER_TURN * self.gear)

    def with_zero_angle(self, degrees: float) -> Geometry:
        """The same legs with another angle at count zero [deg]."""
        return replace(self, zero_angle_deg=degrees)

    def block(self) -> NDArray[np.float64]:
        """The numbers for the kernels, shape (GEOMETRY_SIZE,), read-only."""
        out = np.empty(GEOMETRY_SIZE)
        out[:COSINES] = (
            self.thigh_m, self.shin_m, self.c_m, self.pins_m, self.f_m, self.r_m, self.s_m,
            math.radians(self.zero_angle_deg), self.radians_per_count,
        )  # fmt: skip
        azimuths = np.radians(AZIMUTHS_DEG)
        out[COSINES : COSINES + 3] = np.cos(azimuths)
        out[SINES : SINES + 3] = np.sin(azimuths)
        out.setflags(write=False)
        return out


GEOMETRIES = {
    "stamper": Geometry(
        "stamper", 0.060, 0.1025, 0.01443, 0.0225, -0.025, 0.040, -0.02309, 110.0 / 14.25, 35.0,
        "widely used with open drivers, in the notation of Stamper (1997)",
    ),
    "martin-hillier": Geometry(
        "martin-hillier", 0.060, 0.1025, 0.0157, 0.023, -0.0262, 0.0366, -0.0272, 7.62, 35.0,
        "Martin and Hillier (2009), as quoted by users; signs of f and s set to those of the first",
    ),
}  # fmt: skip
DEFAULT_GEOMETRY = GEOMETRIES["stamper"]
