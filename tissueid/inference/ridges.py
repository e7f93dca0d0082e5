"""Curves that a posterior follows, where whitened coordinates know the tangent at the optimum.

A single log is sheared by what polynomials and contact do as frame and times move, with determinant one.
Memory and scatter of gains are drawn by quantiles of their own density; at a scatter all else is as uncertain
as noise leaves it, and a common scale as much more as a mean of gains that scatter so much.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import PchipInterpolator
from scipy.special import ndtri

from tissueid.arrays import FloatArray
from tissueid.inference.engine import refit
from tissueid.inference.optimum import covariance_of, pinned
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
#: Ln of scatters, and steps of ln memory about the optimum, at which the density is tabulated.
SCATTERS, MEMORIES = np.linspace(-13.9, 5.0, 64), np.linspace(-5.0, 5.0, 51)
#: Scatter that noise makes, to begin with; parabolas in turn; widths that one moves at the most; curvature
#: over a width that is enough to go by; share of a density beyond each end of its curve.
LEAST_SCATTER, PARABOLAS, FARTHEST, LEAST_BEND, TAIL = 1e-4, 4, 10.0, 0.1, 1e-9


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

    def along(self, x: FloatArray) -> FloatArray:
        """The quantity at vectors, (..., size) -> (..., ...)."""
        return self.within(x[..., self.place])

    def at(self, value: FloatArray) -> FloatArray:
        """The same, continued straight beyond the ends for :data:`BEYOND` intervals."""
        first, last = self.curve.x[[0, -1]]
        room = BEYOND * np.diff(self.curve.x[[0, 1, -2, -1]])[::2]
        inside = np.clip(value, first, last)
        beyond = np.clip(value - inside, -room[0], room[1])
        return self.within(value) + beyond[..., None] * self.curve(inside, 1)


@dataclass(frozen=True, slots=True, eq=False)
class Ridges:
    """Curves that a posterior follows."""

    #: Of a single log, the frame's first: coordinates less what they do in proportion to its own, (size,).
    lines: tuple[Ridge, ...] = ()
    #: Root of the covariance of all but the machine, (r, r), lower, along the frame or the scatter of gains.
    widths: Ridge | None = None
    ln_scale: Ridge | None = None  # of several logs, the best along the scatter of gains
    #: Coordinates by their places, over standard normal ones.
    quantiles: Mapping[int, PchipInterpolator] = field(default_factory=dict)


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


def straight_beyond(curve: PchipInterpolator, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A curve, continued straight beyond its ends, and the logarithm of its slope; (...,) -> (...,)."""
    inside = np.clip(value, curve.x[0], curve.x[-1])
    slope = curve(inside, 1)
    return np.asarray(curve(inside) + (value - inside) * slope), np.log(np.maximum(slope, 1e-300))


def _by_density(values: FloatArray, level: FloatArray) -> PchipInterpolator:
    """A coordinate of such log densities (n,), over a standard normal one of the same quantiles."""
    density = np.exp(level - level[np.isfinite(level)].max())
    below = cumulative_simpson(density, x=values, initial=0.0)
    share = np.clip(below / below[-1], TAIL, 1.0 - TAIL)
    normal, first = np.unique(ndtri(share), return_index=True)
    return PchipInterpolator(normal, values[first])


def with_quantiles(target: SpecimenTarget, ridges: Ridges) -> Ridges:
    """Add memory and scatter of gains, and all else along the scatter, to ridges."""
    quantiles, places = {}, target.places
    if "ln_memory" in places:
        at, x = places["ln_memory"], np.tile(target.mode, (MEMORIES.size, 1))
        x[:, at] += MEMORIES
        quantiles[at] = _by_density(x[:, at], target.density(x))
    if "ln_gain_sd" not in places:
        return replace(ridges, quantiles=quantiles)
    at = places["ln_gain_sd"]
    ln_scale, level = _common_scale(target, at)
    quantiles[at] = _by_density(SCATTERS, level)
    widths, scales = (Ridge(at, PchipInterpolator(SCATTERS, one)) for one in (_roots(target), ln_scale))
    return replace(ridges, widths=widths, ln_scale=scales, quantiles=quantiles)


def _common_scale(target: SpecimenTarget, at: int) -> tuple[FloatArray, FloatArray]:
    """Ln of the best common scale of several logs at :data:`SCATTERS`, and log densities, (n,), (n,)."""
    linear, middle = target.linear_places, np.zeros(SCATTERS.size)
    width = np.sqrt((np.exp(2.0 * SCATTERS) + LEAST_SCATTER**2) / len(target.system.logs))

    def level_at(scales: FloatArray) -> FloatArray:
        x = np.tile(target.mode, (*scales.shape, 1))
        x[..., at] = SCATTERS
        x[..., linear] *= np.exp(scales)[..., None]
        return target.density(x.reshape(-1, x.shape[-1])).reshape(scales.shape)

    # by parabolas in the density
    for _ in range(PARABOLAS):
        low, level, high = level_at(middle + np.outer([-1.0, 0.0, 1.0], width))
        with np.errstate(invalid="ignore"):
            bend = 2.0 * level - low - high
            known = np.isfinite(bend) & (bend > LEAST_BEND)
            step = np.where(known, 0.5 * (high - low) / np.where(known, bend, 1.0), 0.0)
        middle = middle + np.clip(step, -FARTHEST, FARTHEST) * width
        width = width / np.sqrt(np.where(known, bend, 1.0))
    return middle, level_at(middle) + np.log(width)


def _roots(target: SpecimenTarget) -> FloatArray:
    """Roots of the covariance of all but the machine at :data:`SCATTERS`, (n, r, r)."""
    rest, scale = target.still_places, np.zeros(target.mode.size)
    scale[target.linear_places] = target.mode[target.linear_places]
    found, centred = target.optimum, target.system.centred
    normal = replace(found.normal, hessian=pinned(found.normal, found.point, centred=centred))
    hessian, _ = target.curvature(replace(found, normal=normal), target.slope)
    more = np.exp(2.0 * SCATTERS)[:, None, None] / len(target.system.logs)
    known = covariance_of(hessian[np.ix_(rest, rest)]) + more * np.outer(scale[rest], scale[rest])
    return np.asarray(np.linalg.cholesky(known), dtype=np.float64)
