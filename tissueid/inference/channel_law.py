"""Any contact model, damped or not, as the engine sees it: columns along a path, a passive cone, and theta.

Linear parameters are forces [N]: static coefficients' at the largest depth, then each branch's of K_j depth
by powers of u = x / depth.  What is not linear is sought in its logarithm: relaxation times, shapes of the
static law, then of each branch the ratio of an inside channel and further shapes.  A damped law is static
columns times 1 + chi r, r the recorded speed over that at which the contact began, beside a reading in air of
each log.
"""

from __future__ import annotations

from collections.abc import Container, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.inference.law import Path, Slopes, bernstein, passive_rows, relaxation_states
from tissueid.inference.window import FittedLog, LogData
from tissueid.model.channels import ChannelModel, DampedModel, minimum_on_unit
from tissueid.model.grammar import known_laws
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.law import RelaxationLaw, Shape, StaticLaw
from tissueid.signal_noise import Lines, chain_breaks, white_noise_sd
from tissueid.trial import Segmentation, Trial, contact_frame

#: Coefficients below this share of the largest of their polynomial are rounding.
NONE, ROUNDED = 1e-13, 1e-11
#: Logarithm of a time beyond which there is none.
LARGEST_LN = 60.0
#: Room beyond the bounds of a shape's logarithm in which the force is still differentiated.
SLACK_LN = 0.01
#: Rows of a static polynomial that has to grow.
GROWING_POINTS = 41


@dataclass(frozen=True, slots=True)
class Block:
    """Linear parameters that belong together."""

    at: slice
    branch: int  # -1 of the static law
    polynomial: bool  # only their sum has to be positive; each otherwise

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self.at.stop - self.at.start)

    @property
    def bernstein(self) -> FloatArray:
        """Matrix from coefficients to those of Bernstein's polynomials on [0, 1]; to themselves of others."""
        return bernstein(self.size) if self.polynomial else np.eye(self.size)


