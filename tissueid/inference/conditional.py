"""Linear parameters given all else: their normal, which is exact where a force is linear in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from tissueid.arrays import FloatArray, IntArray

#: Rows (c, p) of linear parameters, and values (c,) of walls.
Walls = tuple[FloatArray, FloatArray]
#: Share of variances that is added where linear parameters depend on each other.
DEPENDENT = 1e-12
#: Distance from a wall, over its standard deviation, that is at it, and ln of a share that it leaves whole.
AT, UNCUT = 0.05, -1e-14
#: Cosine from which one of two walls does for both, and part of a direction that others have to leave it.
ALIKE, OWN = 0.9, 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Conditional:
    """Normal of the linear parameters of a log within walls, at n points of all else."""

    mean: FloatArray  # (n, p), of the normal that no wall cuts
    factor: FloatArray  # (n, p, p), lower, of its precision
    turn: FloatArray  # (n, p, p), orthonormal: from coordinates of which the first are those of walls
    lower: FloatArray  # (n, c, c), distances from the walls by these
    slack: FloatArray  # (n, c), distances of the mean
    residual: FloatArray  # (n, k), observations without linear parameters in units of the noise
    basis: FloatArray  # (n, p, k), their columns
    log_det: FloatArray  # (n,), of the noise

    def drawn(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Linear parameters (n, p) of standard normal points (n, p), and ln of what a point's volume becomes.

        Distances from walls are drawn one after the other from normals that the walls cut, given those before
        and where those behind are zero (as GHK, doi 10.2307/2999576, but in the corner that data press into).
        """
        at, off = z.copy(), -self.slack
        ln_volume = -sum(np.log(np.diagonal(one, 0, 1, 2)).sum(axis=1) for one in (self.factor, self.lower))
        precision = np.linalg.inv(self.lower @ self.lower.swapaxes(1, 2))
        for i in range(off.shape[1]):
            sd = precision[:, i, i] ** -0.5
            mean = -(sd**2) * (precision[:, i] * off).sum(axis=1)
            inside = log_ndtr(mean / sd)
            cut = inside < UNCUT
            at[cut, i] = -ndtri_exp(inside[cut] + log_ndtr(-z[cut, i]))
            off[:, i] = mean + sd * at[:, i] - self.slack[:, i]
            ln_volume += np.log(sd) + inside + 0.5 * (at[:, i] ** 2 - z[:, i] ** 2)
        at[:, : off.shape[1]] = np.linalg.solve(self.lower, off[..., None])[..., 0]
        step = np.linalg.solve(self.factor.swapaxes(1, 2), self.turn @ at[..., None])
        return self.mean + step[..., 0], ln_volume


def conditional(
    white: FloatArray, log_det: FloatArray, rows: FloatArray, off: FloatArray, walls: Walls
) -> Conditional:
    """Normal of the linear parameters at n points.

    ``white`` (1 + p, n, k): observations without linear parameters and their columns, in units of the noise;
    ``rows`` (c, p) and ``off`` (n, c): priors and their targets; ``walls``: ``rows @ linear >= least``.
    """
    residual, basis = white[0], white[1:].swapaxes(0, 1)
    precision = basis @ basis.swapaxes(1, 2) + rows.T @ rows
    right = (basis @ residual[..., None])[..., 0] + off @ rows
    size = np.sqrt(np.diagonal(precision, axis1=1, axis2=2))
    scaled = precision / size[:, :, None] / size[:, None] + DEPENDENT * np.eye(rows.shape[1])
    mean = np.linalg.solve(scaled, (right / size)[..., None])[..., 0] / size
    factor = np.asarray(np.linalg.cholesky(scaled), dtype=np.float64) * size[..., None]
    across = np.linalg.solve(factor, np.broadcast_to(walls[0].T, (len(mean), *walls[0].T.shape)))
    turn, upper = np.linalg.qr(across, mode="complete")
    count, sign = len(walls[0]), np.ones(turn.shape[::2])
    sign[:, :count] = np.where(np.diagonal(upper, axis1=1, axis2=2) < 0.0, -1.0, 1.0)
    lower = (upper[:, :count] * sign[:, :count, None]).swapaxes(1, 2)
    turn, slack = turn * sign[:, None], mean @ walls[0].T - walls[1]
    return Conditional(mean, factor, turn, lower, slack, residual, basis, log_det)


def holding(factor: FloatArray, rows: FloatArray, slack: FloatArray) -> IntArray:
    """Numbers of walls (c, p) that a point of that ``slack`` is at, none alike, in the metric of a factor."""
    kept: list[int] = []
    across = np.linalg.solve(factor, rows.T)
    sd = np.linalg.norm(across, axis=0)
    across /= np.maximum(sd, 1e-300)
    near = np.flatnonzero((sd > 0.0) & (slack < AT * sd))
    for i in near[np.argsort(slack[near] / sd[near])].tolist():
        alike = (across[:, kept].T @ across[:, i]).max(initial=-1.0)
        if alike < ALIKE and np.linalg.svd(across[:, [*kept, i]], compute_uv=False)[-1] > OWN:
            kept.append(i)
    return np.array(kept, dtype=np.int64)
