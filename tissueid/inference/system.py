"""All logs of a specimen under one law: predicted forces of their blocks, and derivatives of them.

Each log has its own gain, contact, factor of relaxation times, and shape: a curve of depth that multiplies
the whole force. The frame acts by the predicted force, the filter is one pole, force lags displacement by the
skew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.blocks import Blocks
from tissueid.inference.channel_law import ChannelLaw
from tissueid.inference.law import TINY, Path, Slopes, driven, weighted

#: Coordinates of the machine, in their order in a point.
MACHINE = ("frame_compliance_mm_per_N", "skew_s", "force_filter_s")
#: Iterations of the frame's deflection: each leaves compliance times stiffness of the error before.
FRAME_ROUNDS = 1
#: Iterations until a deflection has settled, and the share of the largest force that it then changes by.
SETTLING, SETTLED, UNSETTLED = 24, 1e-7, 1e-2
#: Change up to which the slopes that the iteration goes by stay those of the point before.
SAME_SLOPES = 1e-3
#: Depths over the largest depth behind a frame; what lies beyond is no deflection.
FARTHEST = 2.0
#: Share of its depth over which a log's speed at contact is taken.
ONSET_SHARE = 0.2
#: Steps of numerical derivatives: ln times, depth over the largest depth, machine in its prior's units.
STEP_LN, STEP_DEPTH = 1e-5, 1e-6
STEP_MACHINE, STEP_FORCE = 1e-6, 1e-6
#: Coefficients of a log's shape: ln gain at the surface and at half depth, beside that at the largest depth.
SHAPE = 2
#: A filter shorter than this is none, and its pole where others of the same call are filtered.
NO_FILTER_S, NO_POLE_S = 1e-7, 1e-12


@dataclass(frozen=True, slots=True)
class Effects:
    """Own parameters of a log beside its contact."""

    #: ln gain at the largest depth, before the contact offset; behind it ln of how much slower the log
    #: relaxes, and ln gain at lesser depths.
    gain: bool = False
    shape: bool = False
    time: bool = False

    @property
    def time_at(self) -> int:
        """Place of ln time, where there is one, behind the contact."""
        return int(self.gain) + 1

    @property
    def size(self) -> int:
        """Own parameters of a log."""
        return self.time_at + int(self.time) + SHAPE * int(self.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """One point of the parameters, or n of them along a first axis."""

    log_times: FloatArray  # (t,) and (n, t)
    machine: FloatArray  # (3,) and (n, 3), in the order of :data:`MACHINE`
    linear: FloatArray  # (p,) and (n, p)
    #: (logs, q) and (n, logs, q): ln gain, contact offset over the largest depth, ln time, shape, if any.
    own: FloatArray

    @property
    def shared(self) -> FloatArray:
        """Times, machine and linear parameters as one vector."""
        return np.concatenate([self.log_times, self.machine, self.linear], axis=-1)

    def moved(self, shared: FloatArray, own: FloatArray | None = None) -> Point:
        """The point with another vector of shared parameters."""
        t = self.log_times.shape[-1]
        own = self.own if own is None else own
        return Point(shared[..., :t], shared[..., t : t + 3], shared[..., t + 3 :], own)


@dataclass(frozen=True, slots=True, eq=False)
class Derivatives:
    """Predicted forces and their derivatives at a point: (k,), (k, shared), (k, own)."""

    force: FloatArray
    shared: FloatArray
    own: FloatArray


class Remembered(NamedTuple):
    """Forces of the observations by the surface of which law their path follows."""

    log_times: FloatArray  # (t,)
    linear: FloatArray  # (p,)
    offsets: FloatArray  # (logs,), over the largest depth
    by: FloatArray  # (k, t + p + 1)


class Deflection(NamedTuple):
    """Deflection of the frame as it is iterated along all points."""

    guess: FloatArray  # force that it is iterated from [N]
    soft: FloatArray  # share of a change of force that is left, the frame giving way to it
    settled: bool


def _shape(u: FloatArray) -> FloatArray:
    """Bernstein polynomials of degree 2 that vanish at the largest depth, (2, ..., m)."""
    left = 1.0 - u
    return np.stack([left * left, 2.0 * u * left])


def _onset(log: Blocks) -> float:
    """Speed at which a tool meets the tissue [mm/s]; 0 where the log begins in contact."""
    if log.depth_mm[0] >= 0.0:
        return 0.0
    first = int(np.argmax(log.depth_mm > 0.0))
    last = first + int(np.argmax(log.depth_mm[first:] >= ONSET_SHARE * log.depth_mm.max()))
    begins = max(first - 1, 0)
    time = float(log.time_s[last] - log.time_s[begins])
    return max(float(log.depth_mm[last] - log.depth_mm[begins]) / time, 0.0) if time > 0.0 else 0.0


class System:
    """Blocks of all logs, one behind the other; ``give``: deflection [mm] of a known frame under forces."""

    def __init__(
        self,
        logs: Sequence[Blocks],
        law: ChannelLaw,
        depth_mm: float,
        effects: Effects,
        *,
        give: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        self.give = give
        self.logs, self.law, self.depth_mm, self.effects = tuple(logs), law, depth_mm, effects
        points = np.array([one.time_s.size for one in logs])
        first = np.concatenate([[0], np.cumsum(points)[:-1]])
        self.points = points
        self.travel = np.concatenate([one.depth_mm for one in logs]) / depth_mm
        self.speed_ratio = np.concatenate([one.speed_ratio for one in logs])
        step = np.diff(np.concatenate([one.time_s for one in logs]), prepend=0.0)
        step[first] = np.inf
        self.step = np.maximum(step, 1e-12)
        self.fresh = first
        self.first = np.zeros(step.size, dtype=bool)
        self.first[first] = True
        rows = [one.at + offset for one, offset in zip(logs, first, strict=True)]
        #: (3, k): points at both ends of each observation and in its middle.
        self.at = np.ascontiguousarray(np.concatenate(rows).T)
        self.sampled = bool((self.at[0] == self.at[2]).all())
        self.log = np.repeat(np.arange(len(logs)), [one.force_N.size for one in logs])
        self.begins = np.concatenate([[0], np.cumsum([one.force_N.size for one in logs])[:-1]])
        self.force = np.concatenate([one.force_N for one in logs])
        self.count = np.concatenate([one.count for one in logs]).astype(np.float64)
        #: (k,): weight of an observation's bend: Simpson's, less what n samples miss of a mean over all time.
        self.bend = (1.0 - self.count**-2) / 6.0
        self.worth = 1.0 / (1.0 / self.count + np.concatenate([one.digits for one in logs]))
        self.chain = np.concatenate([one.chain for one in logs])
        self.obs_step = np.concatenate([one.step_s for one in logs])
        self.mid = np.concatenate([one.mid_s for one in logs])
        self.fold = np.concatenate([one.fold for one in logs])
        self.within_N2 = sum(one.within_N2 for one in logs)
        self.within_freedom = sum(one.within_freedom for one in logs)
        self.samples = int(self.count.sum())
        # force at all points, from which the frame's deflection is iterated: measured, then predicted
        self.guess = np.concatenate([np.interp(one.time_s, one.mid_s, one.force_N) for one in logs])
        self.soft = np.ones(self.guess.size)
        self.settled = True
        self.onset = np.array([_onset(one) for one in logs]) / depth_mm
        self.remembered = self._remembered()

    @property
    def deflection(self) -> Deflection:
        """State of the frame, to return to."""
        return Deflection(self.guess, self.soft, self.settled)

    @deflection.setter
    def deflection(self, state: Deflection) -> None:
        self.guess, self.soft, self.settled = state

    def under(self, law: ChannelLaw) -> System:
        """The same logs under another law."""
        new = object.__new__(System)
        new.__dict__.update(self.__dict__)
        new.law = law
        new.remembered = new._remembered()
        return new

    def of(self, logs: Sequence[Blocks], numbers: Sequence[int]) -> System:
        """Some of the logs by their numbers, in blocks that are given, under the same law."""
        law = self.law.along(tuple(numbers))
        return System(logs, law, self.depth_mm, self.effects, give=self.give)

    def alone(self, blocks: Blocks, number: int, point: Point) -> tuple[System, Point]:
        """One of the logs, in blocks that are given, and its part of a point, which the frame follows."""
        system, own = self.of([blocks], [number]), replace(point, own=point.own[number : number + 1])
        system.follow(own)
        return system, own

    def _remembered(self) -> Remembered | None:
        """Response of the observations to the law whose surfaces the paths follow, where it is this one."""
        each = [one.response for one in self.logs]
        told = next((one for one in each if one is not None), None)
        if told is None or told.law != self.law:
            return None
        times, linear = told.log_times, told.linear
        offsets = np.array([0.0 if one is None else one.offset for one in each])
        depth = self.travel - self.at_points(offsets)
        still_mm = [np.zeros((len(told.by), n)) for n in self.points]
        by_log = [none if one is None else one.by for one, none in zip(each, still_mm, strict=True)]
        by = np.concatenate(by_log, axis=1) / self.depth_mm

        def force(depths: FloatArray) -> FloatArray:
            return np.asarray(linear @ self.law.columns(times, self.path(depths)))

        still = force(depth)
        rows = [(force(depth + STEP_DEPTH * one) - still) / STEP_DEPTH for one in by]
        return Remembered(times, linear, offsets, self.means(np.array(rows)).T)

    def _carried(self, point: Point) -> FloatArray:
        """Force of the observations by surfaces that move with the law, to first order; (k,) or (n, k)."""
        if self.remembered is None:
            return np.zeros(1)
        times, linear, offsets, by = self.remembered
        t, p = times.size, linear.size
        out = (point.log_times - times) @ by[:, :t].T + (point.linear - linear) @ by[:, t : t + p].T
        return np.asarray(out + (self.offsets(point) - offsets)[..., self.log] * by[:, -1])

    def carrying(self, seen: FloatArray, point: Point) -> FloatArray:
        """Force at a point and its columns, (1 + p, ..., k), with what surfaces that move add to them."""
        if self.remembered is not None:
            columns = self.remembered.by[:, self.law.times : -1].T[: len(seen) - 1]
            seen[0] += self._carried(point)
            seen[1:] += columns.reshape(len(columns), *(1,) * (seen.ndim - 2), seen.shape[-1])
        return seen

    @property
    def centred(self) -> bool:
        """True where the shapes of several logs have mean zero: the specimen's curve is that of its logs."""
        return self.effects.shape and len(self.logs) > 1

    @property
    def size(self) -> int:
        """Shared parameters."""
        return self.law.times + len(MACHINE) + self.law.linear

    def path(self, depth: FloatArray, point: Point | None = None, slower: float = 0.0) -> Path:
        """Depths (over the largest depth) of all points as a path in contact, (m,) or (n, m).

        ``slower``: added to the ln times of the logs, which are those of a point.
        """
        flat = depth.ravel()
        touching = flat > 0.0
        entered = np.flatnonzero(touching[1:] & ~touching[:-1]) + 1
        entered = entered[~self.first[entered % depth.shape[-1]]]
        share = flat[entered] / (flat[entered] - flat[entered - 1])
        u = np.maximum(depth, 0.0)
        step = self.step
        if point is not None and self.effects.time:
            # a log that relaxes slower is one whose clock runs slower
            step = step * self.at_points(np.exp(-slower - point.own[..., self.effects.time_at]))
        gain = None if point is None or not self.effects.gain else self.gain(point, u)
        return Path(step, u * self.depth_mm, entered, share, self.fresh, self.speed_ratio, gain)

    def at_points(self, values: FloatArray) -> FloatArray:
        """Values of the logs at each of their points, (..., logs) -> (..., m)."""
        return np.asarray(np.repeat(values, self.points, axis=-1))

    def means(self, values: FloatArray) -> FloatArray:
        """Observations of values at points, (..., m) -> (..., k)."""
        if self.sampled:
            return np.asarray(np.take(values, self.at[0], axis=-1, mode="clip"))
        first, middle, last = (np.take(values, at, axis=-1, mode="clip") for at in self.at)
        out: FloatArray = first + last
        out -= 2.0 * middle
        out *= self.bend
        out += middle
        return out

    def recorded(self, force: FloatArray, machine: FloatArray) -> FloatArray:
        """Force as the load channel reports it, filtered and late: (c, m) or (c, n, m), or without c."""
        pole, skew = machine[..., 2], machine[..., 1]
        if (pole > NO_FILTER_S).any():
            force = self._filtered(force, np.maximum(pole, NO_POLE_S))
        if (skew != 0.0).any():
            force = self._late(force, skew)
        return force

    def _change(self, force: FloatArray) -> FloatArray:
        """Change since the point before; none at the first of a log."""
        out = np.empty(force.shape)
        np.subtract(force[..., 1:], force[..., :-1], out=out[..., 1:])
        out[..., self.fresh] = 0.0
        return out

    def _filtered(self, force: FloatArray, pole: FloatArray) -> FloatArray:
        """One pole, exact where the force is linear in between; at rest before the first point."""
        z = self.step / pole[..., None]
        # deviation d = force - filtered follows d' + d / pole = force'
        right, fallen = self._change(force), np.expm1(-z)
        right *= fallen / -np.maximum(z, 1e-12)
        right += TINY
        late = driven(fallen + 1.0, right)
        return np.subtract(force, late, out=late)

    def _late(self, force: FloatArray, skew: FloatArray) -> FloatArray:
        """Force ``skew`` seconds ago, on the line between neighbouring points."""
        change, late, out = self._change(force), skew[..., None], force.copy()
        if (skew < 0.0).any():
            out[..., :-1] += np.clip(-late / self.step[1:], 0.0, 1.0) * change[..., 1:]
        if (skew > 0.0).any():
            change *= np.clip(late / self.step, 0.0, 1.0)
            out -= change
        return out

    def offsets(self, point: Point) -> FloatArray:
        """Contact offset of each log over the largest depth, late as force is recorded; (n, logs)."""
        late = -self.onset * (point.machine[..., 1] + point.machine[..., 2])[..., None]
        return np.asarray(late + point.own[..., int(self.effects.gain)])

    def contact(self, point: Point) -> FloatArray:
        """Contact offset of the log of each point over the largest depth, (m,) or (n, m)."""
        return self.at_points(self.offsets(point))

    def gain(self, point: Point, u: FloatArray) -> FloatArray:
        """Gain of each point at depths over the largest depth, (m,) or (n, m)."""
        ln_gain = self.at_points(point.own[..., 0])
        if self.effects.shape:
            ln_gain = ln_gain + self._by_shape(point, _shape(u))
        return np.asarray(np.exp(ln_gain))

    def _by_shape(self, point: Point, curves: FloatArray) -> FloatArray:
        """Curves of depth times the shape of each point's log, (2, ..., m) -> (..., m)."""
        own = self.at_points(np.moveaxis(point.own[..., -SHAPE:], -1, 0))
        if own.ndim < curves.ndim:
            own = own[:, None]
        return np.asarray((own * curves).sum(axis=0))

    def _behind(self, point: Point, force: FloatArray) -> FloatArray:
        """Depths over the largest depth, behind a frame that gives way to a force at the tip."""
        depth = self.travel - self.contact(point)
        if (point.machine[..., 0] != 0.0).any():
            depth = depth - point.machine[..., :1] / self.depth_mm * force
        if self.give is not None:
            depth = depth - self.give(force) / self.depth_mm
        return np.asarray(np.clip(depth, -FARTHEST, FARTHEST))

    def _yields(self, point: Point) -> bool:
        """True where the frame gives way."""
        return bool((point.machine[..., 0] != 0.0).any()) or self.give is not None

    def tip_force(self, point: Point, rounds: int = FRAME_ROUNDS) -> tuple[FloatArray, FloatArray]:
        """Force at the tip at all points, and its columns; ``rounds``: of the frame beyond the first."""
        yields, force = self._yields(point), self.guess
        for _ in range(1 + rounds * yields):
            path = self.path(self._behind(point, force), point)
            columns = self.law.columns(point.log_times, path)
            found = weighted(columns, point.linear)
            # what the frame gives way to on the way there
            force = force + self.soft * (found - force) if yields else found
        return force, columns

    def predict(self, point: Point) -> FloatArray:
        """Forces of the observations, shape (k,) [N]."""
        force, _ = self.tip_force(point)
        return self.means(self.recorded(force, point.machine)) + self._carried(point)

    def follow(self, point: Point) -> None:
        """Iterate the frame's deflection from this point's force from now on."""
        self.settled = True
        if not self._yields(point):
            self.guess = self.tip_force(point)[0]
            return
        start, moved = self.guess, np.inf
        for _ in range(SETTLING):
            if moved > SAME_SLOPES:
                path = self.path(self._behind(point, self.guess), point)
                stiffness = np.maximum(self._slopes(point, path).sudden(path), 0.0)
                self.soft = 1.0 / (1.0 + self._compliance(point) * stiffness)
            before, self.guess = self.guess, self.tip_force(point, rounds=0)[0]
            moved = float(np.abs(self.guess - before).max()) / max(float(np.abs(self.guess).max()), 1e-300)
            if moved <= SETTLED:
                break
        else:
            # of a point without a settled deflection nothing is kept
            self.settled = moved <= UNSETTLED
            self.guess = self.guess if self.settled else start

    def _compliance(self, point: Point) -> FloatArray:
        """Deflection of the frame over the largest depth by a force at the tip [1/N], (m,)."""
        out = np.full(self.guess.size, point.machine[0] / self.depth_mm)
        if self.give is not None:
            step = STEP_FORCE * max(float(np.abs(self.guess).max()), 1e-300)
            out += (self.give(self.guess + step) - self.give(self.guess)) / (step * self.depth_mm)
        return out

    def _slopes(self, point: Point, path: Path) -> Slopes:
        """Answer of the force to changes of depth, gains in it; none in air."""
        slopes, touching = self.law.slopes(point.log_times, path, point.linear), path.depth_mm > 0.0
        direct, inner = slopes.direct, slopes.inner
        if self.effects.shape:
            u = path.depth_mm / self.depth_mm
            bend = np.stack([2.0 * (u - 1.0), 2.0 - 4.0 * u])  # derivatives of the shapes
            direct = direct + self._by_shape(point, bend) * self.guess
        inner, gain = None if inner is None else inner * touching, 1.0 if path.gain is None else path.gain
        return Slopes(direct * touching, slopes.outer * touching, slopes.tau_s, inner, gain)

    def _given_way(self, point: Point, path: Path, rows: FloatArray) -> FloatArray:
        """Changes of the force that are left of ``rows``, the frame giving way to them, (c, m)."""
        slopes, compliance = self._slopes(point, path), self._compliance(point)
        sudden = slopes.sudden(path)
        soft = 1.0 / (1.0 + compliance * sudden)
        size = np.abs(rows).max(axis=1)
        out = soft * rows
        compliance = np.where(path.depth_mm <= 0.0, 0.0, compliance)
        for _ in range(SETTLING):
            deeper = compliance * out
            new = soft * (rows - slopes.change(path, deeper) + sudden * deeper)
            error, out = np.abs(new - out).max(axis=1), new
            if (error <= SETTLED * size).all():
                break
        return np.asarray(out)

    def near(self, point: Point) -> FloatArray:
        """Forces (k,) or (n, k) near the point whose force the frame's deflection is iterated from."""
        base, _ = self.tip_force(point, rounds=0)
        return self.means(self.recorded(base, point.machine)) + self._carried(point)

    def near_parts(self, point: Point) -> FloatArray:
        """The same, which is linear: without linear parameters, and their columns, (1 + p, n, k)."""
        columns = self.law.columns(point.log_times, self.path(self._behind(point, self.guess), point))
        parts = np.zeros((1 + len(columns), *columns.shape[1:]))
        soft = self.soft if self._yields(point) else np.ones(1)
        parts[0], parts[1:] = (1.0 - soft) * self.guess, soft * columns
        seen = self.means(self.recorded(parts, point.machine))
        none = np.zeros((*point.log_times.shape[:-1], self.law.linear))
        return self.carrying(seen, replace(point, linear=none))

    def derivatives(self, point: Point, *, machine: bool, follow: bool = False) -> Derivatives:
        """Forces with their derivatives; those by a machine that is not asked about are zero.

        ``follow``: iterate the frame's deflection from this point's force from now on.
        """
        if follow:
            self.follow(point)
        base = self.guess if follow and self.settled else self.tip_force(point)[0]
        behind = self._behind(point, base)
        path = self.path(behind, point)
        # differences are of forces on one and the same path
        columns = self.law.columns(point.log_times, path)
        still = point.linear @ columns
        parts = []
        for j in range(self.law.times):
            times = point.log_times.copy()
            times[j] += STEP_LN
            moved = point.linear @ self.law.columns(times, path)
            parts.append((moved - still) / STEP_LN)
        by_force = np.where(path.depth_mm <= 0.0, 0.0, -base / self.depth_mm)[None]
        none = np.zeros(base.size)
        parts += [self._slopes(point, path).change(path, by_force)[0] if machine else none]
        moved = point.linear @ self.law.columns(point.log_times, self.path(behind + STEP_DEPTH, point))
        by_contact = (still - moved) / STEP_DEPTH
        parts += [-self.at_points(self.onset) * by_contact if machine else none, *columns]
        parts += self._by_own(point, behind, (base, still, by_contact, parts[: self.law.times]))
        tip = np.stack(parts)
        if self._yields(point):
            tip = self._given_way(point, path, tip)
        found = self.means(self.recorded(np.vstack([base, tip]), point.machine)).T
        t = self.law.times
        last = t + 3 + self.law.linear
        shared = np.zeros((self.force.size, self.size))
        shared[:, : t + 1], shared[:, t + 3 :] = found[:, 1 : t + 2], found[:, t + 3 : last]
        if machine:
            for j in (1, 2):
                other = point.machine.copy()
                other[j] += STEP_MACHINE
                moved = self.means(self.recorded(base, other))
                shared[:, t + j] = (moved - found[:, 0]) / STEP_MACHINE + found[:, t + 2]
        own = found[:, last:]
        if self.remembered is not None:
            by = self.remembered.by
            shared[:, :t] += by[:, :t]
            shared[:, t + 3 :] += by[:, t:-1]
            if machine:
                shared[:, t + 1 : t + 3] -= (self.onset[self.log] * by[:, -1])[:, None]
            own[:, int(self.effects.gain)] += by[:, -1]
        return Derivatives(found[:, 0] + self._carried(point), shared, own)

    def _by_own(
        self,
        point: Point,
        behind: FloatArray,
        here: tuple[FloatArray, FloatArray, FloatArray, list[FloatArray]],
    ) -> list[FloatArray]:
        """Derivatives of the force at the tip by what is a log's own, the frame held; (m,) each.

        ``here``: that force, with the frame and on the path, and its derivatives by contact and ln times.
        """
        base, still, by_contact, by_times = here
        out = [base, by_contact] if self.effects.gain else [by_contact]
        if self.effects.time and self.law.model_of is None:
            # nothing else is sought in its logarithm: all times move together
            out.append(sum(by_times, np.zeros(behind.size)))
        elif self.effects.time:
            slower = self.law.columns(point.log_times, self.path(behind, point, STEP_LN))
            out.append((point.linear @ slower - still) / STEP_LN)
        if self.effects.shape:
            out += list(base * _shape(np.maximum(behind, 0.0)))
        return out