@dataclass(frozen=True)
class ChannelLaw:
    """Law of a static law and relaxing parts."""

    static: StaticLaw
    powers: int  # of depth in each K_j; 0 where the static law itself is convolved
    relaxation: RelaxationLaw
    branches: int  # relaxing parts
    depth_mm: float
    model_of: ChannelModel | None = None  # the model that it was made from; None of a Kelvin-Voigt law

    @property
    def degree(self) -> int:
        """Degree of K; 0 inside."""
        return max(self.powers - 1, 0)

    @property
    def inside(self) -> bool:
        """True where the static law itself is convolved."""
        return self.powers == 0

    @property
    def fixed_s(self) -> FloatArray:
        """Times of a discrete spectrum."""
        return np.zeros(0) if self.model_of is None else self.model_of.fixed_s

    @cached_property
    def counts(self) -> tuple[int, int, int]:
        """Relaxation times, shapes of the static law, and further shapes of each branch, ratio included."""
        shapes = 0 if self.fixed_s.size else len(self.relaxation.shapes)
        times = min(shapes, 1) * self.branches
        return times, len(self.static.shapes), max(shapes - 1, 0) + int(self.inside)

    @cached_property
    def times(self) -> int:
        """Parameters that the force is not linear in."""
        times, static, further = self.counts
        return times + static + self.branches * further

    @cached_property
    def static_size(self) -> int:
        """Static coefficients."""
        return len(self.static.coefficients)

    @cached_property
    def linear(self) -> int:
        """Static and dynamic coefficients."""
        return self.static_size + self.branches * self.powers

    @property
    def freedom(self) -> int:
        """All of its parameters."""
        return self.times + self.linear

    @property
    def order(self) -> tuple[int, int]:
        """Relaxing parts, and degree of K."""
        return self.branches, self.degree

    @cached_property
    def linear_names(self) -> tuple[str, ...]:
        """Names of the linear parameters."""
        model = self.model()
        shapes = {one.spec.name for one in self.shapes}
        shapes |= {spec.name for spec in model.parameters if spec.name.startswith("relaxation_time")}
        return tuple(spec.name for spec in model.parameters if spec.name not in shapes)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Linear parameters that belong together."""
        first = self.static_size
        out = [Block(slice(0, first), -1, self.static.polynomial)]
        if self.powers:
            ends = range(first, self.linear, self.powers)
            out += [Block(slice(at, at + self.powers), j, polynomial=True) for j, at in enumerate(ends)]
        return tuple(out)

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """Parameters that the force is not linear in, in the engine's order; times of a law without model."""
        if self.model_of is None:
            return (*(self.relaxation.shapes[0] for _ in range(self.branches)), *self.static.shapes)
        specs = [one for one in self.model_of.layout if isinstance(one, Shape)]
        return tuple(specs[k] for k in np.argsort(self._order, kind="stable"))

    @cached_property
    def _order(self) -> NDArray[np.int64]:
        """Place among the engine's shapes of each shape in the order of theta."""
        times, static, further = self.counts
        out = [times + k for k in range(static)]
        for j in range(self.branches):
            own = [times + static + j * further + k for k in range(further)]
            ratio, rest = (own[:1], own[1:]) if self.inside else ([], own)
            out += [*ratio, *([j] if times else []), *rest]
        return np.array(out, dtype=np.int64)

    def ratio_place(self, branch: int) -> int:
        """Place among the shapes of a branch's own behind its time, the first of them the ratio if inside."""
        times, static, further = self.counts
        return times + static + branch * further

    def bounds(self, low: float, high: float) -> tuple[FloatArray, FloatArray]:
        """Bounds of the logarithms, (t,) each, times between ``low`` and ``high``."""
        ends = [
            (low, high) if one.spec.unit == "s" else tuple(np.log((one.spec.lower, one.spec.upper)).tolist())
            for one in self.shapes
        ]
        return np.array([one[0] for one in ends]), np.array([one[1] for one in ends])

    @cached_property
    def _ends(self) -> tuple[FloatArray, FloatArray]:
        return self.bounds(-LARGEST_LN, LARGEST_LN)

    def _values(self, log_times: FloatArray) -> list[Any]:
        """Shapes as numbers, or as columns (n, 1) of n points."""
        low, high = self._ends
        # a step of a search may leave the range in which a law is one; at its end it still has a slope
        values = np.exp(np.clip(log_times, low - SLACK_LN, high + SLACK_LN).T)
        return [one[:, None] if one.ndim else one for one in values]

    def _of_static(self, values: list[Any]) -> list[Any]:
        times, static, _ = self.counts
        return values[times : times + static]

    def _of_branch(self, values: list[Any], branch: int) -> list[Any]:
        """Ratio, if inside, and further shapes of a branch."""
        first = self.ratio_place(branch)
        return values[first : first + self.counts[2]]

    def _static_columns(self, path: Path, values: list[Any], out: FloatArray) -> None:
        """Columns of the static coefficients, 1 at the largest depth."""
        if self.static.polynomial:
            np.divide(path.depth_mm, self.depth_mm, out=out[0])
            for k in range(1, self.static_size):
                np.multiply(out[k - 1], out[0], out=out[k])
            return
        shapes = self._of_static(values)
        out[: self.static_size] = self.static.basis(path.depth_mm, *shapes) / self._full(shapes)

    def _full(self, shapes: list[Any]) -> FloatArray:
        """Static columns at the largest depth, (p,) or (p, n, 1)."""
        depth = np.full(np.shape(shapes[0]) if shapes else (), self.depth_mm)
        return self.static.basis(depth, *shapes)

    def _parts(self, values: list[Any], many: int | None) -> Iterator[tuple[FloatArray, FloatArray | None]]:
        """Times (j,) or (j, n) and weights of the exponentials of each relaxing part; no weights: of one."""
        times, _, _ = self.counts
        for j in range(self.branches):
            if self.relaxation.branches or self.fixed_s.size:
                tau = values[j] if times else np.full(() if many is None else (many, 1), self.fixed_s[j])
                yield np.reshape(tau, (1,) if many is None else (1, many)), None
                continue
            assert self.model_of is not None  # noqa: S101 -- only exponentials have no model
            nodes, own = self.model_of.nodes, self._of_branch(values, j)[int(self.inside) :]
            relaxed = self.relaxation.value(nodes.time_s, values[0], *own)
            weights = nodes.project @ relaxed.T
            tau = nodes.tau_s if many is None else np.repeat(nodes.tau_s[:, None], many, axis=1)
            yield tau, weights

    def _relaxed(self, path: Path, driver: FloatArray, values: list[Any]) -> Iterator[FloatArray]:
        """Relaxed driver of each part, (..., m) -> (..., m)."""
        many = path.depth_mm.shape[0] if path.depth_mm.ndim > 1 else None
        parts = list(self._parts(values, many))
        if all(weights is None for _, weights in parts):
            states = relaxation_states(path, driver, np.concatenate([tau for tau, _ in parts]))
            places = states.ndim - 1 - path.depth_mm.ndim
            yield from np.moveaxis(states, places, 0)
            return
        for tau, weights in parts:
            states = relaxation_states(path, driver, tau)
            assert weights is not None  # noqa: S101 -- all parts are of one kind
            lead = states.ndim - 1 - path.depth_mm.ndim
            share = weights.reshape((1,) * lead + weights.shape + (1,))
            yield (states * share).sum(axis=lead)

    def along(self, logs: tuple[int, ...]) -> ChannelLaw:  # noqa: ARG002
        """The same law for a path of some logs."""
        return self

    def columns(self, log_times: FloatArray, path: Path) -> FloatArray:
        """Columns along a path, shape (linear, m) or (linear, n, m)."""
        out = np.empty((self.linear, *path.depth_mm.shape))
        values = self._values(log_times)
        self._static_columns(path, values, out)
        if self.inside:
            static = out.copy()
            for j, state in enumerate(self._relaxed(path, static, values)):
                out += self._of_branch(values, j)[0] * state
            return path.gained(out)
        u = out[0] if self.static.polynomial else path.depth_mm / self.depth_mm
        at = self.static_size
        for state in self._relaxed(path, u, values):
            out[at] = state
            for k in range(1, self.powers):
                np.multiply(out[at + k - 1], u, out=out[at + k])
            at += self.powers
        return path.gained(out)

    def _static_slope(self, values: list[Any], path: Path, linear: FloatArray) -> FloatArray:
        """F_s' by depth over the largest depth, (m,) [N]."""
        shapes = self._of_static(values)
        full = self._full(shapes).reshape(self.static_size, 1)
        slope = self.static.slope(path.depth_mm, *shapes) * self.depth_mm / full
        return np.asarray(linear[: self.static_size] @ slope)

    def slopes(self, log_times: FloatArray, path: Path, linear: FloatArray) -> Slopes:
        """F_s' + sum_j K_j' s_j at once, K_j through the states, and what is inside the convolution."""
        values, u = self._values(log_times), path.depth_mm / self.depth_mm
        direct = self._static_slope(values, path, linear)
        found = list(self._parts(values, None))
        tau = np.concatenate([one[0] for one in found])
        weights = [np.ones(1) if one[1] is None else one[1] for one in found]
        if self.inside:
            ratios = [self._of_branch(values, j)[0] for j in range(self.branches)]
            share = np.concatenate([ratio * one for ratio, one in zip(ratios, weights, strict=True)])
            inner = share[:, None] * direct
            return Slopes(path.gained(direct), np.zeros((tau.size, u.size)), tau, inner)
        rows = linear[self.static_size :].reshape(self.branches, self.powers).T
        stiffness = np.polynomial.polynomial.polyval(u, rows)
        outer = np.concatenate([one[:, None] * k for one, k in zip(weights, stiffness, strict=True)])
        if self.degree:
            bend = np.polynomial.polynomial.polyval(u, np.polynomial.polynomial.polyder(rows))
            states = np.stack(list(self._relaxed(path, u, values)))
            direct = direct + (bend * states).sum(axis=0)
        return Slopes(path.gained(direct), path.gained(np.asarray(outer)), tau)

    def passive(self, block: Block) -> FloatArray:
        """Rows that keep a block passive: F_s / x, or F_s' inside, or K_j non-negative on [0, depth]."""
        if not block.polynomial:
            return np.eye(block.size)
        return _growing_rows(block.size) if self.inside else passive_rows(block.size)

    @cached_property
    def cone(self) -> FloatArray:
        """Rows of the passive cone."""
        parts = []
        for one in self.blocks:
            rows = self.passive(one)
            parts.append(np.zeros((len(rows), self.linear)))
            parts[-1][:, one.at] = rows
        return np.vstack(parts)

    def largest_states(self, log_times: FloatArray, path: Path) -> FloatArray:
        """Largest state of each branch over the largest depth, (branches,); none inside."""
        columns = self.columns(log_times, path)[self.static_size :: max(self.powers, 1)]
        return np.asarray(np.maximum(np.abs(columns).max(axis=1, initial=0.0), 1e-9))

    def model(self) -> ChannelModel:
        """The contact model with these orders."""
        if self.model_of is not None:
            return self.model_of
        return kelvin_voigt(branches=self.branches, stiffness_degree=self.degree, depth_mm=self.depth_mm)

    def lifted(self, linear: FloatArray) -> FloatArray:
        """Rows of linear parameters, each polynomial (its slope, inside) lifted by what its minimum lacks."""
        out = np.array(linear)
        for one in self.blocks:
            block = out[:, one.at]
            if not one.polynomial:
                np.maximum(block, 0.0, out=block)
                continue
            slope = self.inside and one.branch < 0
            scale = np.abs(block).max(axis=1)
            block[np.abs(block) < ROUNDED * scale[:, None]] = 0.0
            least = minimum_on_unit(block * np.arange(1.0, one.size + 1) if slope else block)
            block[:, 0] += np.where(least < 0.0, -least + 1e-14 * scale, 0.0)
            block[np.abs(block) < NONE * scale[:, None]] = 0.0
        return out

    def field(self, log_times: FloatArray) -> FloatArray:
        """Factors from linear parameters to units of the field, (n, linear) at points (n, t)."""
        n = len(log_times)
        shapes = self._of_static(self._values(log_times))
        static = np.broadcast_to(self._full(shapes).reshape(self.static_size, -1).T, (n, self.static_size))
        powers = self.depth_mm ** -np.arange(1.0, self.powers + 1)
        return np.concatenate([1.0 / static, np.tile(powers, (n, self.branches))], axis=1)

    def ln_volume(self, log_times: FloatArray, stated: Container[str]) -> FloatArray:
        """Ln of the volume of coefficients with a stated prior, by that of linear parameters, (n,)."""
        named = [k for k, name in enumerate(self.linear_names[: self.static_size]) if name in stated]
        if not (named and self.static.shapes):
            return np.zeros(len(log_times))
        return np.asarray(np.log(self.field(log_times)[:, named]).sum(axis=1))

    def theta(self, log_times: FloatArray, linear: FloatArray, *, exact: bool = False) -> FloatArray:
        """Theta [N, mm, s] of one point or rows of points; ``exact``: linear parameters are not lifted."""
        log_times, linear = np.atleast_2d(log_times), np.atleast_2d(linear)
        linear = (linear if exact else self.lifted(linear)) * self.field(log_times)
        static = linear[:, : self.static_size]
        stiffness = linear[:, self.static_size :].reshape(len(linear), self.branches, self.powers)
        shapes = np.exp(np.clip(log_times, *self._ends))[:, self._order]
        count = len(self.static.shapes)
        own = shapes[:, count:].reshape(len(linear), self.branches, -1)
        branch = np.concatenate([stiffness, own], axis=2)
        if self.counts[0] > 1:
            order = np.argsort(log_times[:, : self.branches], axis=1)
            branch = np.take_along_axis(branch, order[:, :, None], axis=1)
        return np.concatenate([static, shapes[:, :count], branch.reshape(len(linear), -1)], axis=1)


