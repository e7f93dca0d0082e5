"""Ridges of a single log's posterior: what polynomials and contact do as frame and relaxation times move.

Far from the optimum they follow a curve, where whitened coordinates know its tangent.  Proposals sheared by
what the curve leaves of the tangent reach the whole ridge; a shear has determinant one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.engine import refit
from tissueid.inference.prior import time_bounds

if TYPE_CHECKING:
    from tissueid.inference.system import Point
    from tissueid.inference.target import SpecimenTarget

#: Places of a profile, in standard deviations about the optimum and of the machine's prior.
TIMES_SD = np.array([-4.0, -3.0, -2.2, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.2, 3.0, 4.0])
MACHINE_SD = np.array([-3.0, -1.5, -0.7, 0.0, 0.5, 1.0, 1.5, 2.2, 3.0])
#: Largest standard deviation of ln tau that places are spread by, and steps to each of them.
WIDEST, PROFILE_STEPS = 3.0, 8
#: Intervals beyond its ends that a ridge is continued straight.
BEYOND = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Ridge:
    """Coordinates along one of them, less what they do in proportion."""

    place: int  # coordinate it runs along
    values: FloatArray  # (g,), ascending
    off: FloatArray  # (g, size)

    def at(self, value: FloatArray) -> FloatArray:
        """Rest beside the tangent at values of the coordinate, (...,) -> (..., size)."""
        i = np.clip(np.searchsorted(self.values, value) - 1, 0, self.values.size - 2)
        width = self.values[i + 1] - self.values[i]
        share = np.clip((value - self.values[i]) / width, -BEYOND, 1.0 + BEYOND)[..., None]
        return np.asarray(self.off[i] * (1.0 - share) + self.off[i + 1] * share)


def ridges_of(target: SpecimenTarget, frame_at: Callable[[FloatArray], FloatArray]) -> tuple[Ridge, ...]:
    """Ridges along frame and relaxation times; ``frame_at``: compliance at quantiles of its prior."""
    found, system, times = target.optimum, target.system, target.law.times
    state, sd = system.deflection, np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    low, high = time_bounds(system)
    out = []
    for place in (times, *range(target.law.counts[0])):
        middle = float(found.point.shared[place])
        values = frame_at(MACHINE_SD)
        if place < times:
            values = np.clip(middle + min(float(sd[place]), WIDEST) * TIMES_SD, low, high)
        values = np.unique(np.append(values, middle))
        if values.size > 1:
            off = _along(target, place, values, middle) - np.outer(values - middle, _tangent(target, place))
            off[:, : times + 3] = 0.0
            off[:, target.n_shared + 1 :] = 0.0  # contact is the first coordinate behind the shared ones
            out.append(Ridge(place, values, off))
    system.deflection = state
    return tuple(out)


def _along(target: SpecimenTarget, place: int, values: FloatArray, middle: float) -> FloatArray:
    """Vectors of the best fits with a coordinate at values, less that at its optimum, (g, size)."""
    identified, found = target.identified, target.optimum
    held, noise = np.array([place]), found.noise

    def best(start: Point) -> Point:
        """All else at its best, the machine as it is."""
        steps = PROFILE_STEPS
        return refit(identified, machine=False, start=start, steps=steps, held=held, noise=noise).point

    first = best(found.point)
    origin, out = target.vector_of(first), np.zeros((values.size, target.mode.size))
    up = np.flatnonzero(values >= middle)
    for side in (up, np.flatnonzero(values < middle)[::-1]):
        point = first
        for k in side.tolist():
            shared = point.shared
            shared[place] = values[k]
            point = best(replace(point.moved(shared), own=point.own))
            out[k] = target.vector_of(point) - origin
    return out


def _tangent(target: SpecimenTarget, place: int) -> FloatArray:
    """Change of all coordinates in proportion to one, by the normal about the optimum, (size,)."""
    free, machine = np.flatnonzero(target.free), len(target.machine_places)
    if place < target.law.times:
        rest = target.root[:, machine:]
        column = int(np.searchsorted(free, place))
        slope = rest @ rest[column] / float(rest[column] @ rest[column])
    else:
        step = np.zeros(machine)
        step[place - target.law.times] = 1.0
        slope = target.root[:, :machine] @ np.linalg.solve(target.root[target.machine_places, :machine], step)
    out = np.zeros(target.mode.size)
    out[free] = slope
    return out
