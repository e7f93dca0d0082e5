"""Ridges of a single log's posterior: what polynomials and contact do as frame and relaxation times move.

Far from the optimum they follow a curve, where whitened coordinates know its tangent.  Proposals sheared by
what the curve leaves of the tangent reach the whole ridge; a shear has determinant one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import PchipInterpolator

from tissueid.arrays import FloatArray
from tissueid.inference.engine import refit
from tissueid.inference.prior import time_bounds

if TYPE_CHECKING:
    from tissueid.inference.optimum import Optimum
    from tissueid.inference.system import Point
    from tissueid.inference.target import SpecimenTarget

#: Places of a profile, in standard deviations about the optimum and of the machine's prior.
TIMES_SD = np.array([-4.0, -2.5, -1.2, 0.0, 1.2, 2.5, 4.0])
MACHINE_SD = np.array([-3.0, -1.5, -0.7, 0.0, 1.0, 2.0, 3.0])
#: Largest standard deviation of ln tau that places are spread by, and steps to each of them.
WIDEST, PROFILE_STEPS = 3.0, 8
#: Intervals beyond its ends that a ridge is continued straight.
BEYOND = 3.0
#: Loss of ln density to which a ridge is followed closely; distance from it, whitened, that is near enough,
#: and times that an interval is halved until it is.
LIKELY, NEAR, HALVINGS = 8.0, 0.8, 3


@dataclass(frozen=True, slots=True, eq=False)
class Ridge:
    """A quantity along one coordinate: a monotone cubic, which does not swing where two places are close."""

    place: int  # coordinate it runs along
    curve: PchipInterpolator

    @classmethod
    def of(cls, place: int, known: Mapping[float, FloatArray]) -> Ridge:
        """Ridge through what is known at values of the coordinate."""
        values = sorted(known)
        return cls(place, PchipInterpolator(values, [known[value] for value in values]))

    def within(self, value: FloatArray) -> FloatArray:
        """The quantity at values of the coordinate, beyond the ends as there; (...,) -> (..., ...)."""
        return np.asarray(self.curve(np.clip(value, self.curve.x[0], self.curve.x[-1])))

    def at(self, value: FloatArray) -> FloatArray:
        """The same, continued straight beyond the ends for :data:`BEYOND` intervals."""
        first, last = self.curve.x[[0, -1]]
        room = BEYOND * np.diff(self.curve.x[[0, 1, -2, -1]])[::2]
        inside = np.clip(value, first, last)
        beyond = np.clip(value - inside, -room[0], room[1])
        return self.within(value) + beyond[..., None] * self.curve(inside, 1)


@dataclass(frozen=True, slots=True, eq=False)
class Ridges:
    """Ridges of a single log, the frame's first, with widths along that; none of several logs."""

    #: Of each the coordinates less what they do in proportion to its own, (size,).
    lines: tuple[Ridge, ...] = ()
    widths: Ridge | None = None  # root of the covariance of all but the machine, (r, r), lower


def ridges_of(target: SpecimenTarget, frame_at: Callable[[FloatArray], FloatArray]) -> Ridges:
    """Ridges along frame and relaxation times; ``frame_at``: compliance at quantiles of its prior."""
    found, system, times = target.optimum, target.system, target.law.times
    state, sd = system.deflection, np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    low, high = time_bounds(system)
    out, widths = [], None
    for place in (times, *range(target.law.counts[0])):
        middle = float(found.point.shared[place])
        values = frame_at(MACHINE_SD)
        if place < times:
            values = np.clip(middle + min(float(sd[place]), WIDEST) * TIMES_SD, low, high)
        values = np.unique(np.append(values, middle))
        if values.size > 1:
            profile = _Profile(target, place, middle)
            out.append(profile.along(values))
            if place == times:
                roots = {value: target.root_at(optimum) for value, optimum in profile.optima.items()}
                widths = Ridge.of(place, roots)
            system.deflection = state
    return Ridges(tuple(out), widths)


class _Profile:
    """Best fits with one coordinate at values."""

    def __init__(self, target: SpecimenTarget, place: int, middle: float) -> None:
        self.target, self.place, self.middle = target, place, middle
        self.state, self.tangent = target.system.deflection, _tangent(target, place)
        first = self._best(target.optimum.point)
        self.origin = target.vector_of(first.point)
        self.optima, self.off = {middle: first}, {middle: np.zeros(target.mode.size)}

    def _best(self, start: Point) -> Optimum:
        """All else at its best, the machine as it is."""
        found = self.target.optimum
        return refit(
            self.target.identified,
            machine=False,
            start=start,
            steps=PROFILE_STEPS,
            held=np.array([self.place]),
            noise=found.noise,
        )

    def _add(self, value: float) -> None:
        """Fit at a value, from the nearest that is known."""
        if value in self.optima:
            return
        point = self.optima[min(self.optima, key=lambda one: abs(one - value))].point
        shared = point.shared
        shared[self.place] = value
        self.optima[value] = self._best(replace(point.moved(shared), own=point.own))
        off = self.target.vector_of(self.optima[value].point) - self.origin
        off -= (value - self.middle) * self.tangent
        off[: self.target.law.times + 3] = 0.0
        off[self.target.n_shared + 1 :] = 0.0  # contact is the first coordinate behind the shared ones
        self.off[value] = off

    def along(self, values: FloatArray) -> Ridge:
        """Ridge through values, and closer where it bends and the density is not small."""
        for value in sorted(values.tolist(), key=lambda one: abs(one - self.middle)):
            self._add(value)
        doubtful = self._likely()
        for _ in range(HALVINGS):
            known, bent = Ridge.of(self.place, self.off), []
            for low, high in doubtful:
                middle = 0.5 * (low + high)
                self._add(middle)
                off = (self.off[middle] - known.at(np.array(middle)))[self.target.free]
                if np.linalg.norm(np.linalg.solve(self.target.root, off)) > NEAR:
                    bent += [(low, middle), (middle, high)]
            doubtful = bent
        return Ridge.of(self.place, self.off)

    def _likely(self) -> list[tuple[float, float]]:
        """Intervals of which one end is likely."""
        values, target = sorted(self.optima), self.target
        now, target.system.deflection = target.system.deflection, self.state
        level = target.density(np.array([target.vector_of(self.optima[one].point) for one in values]))
        target.system.deflection = now
        likely = level > level.max() - LIKELY
        ends = np.flatnonzero(likely[1:] | likely[:-1])
        return [(values[k], values[k + 1]) for k in ends.tolist()]


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
