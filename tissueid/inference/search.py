"""Global search of relaxation times: non-negative least squares over pairs and triples of nodes.

Columns of all nodes are worked out once; every combination is then a small problem on their Gram matrix.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from tissueid.inference.law import KelvinVoigtLaw
from tissueid.inference.noise import Whitener
from tissueid.inference.prior import bernstein, time_bounds
from tissueid.inference.system import Point, System
from tissueid.model.kelvin_voigt import STATIC_DEGREE

__all__ = ["starting_points"]

FloatArray = NDArray[np.float64]

#: Nodes of ln tau, pairs from which triples are looked for, and starting points of each number of branches.
NODES, PAIRS_EXTENDED, STARTS = 27, 8, {1: 3, 2: 2, 3: 2}
#: Share of the Gram's diagonal that keeps equal columns apart.
RIDGE = 1e-10
#: Nodes between two starting points, at the least.
APART = 2


class _Combinations:
    """Misfit of every choice of nodes."""

    def __init__(self, columns: FloatArray, force: FloatArray, size: int) -> None:
        self.size = size
        self.scale = 1.0 / np.sqrt(np.maximum((columns**2).sum(axis=0), 1e-300))
        scaled = columns * self.scale
        self.gram = scaled.T @ scaled
        self.right = scaled.T @ force
        self.square = float(force @ force)

    def solve(self, nodes: tuple[int, ...]) -> tuple[float, FloatArray]:
        """Sum of squares and Bernstein coefficients (static, then each node's)."""
        at = [*range(STATIC_DEGREE)]
        for node in nodes:
            at += range(STATIC_DEGREE + node * self.size, STATIC_DEGREE + (node + 1) * self.size)
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


def starting_points(system: System, branches: int, degree: int, at: Point, white: Whitener) -> list[Point]:
    """Points to start from, the best first.

    Parameters
    ----------
    system : System
    branches, degree : int
    at : Point
        Machine and own parameters of the logs are those of this point.
    white : Whitener
        Weights.
    """
    low, high = time_bounds(system)
    nodes = np.linspace(low + 0.5, high - 0.5, NODES)
    every = KelvinVoigtLaw(NODES, degree, system.depth_mm)
    wide = system.under(every)
    point = Point(nodes, at.machine, np.zeros(every.linear), at.own)
    static = at.machine.copy()
    static[0] = 0.0
    compliance = at.machine[0] / system.depth_mm
    path = wide.path(wide.travel - wide.contact(point) - compliance * wide.guess)
    gain = wide.gain(point, path.depth_mm / system.depth_mm)
    columns = wide.means(wide.recorded(gain * every.columns(nodes, path), static)).T
    size = degree + 1
    to = np.linalg.inv(bernstein(STATIC_DEGREE))
    own = np.linalg.inv(bernstein(size))
    columns[:, :STATIC_DEGREE] = columns[:, :STATIC_DEGREE] @ to
    for k in range(NODES):
        block = slice(STATIC_DEGREE + k * size, STATIC_DEGREE + (k + 1) * size)
        columns[:, block] = columns[:, block] @ own
    problem = _Combinations(white(columns), white(system.force), size)
    found: dict[tuple[int, ...], float] = {(k,): problem.solve((k,))[0] for k in range(NODES)}
    if branches >= 2:
        found = {pair: problem.solve(pair)[0] for pair in combinations(range(NODES), 2)}
    if branches == 3:
        best = sorted(found, key=lambda one: found[one])[:PAIRS_EXTENDED]
        triples = {tuple(sorted({*pair, k})) for pair in best for k in range(NODES)}
        found = {three: problem.solve(three)[0] for three in triples if len(three) == 3}
    out = []
    for chosen in _ranked(found, STARTS[branches]):
        _, coefficients = problem.solve(chosen)
        linear = np.concatenate(
            [to @ coefficients[:STATIC_DEGREE]]
            + [own @ coefficients[i : i + size] for i in range(STATIC_DEGREE, coefficients.size, size)]
        )
        out.append(Point(nodes[list(chosen)], at.machine, linear, at.own))
    return out