def kelvin_voigt_law(branches: int, degree: int, depth_mm: float) -> ChannelLaw:
    """Modified Kelvin-Voigt law: F_s(u) + sum_j K_j(u) s_j, the stiffness outside the convolution."""
    laws = known_laws()
    return ChannelLaw(laws["polynomial"](), degree + 1, laws["prony"](), branches, depth_mm)


@lru_cache
def _growing_rows(powers: int) -> FloatArray:
    """Rows that keep the slope of a static polynomial non-negative on [0, 1]."""
    u = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, GROWING_POINTS))
    k = np.arange(1.0, powers + 1)
    rows = k * u[:, None] ** (k - 1.0)
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


@dataclass(frozen=True)
class DampedLaw(ChannelLaw):
    """Static law with a damping parameter in the place of an inside channel's ratio."""

    logs: int = 1  # of the specimen
    only: tuple[int, ...] | None = None  # the logs that a path of some of them is of

    @cached_property
    def linear(self) -> int:
        """Static coefficients, and the reading in air of each log."""
        return self.static_size + self.logs

    def _damped(self, log_times: FloatArray, path: Path) -> FloatArray:
        """Factor on the static force, (m,) or (n, m)."""
        assert isinstance(self.model_of, DampedModel)  # noqa: S101 -- it is made from one
        factor = self.model_of.damping.factor(self._of_branch(self._values(log_times), 0)[0])
        return np.asarray(np.maximum(1.0 + factor * path.speed_ratio, 0.0))

    def columns(self, log_times: FloatArray, path: Path) -> FloatArray:
        """Columns along a path, shape (linear, m) or (linear, n, m)."""
        out = np.zeros((self.linear, *path.depth_mm.shape))
        self._static_columns(path, self._values(log_times), out)
        out[: self.static_size] *= self._damped(log_times, path)
        ends = np.append(path.fresh[1:], path.step_s.size)
        numbers = range(self.logs) if self.only is None else self.only
        for number, first, last in zip(numbers, path.fresh, ends, strict=True):
            out[self.static_size + number, ..., first:last] = 1.0
        return path.gained(out)

    def slopes(self, log_times: FloatArray, path: Path, linear: FloatArray) -> Slopes:
        """F_s' (1 + chi r); what a frame gives way to changes the depth, not the measured speed."""
        direct = self._static_slope(self._values(log_times), path, linear) * self._damped(log_times, path)
        return Slopes(path.gained(direct), np.zeros((1, direct.size)), np.ones(1))

    def theta(self, log_times: FloatArray, linear: FloatArray, *, exact: bool = False) -> FloatArray:
        """Theta of the contact model, of one point or of rows of points; readings in air are none of it."""
        return super().theta(log_times, linear[..., : self.static_size], exact=exact)

    def along(self, logs: tuple[int, ...]) -> DampedLaw:
        """The same law for a path of some logs."""
        return replace(self, only=logs)


