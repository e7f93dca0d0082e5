"""The yardstick as the engine sees it: columns of non-negative weights, on the nodes that the data use."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.optimize import nnls

from tissueid.arrays import FloatArray
from tissueid.inference.channel_law import Block, ChannelLaw
from tissueid.inference.law import Path, Slopes, relaxation_states
from tissueid.inference.noise import Whitener
from tissueid.inference.prior import time_bounds
from tissueid.inference.search import observed_columns
from tissueid.inference.system import Point, System
from tissueid.model.base import MOST_BRANCHES
from tissueid.model.yardstick import INSIDE, OUTSIDE, Yardstick, presents, yardstick_of

#: Nodes of a decade among which the data choose, and share of the force of a node that is none.
PER_DECADE, NONE = 12.0, 1e-6
#: Steps of the grid within which neighbours stand for one node between them.
TOGETHER = 2.5


class YardstickLaw(ChannelLaw):
    """Curves of depth at nodes of time, inside the convolution and outside it."""

    @property
    def mark(self) -> Yardstick:
        """Its model."""
        assert isinstance(self.model_of, Yardstick)  # noqa: S101 -- it is made from one
        return self.model_of

    @cached_property
    def counts(self) -> tuple[int, int, int]:
        """No shapes."""
        return 0, 0, 0

    @cached_property
    def linear(self) -> int:
        """Weights."""
        return len(self.mark.parameters)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Static curve, then each node."""
        nodes = [Block(part.stiffness, j, polynomial=False) for j, part in enumerate(self.mark.parts)]
        return (Block(slice(0, INSIDE), -1, polynomial=False), *nodes)

    def columns(self, log_times: FloatArray, path: Path) -> FloatArray:  # noqa: ARG002
        """Columns along a path, shape (linear, m) or (linear, n, m)."""
        out, curves = np.empty((self.linear, *path.depth_mm.shape)), self.static.basis(path.depth_mm)
        out[:INSIDE] = curves
        many = path.depth_mm.shape[0] if path.depth_mm.ndim > 1 else None
        u = path.depth_mm / self.depth_mm
        present = presents(u)
        for j, (tau, part) in enumerate(zip(self.fixed_s, self.mark.parts, strict=True)):
            times = np.full((1,) if many is None else (1, many), tau)
            if j < len(self.mark.inside_s):
                out[part.stiffness] = relaxation_states(path, curves, times)[:, 0]
            else:
                out[part.stiffness] = present * relaxation_states(path, u, times)[0]
        return path.gained(out)

    def slopes(self, log_times: FloatArray, path: Path, linear: FloatArray) -> Slopes:  # noqa: ARG002
        """Slope of the static curve at once, of each node through what it follows."""
        x = path.depth_mm
        direct = linear[:INSIDE] @ self.static.slope(x) * self.depth_mm
        inside, outer = np.zeros((self.branches, x.size)), np.zeros((self.branches, x.size))
        step, u = 1e-6, x / self.depth_mm
        present = presents(u)
        bend = (presents(u + step) - presents(u - step)) / (2.0 * step)
        for j, part in enumerate(self.mark.parts):
            weights = linear[part.stiffness]
            if j < len(self.mark.inside_s):
                inside[j] = weights @ self.static.slope(x) * self.depth_mm
                continue
            outer[j] = weights @ present
            state = relaxation_states(path, u, self.fixed_s[j : j + 1])[0]
            direct = direct + weights @ bend * state
        return Slopes(path.gained(np.asarray(direct)), path.gained(outer), self.fixed_s, inside)

    def passive(self, block: Block) -> FloatArray:
        """No weight is negative."""
        return np.eye(block.size)

    def largest_states(self, log_times: FloatArray, path: Path) -> FloatArray:
        """Largest column of each node, (branches,)."""
        found = np.abs(self.columns(log_times, path)).max(axis=1, initial=0.0)
        return np.maximum([float(found[part.stiffness].max()) for part in self.mark.parts], 1e-9)

    def field(self, log_times: FloatArray) -> FloatArray:
        """Factors from linear parameters to units of the field, (n, linear)."""
        per = np.ones(self.linear)
        for j, part in enumerate(self.mark.parts):
            if j >= len(self.mark.inside_s):
                per[part.stiffness] = 1.0 / self.depth_mm
        return np.tile(per, (len(log_times), 1))

    def theta(self, log_times: FloatArray, linear: FloatArray, *, exact: bool = False) -> FloatArray:
        """Weights in the units of the field, of one point or of rows of points."""
        linear = np.atleast_2d(linear)
        return (linear if exact else self.lifted(linear)) * self.field(np.atleast_2d(log_times))


def _law(depth_mm: float, inside_s: FloatArray, outside_s: FloatArray) -> YardstickLaw:
    model = yardstick_of(depth_mm, tuple(inside_s.tolist()), tuple(outside_s.tolist()))
    return YardstickLaw(model.static, OUTSIDE, model.relaxation, model.branches, depth_mm, model)


def yardstick_law(system: System, at: Point, white: Whitener) -> YardstickLaw:
    """The yardstick on the nodes that non-negative least squares uses, of a dense grid."""
    low, high = time_bounds(system)
    nodes = np.exp(np.linspace(low, high, int(PER_DECADE * (high - low) / np.log(10.0)) + 1))
    dense = _law(system.depth_mm, nodes, nodes)
    columns = white(observed_columns(system, dense, np.zeros(0), at))
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    weights, _ = nnls(columns / size, white(system.force), maxiter=30 * dense.linear)
    force = np.abs(columns / size * weights).max(axis=0)
    amplitude = np.array([force[part.stiffness].sum() for part in dense.mark.parts])
    amplitude[amplitude < NONE * amplitude.max(initial=0.0)] = 0.0
    found = [_grouped(nodes, one, np.log(10.0) / PER_DECADE) for one in np.split(amplitude, 2)]
    while sum(len(tau) for tau, _ in found) > MOST_BRANCHES:
        found = _with_one_less(found)
    return _law(system.depth_mm, found[0][0], found[1][0])


def _grouped(nodes: FloatArray, amplitude: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Runs of neighbouring nodes as one at their weighted mean: a time between two is told by both."""
    used = np.flatnonzero(amplitude > 0.0)
    if used.size == 0:
        return np.zeros(0), np.zeros(0)
    runs = np.split(used, np.flatnonzero(np.diff(np.log(nodes[used])) > TOGETHER * step) + 1)
    tau = [np.exp(np.average(np.log(nodes[run]), weights=amplitude[run])) for run in runs]
    return np.array(tau), np.array([amplitude[run].sum() for run in runs])


def _with_one_less(found: list[tuple[FloatArray, FloatArray]]) -> list[tuple[FloatArray, FloatArray]]:
    """The two nearest nodes of one kind as one, where the smaller of them weighs least."""
    best, at = np.inf, (0, 0)
    for kind, (tau, amplitude) in enumerate(found):
        for k in range(len(tau) - 1):
            apart = float(np.log(tau[k + 1] / tau[k]))
            cost = apart**2 * float(np.minimum(amplitude[k], amplitude[k + 1]))
            if cost < best:
                best, at = cost, (kind, k)
    kind, k = at
    tau, amplitude = found[kind]
    pair = slice(k, k + 2)
    mean = np.exp(np.average(np.log(tau[pair]), weights=amplitude[pair]))
    both = (tau, mean), (amplitude, amplitude[pair].sum())
    times, sizes = (np.concatenate([one[:k], [new], one[k + 2 :]]) for one, new in both)
    return [(times, sizes) if one == kind else found[one] for one in range(2)]
