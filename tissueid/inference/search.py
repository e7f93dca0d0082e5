"""Global search of relaxation times: non-negative least squares over pairs and triples of nodes.

Columns of all nodes are worked out once; every combination is then a small problem on their Gram matrix.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product

import numpy as np
from scipy.optimize import nnls

from tissueid.arrays import FloatArray
from tissueid.inference.channel_law import ChannelLaw
from tissueid.inference.noise import Whitener
from tissueid.inference.prior import time_bounds
from tissueid.inference.system import Point, System

#: Nodes of ln tau, pairs from which triples are looked for, and starting points of each number of branches.
NODES, PAIRS_EXTENDED, STARTS = 27, 8, {1: 3, 2: 2, 3: 2}
#: Times that are tried of a law whose shapes are on a grid, its starting points, and shapes that have one.
GRID_NODES, GRID_STARTS, GRID_SHAPES = 7, 2, 4
#: Share of the Gram's diagonal that keeps equal columns apart.
RIDGE = 1e-10
#: Nodes between two starting points, at the least.
APART = 2


class _Combinations:
    """Misfit of every choice of nodes."""

    def __init__(self, columns: FloatArray, force: FloatArray, static: int, size: int) -> None:
        self.static, self.size = static, size
        self.scale = 1.0 / np.sqrt(np.maximum((columns**2).sum(axis=0), 1e-300))
        scaled = columns * self.scale
        self.gram = scaled.T @ scaled
        self.right = scaled.T @ force
        self.square = float(force @ force)

    def solve(self, nodes: tuple[int, ...]) -> tuple[float, FloatArray]:
        """Sum of squares and Bernstein coefficients (static, then each node's)."""
        at = [*range(self.static)]
        for node in nodes:
            at += range(self.static + node * self.size, self.static + (node + 1) * self.size)
        gram = self.gram[np.ix_(at, at)] + RIDGE * np.eye(len(at))
        root = np.linalg.cholesky(gram).T
        coefficients, _ = nnls(root, np.linalg.solve(root.T, self.right[at]))
        value = self.square - 2.0 * coefficients @ self.right[at] + coefficients @ gram @ coefficients
        return max(float(value), 0.0), coefficients * self.scale[at]


def _ranked(found: dict[tuple[int, ...], float], most: int) -> Iterator[tuple[int, ...]]:
    """The best combinations that are not neighbours of better ones."""
    kept: list[tuple[int, ...]] = []
    for nodes in sorted(found, key=lambda one: found[one]):
        if all(max(abs(a - b) for a, b in zip(nodes, other, strict=True)) >= APART for other in kept):
            kept.append(nodes)
            yield nodes
        if len(kept) == most:
            return


def observed_columns(system: System, law: ChannelLaw, shapes: FloatArray, at: Point) -> FloatArray:
    """Observed columns of a law for non-negative generators of its linear parameters, (k, linear)."""
    wide = system.under(law)
    point = Point(shapes, at.machine, np.zeros(law.linear), at.own)
    still = at.machine.copy()
    still[0] = 0.0
    compliance = at.machine[0] / system.depth_mm
    path = wide.path(wide.travel - wide.contact(point) - compliance * wide.guess)
    if system.effects.gain:
        path = replace(path, gain=wide.gain(point, path.depth_mm / system.depth_mm))
    return np.asarray(wide.means(wide.recorded(law.columns(shapes, path), still)).T) @ _generators(law)


def _generators(law: ChannelLaw) -> FloatArray:
    """Matrix from non-negative coefficients to linear parameters."""
    out = np.zeros((law.linear, law.linear))
    for one in law.blocks:
        out[one.at, one.at] = np.linalg.inv(one.bernstein)
    return out


def starting_points(system: System, law: ChannelLaw, at: Point, white: Whitener) -> list[Point]:
    """Points to start from, the best first; machine and what is the logs' own are those of ``at``.

    A third branch is also added to two times of ``at``: between nodes pairs miss more than it gains.
    """
    if law.inside or law.times == 0 or law.fixed_s.size or not law.relaxation.branches:
        return _of_grid(system, law, at, white)
    low, high = time_bounds(system)
    pair = at.log_times if at.log_times.size == law.branches - 1 > 1 else np.zeros(0)
    nodes = np.append(np.linspace(low + 0.5, high - 0.5, NODES), pair)
    target, out = white(system.force), []
    for shapes in product(*[np.log(one.starts) for one in law.shapes[law.branches :]]):
        # another number of exponentials, for columns only
        every = replace(law, branches=nodes.size, model_of=None)
        columns = observed_columns(system, every, np.concatenate([nodes, shapes]), at)
        problem = _Combinations(white(columns), target, law.static_size, law.powers)
        to = _generators(law)
        ranked = [*_ranked(_misfits(problem, law.branches), STARTS[law.branches])]
        if pair.size:
            added = [(k, *range(NODES, nodes.size)) for k in range(NODES)]
            ranked.append(min(added, key=lambda one: problem.solve(one)[0]))
        for chosen in ranked:
            value, coefficients = problem.solve(chosen)
            times = np.concatenate([nodes[list(chosen)], shapes])
            out.append((value, Point(times, at.machine, to @ coefficients, at.own)))
    out.sort(key=lambda one: one[0])
    return [point for _, point in out[: STARTS[law.branches] + (pair.size > 0)]]


def _misfits(problem: _Combinations, branches: int) -> dict[tuple[int, ...], float]:
    """Sum of squares of combinations of nodes."""
    if branches == 1:
        return {(k,): problem.solve((k,))[0] for k in range(NODES)}
    found: dict[tuple[int, ...], float]
    found = {pair: problem.solve(pair)[0] for pair in combinations(range(NODES), 2)}
    if branches == 2:
        return found
    best = sorted(found, key=lambda one: found[one])[:PAIRS_EXTENDED]
    triples = {tuple(sorted({*pair, k})) for pair in best for k in range(NODES)}
    return {three: problem.solve(three)[0] for three in triples if len(three) == 3}


def _of_grid(system: System, law: ChannelLaw, at: Point, white: Whitener) -> list[Point]:
    """Starting points of a law whose shapes are tried on a grid."""
    low, high = time_bounds(system)
    nodes = np.linspace(low + 1.0, high - 1.0, GRID_NODES)
    out: list[tuple[float, tuple[float, ...], Point]] = []
    times = [np.array(one) for one in combinations(nodes, law.counts[0])]
    further = [np.log(one.starts) for one in law.shapes[law.counts[0] :]]
    target, to = white(system.force), _generators(law)
    for time, shapes in product(times, product(*further)):
        values = np.concatenate([time, shapes])
        columns = white(observed_columns(system, law, values, at))
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        coefficients, rest = nnls(columns / size, target)
        out.append((rest, shapes, Point(values, at.machine, to @ (coefficients / size), at.own)))
    out.sort(key=lambda one: one[0])
    best = [point for _, _, point in out[:GRID_STARTS]]
    # an open machine makes valleys along shapes: each of the likeliest ones has a start of its own
    firsts: dict[tuple[float, ...], Point] = {}
    for _, shapes, point in out:
        firsts.setdefault(shapes, point)
    return [*best, *(one for one in list(firsts.values())[:GRID_SHAPES] if all(one is not b for b in best))]
