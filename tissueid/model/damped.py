"""A static law whose force is damped by the speed over that at which contact began: F = F_s (1 + chi r) >= 0.

Nothing relaxes: a tool that stands still feels the static force, and after a contact nothing is remembered.
"""

from __future__ import annotations

from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.model.base import ContactPath, ParameterSpec
from tissueid.model.channels import ElasticModel
from tissueid.model.law import DampingLaw, Shape

#: Share of a bound within which a parameter lies on it.
ROUNDING = 1e-9


class DampedModel(ElasticModel):
    """Contact model of a static and a damping law."""

    @cached_property
    def shape_specs(self) -> tuple[Shape, ...]:
        """Shapes in the order of theta."""
        return (*self.static.shapes, self.damping.shape)

    @property
    def damping(self) -> DampingLaw:
        """Law of its damping, whose parameter is the last of theta."""
        return cast("DampingLaw", self.relaxation)

    @cached_property
    def parameters(self) -> tuple[ParameterSpec, ...]:
        """Parameters in the order of theta."""
        return (*self.static.coefficients, *(one.spec for one in self.shape_specs))

    def factor(self, theta: FloatArray) -> float:
        """Damping factor chi."""
        return float(self.damping.factor(theta[-1]))

    def loading_stiffness(self, theta: FloatArray) -> float:
        """First static coefficient times 1 + chi: all that records at one speed ratio determine."""
        return float(theta[0]) * (1.0 + self.factor(theta))

    def stiffness(self, theta: FloatArray, depth_mm: FloatArray) -> FloatArray:  # noqa: ARG002
        """No stiffness relaxes, (0, n)."""
        return np.zeros((0, np.size(depth_mm)))

    def modes(
        self,
        theta: FloatArray,  # noqa: ARG002
        depth_mm: float,  # noqa: ARG002
        amplitude_mm: float = 0.0,  # noqa: ARG002
    ) -> tuple[FloatArray, FloatArray]:
        """One that is not a number: a cycle in lasting contact has no speed at which it began."""
        return np.full(1, np.nan), np.ones(1)

    def relaxing(
        self,
        theta: FloatArray,
        depth_mm: float,
        time_s: FloatArray,
        speed_mm_s: float | None,
    ) -> FloatArray:
        """Damping force at the end of a ramp, none once the tool stands still, (n,) -> (n,) [N]."""
        moving = self.loading(theta, np.array([depth_mm]), speed_mm_s or 1.0)[0]
        return np.where(np.asarray(time_s) > 0.0, 0.0, moving)

    def loading(self, theta: FloatArray, depth_mm: FloatArray, speed_mm_s: float) -> FloatArray:  # noqa: ARG002
        """Force beyond the static one at the speed of the contact, (n,) -> (n,) [N]."""
        return np.asarray(self.factor(theta) * self.static_force(theta, depth_mm))

    def force(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """Force [N] along a path, shape (n,)."""
        damped = np.maximum(1.0 + self.factor(theta) * path_ratio(path), 0.0)
        return np.asarray(self.static_force(theta, np.maximum(path.depth_mm, 0.0)) * damped)

    def passive(self, theta: FloatArray) -> NDArray[np.bool_]:
        """True of rows with F_s >= 0 and growing, chi >= 0: then no loop gives energy, (n, p) -> (n,)."""
        spec, last = self.damping.shape.spec, theta[:, -1]
        inside = (last >= spec.lower * (1.0 - ROUNDING)) & (last <= spec.upper * (1.0 + ROUNDING))
        return np.asarray(inside & super().passive(theta))


def path_ratio(path: ContactPath) -> FloatArray:
    """Speed over the speed at which the contact of each sample began, within +-1; 0 in air, shape (n,)."""
    if path.speed_ratio is not None:
        return np.asarray(path.speed_ratio)
    speed, touching = _piecewise_speed(path.time_s, path.depth_mm), path.depth_mm > 0.0
    begins = np.flatnonzero(touching & ~np.append(False, touching[:-1]))
    begun = np.searchsorted(begins, np.arange(speed.size), side="right") - 1
    at_contact = np.append(speed[begins], 0.0)[begun]
    inside = touching & (at_contact > 0.0)
    ratio = np.divide(speed, at_contact, out=np.zeros(speed.size), where=inside)
    return np.asarray(np.clip(ratio, -1.0, 1.0))


def _piecewise_speed(time: FloatArray, depth: FloatArray) -> FloatArray:
    """Speed of the straight piece that ends at each sample [mm/s]; the first has that of the second."""
    step = np.diff(time)
    moved = step > 0.0
    rate = np.divide(np.diff(depth), step, out=np.zeros(step.size), where=moved)
    # a step without time has the speed of the one before it
    last = np.maximum.accumulate(np.where(moved, np.arange(step.size), -1))
    rate = np.where(last >= 0, rate[np.maximum(last, 0)], 0.0)
    return np.concatenate([rate[:1], rate])