def law_of(model: ChannelModel, logs: int) -> ChannelLaw:
    """The law of a model, as the engine fits it to a number of logs."""
    if isinstance(model, DampedModel):
        return DampedLaw(model.static, 0, model.relaxation, 1, model.depth_mm, model, logs)
    powers = model.stiffness_law.powers
    return ChannelLaw(model.static, powers, model.relaxation, model.branches, model.depth_mm, model)


#: Half of the stretch, in samples and as a share of its phase: a line errs by an eighth of a difference.
HALF_SAMPLES, HALF_SHARE = 5, 0.05
#: Root mean square distance from a line that is straight, over the noise of the travel and over the travel.
STRAIGHT, STRAIGHT_SHARE = 1.3, 1e-5
#: Samples beside a corner that say when it was, not how the tissue resists.
CORNER = 2


def with_speed_ratio(trial: Trial, segmentation: Segmentation, log: FittedLog) -> FittedLog | None:
    """A log from its samples in air on, with its speed ratio; None where no contact begins at a speed.

    Nothing relaxes under these laws: samples near the contact and in air say where the contact is not.
    """
    depth, force = contact_frame(trial, segmentation)
    speed = _speeds(trial.time_s, depth, segmentation)
    measured = np.flatnonzero(np.isfinite(speed))
    touching = depth > 0.0
    begins = np.flatnonzero(touching & ~np.append(False, touching[:-1]))
    # a corner leaves samples without a speed inside a contact, which begins no other one
    begins = begins[begins <= measured[-1]] if measured.size else begins[:0]
    at_begin = speed[measured[np.searchsorted(measured, begins)]]
    begins, at_begin = begins[at_begin > 0.0], at_begin[at_begin > 0.0]
    if not begins.size:
        return None
    contacts = np.maximum(np.searchsorted(begins, np.arange(depth.size), side="right") - 1, 0)
    ratio = np.clip(speed / at_begin[contacts], -1.0, 1.0)
    # at a corner the ratio jumps: between the samples that are left out, which a skew does not reach over
    nearest = np.rint(np.interp(np.arange(ratio.size), measured, np.arange(float(measured.size))))
    ratio = ratio[measured[nearest.astype(np.int64)]]
    first, stop = min(log.first, measured[0]), log.first + log.data.time_s.size - int(log.inserted)
    rows, include = slice(first, stop), np.isfinite(speed[first:stop])
    time, folds = trial.time_s[rows], np.zeros(include.size, dtype=np.int64)
    breaks, ratio = chain_breaks(time), ratio[rows]
    data = LogData(time, depth[rows], force[rows], include, folds, breaks=breaks, speed_ratio=ratio)
    kept = int(include.sum())
    return replace(log, data=data, first=int(first), inserted=False, n_samples=kept, tool_mm=None)


