"""Devices, hands and pushes of a controlled loop, as frozen data, with where each number comes from.

Sadeghnejad et al. print six numbers in Table 3 and no other: "1.25 2 30 1.158 115.4 31.46".  That the
first three are mass, damping and stiffness of the operator and the others those of the device, in kg, N s/m
and N/m, is a reading.  The push of the hand is assumed here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tissueid.arrays import FloatArray
from tissueid.errors import UsageError
from tissueid.rendering.control.block import MOST_AXES


@dataclass(frozen=True, slots=True, eq=False)
class Mechanics:
    """Mass, damping and stiffness of a device or a hand.

    Raises UsageError: they are not symmetric, of different sizes, negative, or not finite.
    """

    #: (n, n): symmetric; a number is one axis.
    mass_kg: FloatArray
    damping_N_s_per_m: FloatArray  # (n, n)
    stiffness_N_per_m: FloatArray  # (n, n)

    def __init__(
        self, mass_kg: ArrayLike, damping_N_s_per_m: ArrayLike, stiffness_N_per_m: ArrayLike
    ) -> None:
        parts = [
            np.atleast_2d(np.asarray(one, dtype=np.float64))
            for one in (mass_kg, damping_N_s_per_m, stiffness_N_per_m)
        ]
        shape = parts[0].shape
        if not (shape[0] == shape[1] <= MOST_AXES and all(one.shape == shape for one in parts)):
            msg = f"mass, damping and stiffness must be numbers, or square of 1 to {MOST_AXES} axes alike"
            raise UsageError(msg)
        for one in parts:
            if not (
                np.isfinite(one).all() and np.array_equal(one, one.T) and np.linalg.eigvalsh(one)[0] >= 0
            ):
                msg = f"masses, dampings, stiffnesses: finite, symmetric and not negative, not {one.tolist()}"
                raise UsageError(msg)
        for name, one in zip(("mass_kg", "damping_N_s_per_m", "stiffness_N_per_m"), parts, strict=True):
            object.__setattr__(self, name, one)

    @property
    def axes(self) -> int:
        """Number of axes, n."""
        return len(self.mass_kg)

    def parameters(self) -> FloatArray:
        """Upper triangles of the three, row by row, shape (3 n (n + 1) / 2,)."""
        upper = np.triu_indices(self.axes)
        return np.concatenate(
            [one[upper] for one in (self.mass_kg, self.damping_N_s_per_m, self.stiffness_N_per_m)]
        )


#: Table 3 [reading].
TABLE_3_OPERATOR = Mechanics(1.25, 2.0, 30.0)
TABLE_3_DEVICE = Mechanics(1.158, 115.4, 31.46)


@dataclass(frozen=True, slots=True)
class PlanarArm:
    """Two links in a horizontal plane, in addition to the device's own mechanics; for two axes."""

    links_m: tuple[float, float]  # lengths
    inertia_kg_m2: tuple[float, float, float]  # p1, p2, p3 of :mod:`tissueid.rendering.control.plant`
    base_m: tuple[float, float]  # where the work begins (the surface of the tissue), from the base of the arm


@dataclass(frozen=True, slots=True)
class Signal:
    """An offset and a sine for each axis [N]."""

    #: As many as axes.
    offset_N: tuple[float, ...]
    amplitude_N: tuple[float, ...]
    frequency_Hz: tuple[float, ...]

    @classmethod
    def along(cls, offset: float, amplitude: float, frequency: float, *, axes: int = 1) -> Signal:
        """Along the first axis, nothing along the others."""
        rest = (0.0,) * (axes - 1)
        return cls((offset, *rest), (amplitude, *rest), (frequency, *rest))


#: Pushes of the hand along the first axis, which is into the tissue: offset, amplitude [N], frequency [Hz].
#: Assumed: the inputs of the paper's simulation are lost.
TASKS = {
    "sustained": (10.0, 10.0, 1.0),
    "free-contact": (2.0, 3.0, 0.5),
    "impacts": (2.0, 10.0, 0.5),
}
