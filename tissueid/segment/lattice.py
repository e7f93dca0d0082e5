"""A lattice that fits itself to a posterior of two parameters: mean, spread and tilt, pass by pass.

Contact and branch length make up for each other, so their posterior is a narrow ridge.  The lattice is
sheared along it: every value of the first parameter comes with its own row of the second.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray

Density = Callable[[FloatArray, FloatArray], FloatArray]
Limits = tuple[float, float]

#: Nodes of the lattice along each axis, and its half width in posterior standard deviations.
NODES = 13
REACH = 3.5
#: Nodes and half width of the last one, on which moments are taken.
LAST_NODES = (29, 19)
LAST_REACH = 4.5
#: Passes that fit the lattice to the posterior.
MAX_PASSES = 24
#: A lattice fits where its mean and spread, in its own units, lie within these.
CENTRED = 0.7
SPREAD = (0.6, 1.5)
#: A mean this far out on the lattice lies at its edge; the axis is widened by this factor then.
EDGE = 2.0
EDGE_ROOM = 6.0
#: Where another mode is looked for, in sd of the first parameter, and by how much it must be higher.
PROBE = np.sinh(np.linspace(-5.3, 5.3, 15))
PROBE_GAIN = 2.0


@dataclass(frozen=True, slots=True)
class Lattice:
    """Nodes within the limits of both parameters."""

    first: FloatArray  # (n,)
    second: FloatArray  # (n, m), clipped to its limits
    inside: NDArray[np.bool_]  # (n, m)
    steps: FloatArray  # (n, m, 2), position in units of the lattice

    def mass(self, log_density: FloatArray) -> FloatArray:
        """Share of each node, shape (n, m), sum 1; nodes outside have none."""
        height = np.where(self.inside, log_density, -np.inf)
        share = np.exp(height - height.max())
        return np.asarray(share / share.sum())


def locate(density: Density, limits: tuple[Limits, Limits], guess: float, doubt: float) -> Lattice:
    """Fit a lattice to a posterior.

    ``density``: log density, shape (n, m), at first parameters (n,) and second ones (n, m); ``limits``: least
    and largest value of each parameter; ``guess``, ``doubt``: first guess of the first parameter and how far
    it may be off.
    """
    centre = np.array([guess, 0.5 * sum(limits[1])])
    shape = np.diag([max(doubt, 1e-300), 0.5 * (limits[1][1] - limits[1][0])]) / REACH
    for _ in range(MAX_PASSES):
        lattice = _lattice(centre, shape, limits, (NODES, NODES), REACH)
        log_density = density(lattice.first, lattice.second)
        mass = lattice.mass(log_density)
        middle = np.einsum("nm,nmk->k", mass, lattice.steps)
        off = lattice.steps - middle
        covariance = np.einsum("nm,nmj,nmk->jk", mass, off, off)
        spread = np.sqrt(np.diag(covariance))
        if (np.abs(middle) < CENTRED).all() and (spread > SPREAD[0]).all() and (spread < SPREAD[1]).all():
            # another mode, far off on the ridge?  Look along both axes before believing this one
            peak = float(log_density[lattice.inside].max())
            mean, sd = float(centre[0] + shape[0, 0] * middle[0]), float(shape[0, 0] * spread[0])
            other = _elsewhere(density, limits, mean, sd, peak)
            if other is None:
                break
            centre = other
            width = (limits[1][1] - limits[1][0]) / (NODES - 1)
            shape = np.diag([max(abs(float(other[0]) - mean), sd), width]) / REACH
            continue
        centre = centre + shape @ middle
        # one lattice spacing at least is kept, and a posterior that lies at the edge is given room
        covariance += np.diag(np.full(2, (1.2 * REACH / (NODES - 1)) ** 2))
        room = np.where(np.abs(middle) > EDGE, EDGE_ROOM, 1.0)
        shape = shape @ np.linalg.cholesky(covariance * np.outer(room, room))
    return _lattice(centre, shape, limits, LAST_NODES, LAST_REACH)


def _lattice(
    centre: FloatArray, shape: FloatArray, limits: tuple[Limits, Limits], nodes: tuple[int, int], reach: float
) -> Lattice:
    """Nodes around a centre along the columns of a lower triangular shape.

    Rows outside the limits of the first parameter are left out; where none is left, one at the limit is kept.
    """
    a, b = (np.linspace(-reach, reach, count) for count in nodes)
    first = centre[0] + shape[0, 0] * a
    kept = (first >= limits[0][0]) & (first <= limits[0][1])
    if not kept.any():
        nearest = np.array([np.clip(centre[0], *limits[0])])
        a, first = (nearest - centre[0]) / shape[0, 0], nearest
    else:
        a, first = a[kept], first[kept]
    second = centre[1] + shape[1, 0] * a[:, None] + shape[1, 1] * b
    inside = (second >= limits[1][0]) & (second <= limits[1][1])
    if not inside.any():
        inside = np.ones_like(inside)
    steps = np.stack(np.broadcast_arrays(a[:, None], b), axis=-1)
    return Lattice(first, np.clip(second, *limits[1]), inside, steps)


def _elsewhere(
    density: Density, limits: tuple[Limits, Limits], mean: float, sd: float, peak: float
) -> FloatArray | None:
    """Place of a density clearly higher than the peak found, ``None`` if nowhere on a wide lattice."""
    first = mean + sd * PROBE
    first = first[(first >= limits[0][0]) & (first <= limits[0][1])]
    if first.size == 0:
        return None
    second = np.linspace(*limits[1], NODES)
    height = density(first, np.broadcast_to(second, (first.size, NODES)))
    i, j = np.unravel_index(int(height.argmax()), height.shape)
    return np.array([first[i], second[j]]) if float(height[i, j]) > peak + PROBE_GAIN else None