def _speeds(time: FloatArray, depth: FloatArray, segmentation: Segmentation) -> FloatArray:
    """Speed at every sample [mm/s]; NaN outside of all phases, and at corners, where it jumps."""
    speed = np.full(depth.size, np.nan)
    corners = _corners(segmentation)
    for start, last in corners:
        inner = slice(start + CORNER, last - CORNER + 1)
        if inner.stop - inner.start < 3:
            inner = slice(start, last + 1)
        speed[inner] = _slopes(time[inner], depth[inner])
    near = np.ravel([one for _, one in corners])[:, None] + np.arange(-CORNER, CORNER + 1)
    speed[near[(near >= 0) & (near < depth.size)]] = np.nan
    return speed


def _corners(segmentation: Segmentation) -> list[tuple[int, int]]:
    """First and last samples between corners; a machine keeps its speed as it meets the tissue."""
    out, met = list[tuple[int, int]](), False
    for phase in segmentation.phases:
        ends = [phase.start, *(() if phase.peak is None else (phase.peak,)), phase.stop - 1]
        if met and out:
            ends[0] = out.pop()[0]
        out += pairwise(ends)
        met = phase.kind == "approach"
    return out


def _slopes(time: FloatArray, depth: FloatArray) -> FloatArray:
    """Speed of a stretch that is straight, else slope of the line through the neighbours of each sample."""
    size = time.size
    t, x = time - time.mean(), depth - depth.mean()
    whole = float(t @ x) / max(float(t @ t), 1e-300)
    noise = white_noise_sd(time, depth)
    most = (STRAIGHT * noise) ** 2 + (STRAIGHT_SHARE * float(np.ptp(x))) ** 2
    if float(np.mean((x - whole * t) ** 2)) <= most:
        return np.full(size, whole)
    half = max(HALF_SAMPLES, int(HALF_SHARE * size))
    at = np.arange(size)
    slope, _ = Lines(t, x).slope(np.maximum(at - half, 0), np.minimum(at + half + 1, size))
    return slope
