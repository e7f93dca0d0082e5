"""All logs of a specimen under one law: predicted forces of their blocks, and derivatives of them.

A point has relaxation times, a machine (frame, skew, filter), linear coefficients, and each log's own gain,
contact and shape: a curve of depth that multiplies the whole force of the specimen, so that static force and
K of a log are in proportion and its relaxation is the specimen's.  The frame acts by the predicted force,
found by iterating from the measured one; the filter is one pole; force lags displacement by the skew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from tissueid.inference.blocks import Blocks
from tissueid.inference.law import TINY, Law, Path, Slopes

__all__ = ["MACHINE", "Derivatives", "Effects", "Point", "System"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Coordinates of the machine, in their order in a point.
MACHINE = ("frame_compliance_mm_per_N", "skew_s", "force_filter_s")
#: Iterations of the frame's deflection: each leaves compliance times stiffness of the error before.
FRAME_ROUNDS = 1
#: Iterations until a deflection has settled, and the share of the largest force that it then changes by.
SETTLING, SETTLED, UNSETTLED = 12, 1e-7, 1e-2
#: Depths over the largest depth behind a frame; what lies beyond is no deflection.
FARTHEST = 2.0
#: Share of its depth over which a log's speed at contact is taken.
ONSET_SHARE = 0.2
#: Steps of numerical derivatives: ln times, depth over the largest depth, machine in its prior's units.
STEP_LN, STEP_DEPTH = 1e-5, 1e-6
STEP_MACHINE, STEP_FORCE = 1e-6, 1e-6
#: Coefficients of a log's shape: ln gain at the surface and at half depth, beside that at the largest depth.
SHAPE = 2
#: A filter shorter than this share of the shortest step is none.
NO_FILTER_S = 1e-7


@dataclass(frozen=True, slots=True)
class Effects:
    """Own parameters of a log.

    Attributes
    ----------
    gain, contact, shape : bool
        ln gain at the largest depth; contact offset; ln gain at lesser depths beside it.
    """

    gain: bool = False
    contact: bool = True
    shape: bool = False

    @property
    def size(self) -> int:
        """Own parameters of a log."""
        return int(self.gain) + int(self.contact) + SHAPE * int(self.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """One point of the parameters.

    Attributes
    ----------
    log_times : ndarray, shape (t,)
    machine : ndarray, shape (3,)
        In the order of :data:`MACHINE`.
    linear : ndarray, shape (p,)
    own : ndarray, shape (logs, q)
        ln gain, contact offset over the largest depth, shape, as far as there are any.
    """

    log_times: FloatArray
    machine: FloatArray
    linear: FloatArray
    own: FloatArray

    @property
    def shared(self) -> FloatArray:
        """Times, machine and linear parameters as one vector."""
        return np.concatenate([self.log_times, self.machine, self.linear])

    def moved(self, shared: FloatArray, own: FloatArray | None = None) -> Point:
        """The point with another vector of shared parameters."""
        t = self.log_times.size
        return Point(shared[:t], shared[t : t + 3], shared[t + 3 :], self.own if own is None else own)


@dataclass(frozen=True, slots=True, eq=False)
class Derivatives:
    """Predicted forces and their derivatives at a point: (k,), (k, shared), (k, own)."""

    force: FloatArray
    shared: FloatArray
    own: FloatArray


def _shape(u: FloatArray) -> FloatArray:
    """Bernstein polynomials of degree 2 that vanish at the largest depth, (m, 2)."""
    left = 1.0 - u
    return np.column_stack([left * left, 2.0 * u * left])


def _onset(log: Blocks) -> float:
    """Speed at which a tool meets the tissue [mm/s]; 0 where the log begins in contact."""
    if log.depth_mm[0] >= 0.0:
        return 0.0
    first = int(np.argmax(log.depth_mm > 0.0))
    last = first + int(np.argmax(log.depth_mm[first:] >= ONSET_SHARE * log.depth_mm.max()))
    begins = max(first - 1, 0)
    time = float(log.time_s[last] - log.time_s[begins])
    return max(float(log.depth_mm[last] - log.depth_mm[begins]) / time, 0.0) if time > 0.0 else 0.0


def _bend(u: FloatArray) -> FloatArray:
    """Derivatives of :func:`_shape`, (m, 2)."""
    return np.column_stack([2.0 * (u - 1.0), 2.0 - 4.0 * u])


class System:
    """Blocks of all logs, laid one behind the other.

    Parameters
    ----------
    logs : sequence of Blocks
    law : Law
    depth_mm : float
        Largest fitted depth.
    effects : Effects
    give : callable, optional
        Deflection [mm] of a known frame under forces [N].
    """

    def __init__(
        self,
        logs: Sequence[Blocks],
        law: Law,
        depth_mm: float,
        effects: Effects,
        *,
        give: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        self.give = give
        self.logs, self.law, self.depth_mm, self.effects = tuple(logs), law, depth_mm, effects
        points = np.array([one.time_s.size for one in logs])
        first = np.concatenate([[0], np.cumsum(points)[:-1]])
        self.point_log = np.repeat(np.arange(len(logs)), points)
        self.travel = np.concatenate([one.depth_mm for one in logs]) / depth_mm
        step = np.diff(np.concatenate([one.time_s for one in logs]), prepend=0.0)
        step[first] = np.inf
        self.step = np.maximum(step, 1e-12)
        self.fresh = first
        rows = [one.at + offset for one, offset in zip(logs, first, strict=True)]
        self.at = np.concatenate(rows)
        self.sampled = bool((self.at[:, 0] == self.at[:, 2]).all())
        self.log = np.repeat(np.arange(len(logs)), [one.force_N.size for one in logs])
        self.begins = np.concatenate([[0], np.cumsum([one.force_N.size for one in logs])[:-1]])
        self.force = np.concatenate([one.force_N for one in logs])
        self.count = np.concatenate([one.count for one in logs]).astype(np.float64)
        self.chain = np.concatenate([one.chain for one in logs])
        self.obs_step = np.concatenate([one.step_s for one in logs])
        self.mid = np.concatenate([one.mid_s for one in logs])
        self.fold = np.concatenate([one.fold for one in logs])
        self.within_N2 = sum(one.within_N2 for one in logs)
        self.within_freedom = sum(one.within_freedom for one in logs)
        self.samples = int(self.count.sum())
        self.peaks = np.array([float(np.abs(one.force_N).max()) for one in logs])
        # force at all points, from which the frame's deflection is iterated: measured, then predicted
        self.guess = np.concatenate([np.interp(one.time_s, one.mid_s, one.force_N) for one in logs])
        self.soft = np.ones(self.guess.size)
        self.onset = np.array([_onset(one) for one in logs]) / depth_mm

    def under(self, law: Law) -> System:
        """The same logs under another law."""
        new = object.__new__(System)
        new.__dict__.update(self.__dict__)
        new.law = law
        return new

    @property
    def size(self) -> int:
        """Shared parameters."""
        return self.law.times + len(MACHINE) + self.law.linear

    def path(self, depth: FloatArray) -> Path:
        """Depths (over the largest depth) of all points as a path in contact."""
        touching = depth > 0.0
        crossing = np.flatnonzero(touching[1:] & ~touching[:-1]) + 1
        share = np.ones(depth.size)
        share[crossing] = depth[crossing] / (depth[crossing] - depth[crossing - 1])
        share[self.fresh] = 1.0
        return Path(self.step, np.maximum(depth, 0.0) * self.depth_mm, share, self.fresh)

    def means(self, values: FloatArray) -> FloatArray:
        """Observations of values at points: (m,) -> (k,), or of columns (m, c) -> (k, c)."""
        if self.sampled:
            return np.asarray(values[self.at[:, 0]])
        a, b, c = self.at.T
        return np.asarray((values[a] + 4.0 * values[b] + values[c]) / 6.0)

    def recorded(self, force: FloatArray, machine: FloatArray) -> FloatArray:
        """Force as the load channel reports it: filtered and late; (m,) or (m, c)."""
        _, skew, pole = machine
        if pole > NO_FILTER_S:
            force = self._filtered(force, pole)
        if skew != 0.0:
            force = self._late(force, skew)
        return force

    def _filtered(self, force: FloatArray, pole: float) -> FloatArray:
        """One pole, exact where the force is linear in between; at rest before the first point."""
        z = self.step / pole
        decay = np.exp(-z)
        weight = -np.expm1(-z) / np.maximum(z, 1e-12)
        change = np.diff(force, axis=0, prepend=force[:1])
        change[self.fresh] = 0.0
        shape = (slice(None),) + (None,) * (force.ndim - 1)
        # deviation d = force - filtered follows d' + d / pole = force'
        band = np.empty((2, force.shape[0]))
        band[0] = 1.0
        decay[self.fresh] = 0.0
        band[1, :-1] = -decay[1:]
        weight[self.fresh] = 0.0
        right = weight[shape] * change + TINY
        lag, _ = dtbtrs(band, right.reshape(force.shape[0], -1), uplo="L", diag="U")
        return np.asarray(force - lag.reshape(force.shape))

    def _late(self, force: FloatArray, skew: float) -> FloatArray:
        """Force ``skew`` seconds ago, on the line between neighbouring points."""
        shape = (slice(None),) + (None,) * (force.ndim - 1)
        if skew > 0.0:
            share = np.minimum(skew / self.step, 1.0)
            share[self.fresh] = 0.0
            change = np.diff(force, axis=0, prepend=force[:1])
            return np.asarray(force - share[shape] * change)
        ahead = np.append(self.step[1:], np.inf)
        share = np.minimum(-skew / ahead, 1.0)
        change = np.diff(force, axis=0, append=force[-1:])
        change[self.fresh - 1] = 0.0
        return np.asarray(force + share[shape] * change)

    def offsets(self, point: Point) -> FloatArray:
        """Contact offset of each log over the largest depth, (logs,).

        A contact that was found in the force was found as late as the force was recorded.
        """
        late = -self.onset * (point.machine[1] + point.machine[2])
        if self.effects.contact:
            late = late + point.own[:, int(self.effects.gain)]
        return np.asarray(late)

    def contact(self, point: Point) -> FloatArray:
        """Contact offset of the log of each point over the largest depth, (m,)."""
        return np.asarray(self.offsets(point)[self.point_log])

    def gain(self, point: Point, u: FloatArray) -> FloatArray:
        """Gain of each point at depths over the largest depth, (m,) or (1,)."""
        if not self.effects.gain:
            return np.ones(1)
        ln_gain = point.own[self.point_log, 0]
        if self.effects.shape:
            own = point.own[self.point_log, -SHAPE:]
            ln_gain = ln_gain + (own * _shape(u)).sum(axis=1)
        return np.asarray(np.exp(ln_gain))

    def _behind(self, point: Point, force: FloatArray) -> FloatArray:
        """Depths over the largest depth, behind a frame that gives way to a force at the tip."""
        depth = self.travel - self.contact(point)
        if point.machine[0] != 0.0:
            depth = depth - point.machine[0] / self.depth_mm * force
        if self.give is not None:
            depth = depth - self.give(force) / self.depth_mm
        return np.asarray(np.clip(depth, -FARTHEST, FARTHEST))

    def _yields(self, point: Point) -> bool:
        """True where the frame gives way."""
        return bool(point.machine[0] != 0.0) or self.give is not None

    def tip_force(self, point: Point, rounds: int = FRAME_ROUNDS) -> tuple[FloatArray, FloatArray]:
        """Force at the tip at all points, and the columns that it is made of, gains in them.

        Parameters
        ----------
        point : Point
        rounds : int
            Iterations of the frame's deflection beyond the first.
        """
        yields, force = self._yields(point), self.guess
        for _ in range(1 + rounds * yields):
            path = self.path(self._behind(point, force))
            columns = self.law.columns(point.log_times, path)
            columns *= self.gain(point, path.depth_mm / self.depth_mm)[:, None]
            found = columns @ point.linear
            # what the frame gives way to on the way there
            force = force + self.soft * (found - force) if yields else found
        return force, columns

    def predict(self, point: Point) -> FloatArray:
        """Forces of the observations, shape (k,) [N]."""
        force, _ = self.tip_force(point)
        return self.means(self.recorded(force, point.machine))

    def follow(self, point: Point) -> None:
        """Iterate the frame's deflection from this point's force from now on."""
        if not self._yields(point):
            self.guess = self.tip_force(point)[0]
            return
        start = self.guess
        for _ in range(SETTLING):
            path = self.path(self._behind(point, self.guess))
            stiffness = np.maximum(self._slopes(point, path).sudden(path), 0.0)
            self.soft = 1.0 / (1.0 + self._compliance(point) * stiffness)
            before, self.guess = self.guess, self.tip_force(point)[0]
            moved = float(np.abs(self.guess - before).max()) / max(float(np.abs(self.guess).max()), 1e-300)
            if moved <= SETTLED:
                break
        else:
            # of a point without a settled deflection nothing is kept
            self.guess = self.guess if moved <= UNSETTLED else start

    def _compliance(self, point: Point) -> FloatArray:
        """Deflection of the frame over the largest depth by a force at the tip [1/N], (m,)."""
        out = np.full(self.guess.size, point.machine[0] / self.depth_mm)
        if self.give is not None:
            step = STEP_FORCE * max(float(np.abs(self.guess).max()), 1e-300)
            out += (self.give(self.guess + step) - self.give(self.guess)) / (step * self.depth_mm)
        return out

    def _slopes(self, point: Point, path: Path) -> Slopes:
        """Answer of the force to changes of depth, gains in it; none in air."""
        u = path.depth_mm / self.depth_mm
        slopes, gain = self.law.slopes(point.log_times, path, point.linear), self.gain(point, u)
        direct = gain * slopes.direct
        if self.effects.shape:
            own = point.own[self.point_log, -SHAPE:]
            direct = direct + (own * _bend(u)).sum(axis=1) * self.guess
        touching = u > 0.0
        return Slopes(np.where(touching, direct, 0.0), slopes.outer * (gain * touching), slopes.tau_s)

    def _given_way(self, point: Point, path: Path, columns: FloatArray) -> FloatArray:
        """Changes of the force that are left of ``columns``, the frame giving way to them."""
        slopes, compliance = self._slopes(point, path), self._compliance(point)[:, None]
        sudden = slopes.sudden(path)[:, None]
        soft = 1.0 / (1.0 + compliance * sudden)
        size = np.abs(columns).max(axis=0)
        out = soft * columns
        for _ in range(SETTLING):
            deeper = compliance * out
            deeper[path.depth_mm <= 0.0] = 0.0
            new = soft * (columns - slopes.change(path, deeper) + sudden * deeper)
            error, out = np.abs(new - out).max(axis=0), new
            if (error <= SETTLED * size).all():
                break
        return np.asarray(out)

    def near(self, point: Point, by_contact: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Forces near the point whose force the frame's deflection is iterated from, and own derivatives.

        Parameters
        ----------
        point : Point
        by_contact : ndarray, shape (k,), optional
            Derivative of the observations by the logs' contacts, taken there once.

        Returns
        -------
        ndarray, shape (k,) and (k, q)
        """
        base, _ = self.tip_force(point, rounds=0)
        if by_contact is None:
            return self.means(self.recorded(base, point.machine)), np.zeros((self.force.size, 0))
        parts, soft = [base], self.soft if self._yields(point) else 1.0
        if self.effects.gain:
            parts.append(soft * base)
        if self.effects.shape:
            shapes = _shape(np.maximum(self._behind(point, base), 0.0))
            parts += list(soft * base * shapes.T)
        found = self.means(self.recorded(np.column_stack(parts), point.machine))
        first = 1 + int(self.effects.gain)
        own = [found[:, 1:first]]
        own += [by_contact[:, None]] if self.effects.contact else []
        return found[:, 0], np.hstack([*own, found[:, first:]])

    def derivatives(self, point: Point, *, machine: bool, follow: bool = False) -> Derivatives:
        """Forces with their derivatives.

        Parameters
        ----------
        point : Point
        machine : bool
            Differentiate by the machine too; otherwise these columns are zero.
        follow : bool
            Iterate the frame's deflection from this point's force from now on.
        """
        if follow:
            self.follow(point)
        base, _ = self.tip_force(point)
        behind = self._behind(point, base)
        path = self.path(behind)
        gain = self.gain(point, path.depth_mm / self.depth_mm)
        # differences are of forces on one and the same path
        columns = gain[:, None] * self.law.columns(point.log_times, path)
        still = columns @ point.linear
        parts = []
        for j in range(self.law.times):
            times = point.log_times.copy()
            times[j] += STEP_LN
            moved = gain * (self.law.columns(times, path) @ point.linear)
            parts.append((moved - still)[:, None] / STEP_LN)
        by_force = -(base / self.depth_mm)[:, None]
        by_force[path.depth_mm <= 0.0] = 0.0
        parts += [self._slopes(point, path).change(path, by_force)] if machine else [np.zeros((base.size, 1))]
        deeper = self.path(behind + STEP_DEPTH)
        moved = self.gain(point, deeper.depth_mm / self.depth_mm) * (
            self.law.columns(point.log_times, deeper) @ point.linear
        )
        by_contact = (still - moved)[:, None] / STEP_DEPTH
        late = -self.onset[self.point_log][:, None] * by_contact
        parts += [late if machine else np.zeros((base.size, 1)), columns]
        parts += self._by_own(base, behind, by_contact)
        tip = np.hstack(parts)
        if self._yields(point):
            tip = self._given_way(point, path, tip)
        found = self.means(self.recorded(np.column_stack([base, tip]), point.machine))
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
        return Derivatives(found[:, 0], shared, found[:, last:])

    def _by_own(self, base: FloatArray, behind: FloatArray, by_contact: FloatArray) -> list[FloatArray]:
        """Derivatives of the force at the tip by what is a log's own, the frame held; (m, c) each."""
        out = []
        if self.effects.gain:
            out.append(base[:, None])
        if self.effects.contact:
            out.append(by_contact)
        if self.effects.shape:
            out.append(base[:, None] * _shape(np.maximum(behind, 0.0)))
        return out
