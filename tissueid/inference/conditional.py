"""Linear parameters given all else: their normal, which is exact where a force is linear in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray

#: Rows (c, p) of linear parameters, and values (c,) of walls.
Walls = tuple[FloatArray, FloatArray]
#: Shares of variances that are added where linear parameters, and walls, depend on each other.
DEPENDENT, DUPLICATE = 1e-12, 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Conditional:
    """Normal of the linear parameters of a log at n points of all else."""

    mean: FloatArray  # (n, p)
    factor: FloatArray  # (n, p, p), lower, of the precision
    residual: FloatArray  # (n, k), observations without linear parameters in units of the noise
    basis: FloatArray  # (n, p, k), their columns
    log_det: FloatArray  # (n,), of the noise


def conditional(
    white: FloatArray, log_det: FloatArray, rows: FloatArray, off: FloatArray, walls: Walls
) -> Conditional:
    """Normal of the linear parameters at n points.

    ``white`` (1 + p, n, k): observations without linear parameters and their columns, in units of the noise;
    ``rows`` (c, p) and ``off`` (n, c): priors and their targets; ``walls``: rows and values as in
    :func:`on_walls`.
    """
    residual, basis = white[0], white[1:].swapaxes(0, 1)
    precision = basis @ basis.swapaxes(1, 2) + rows.T @ rows
    right = (basis @ residual[..., None])[..., 0] + off @ rows
    size = np.sqrt(np.diagonal(precision, axis1=1, axis2=2))
    scaled = precision / size[:, :, None] / size[:, None] + DEPENDENT * np.eye(rows.shape[1])
    mean = np.linalg.solve(scaled, (right / size)[..., None])[..., 0] / size
    factor = np.asarray(np.linalg.cholesky(scaled), dtype=np.float64) * size[..., None]
    return Conditional(on_walls(mean, factor, *walls), factor, residual, basis, log_det)


def on_walls(mean: FloatArray, factor: FloatArray, rows: FloatArray, least: FloatArray) -> FloatArray:
    """Means (n, p) moved in their own metrics to ``rows @ mean = least``, rows (c, p)."""
    if not len(rows):
        return mean
    y = np.linalg.solve(factor, np.broadcast_to(rows.T, (len(factor), *rows.T.shape)))
    size = np.linalg.norm(y, axis=1)
    y = y / size[:, None]
    inner = y.swapaxes(1, 2) @ y + DUPLICATE * np.eye(len(rows))
    pull = np.linalg.solve(inner, ((least - mean @ rows.T) / size)[..., None])
    return np.asarray(mean + np.linalg.solve(factor.swapaxes(1, 2), y @ pull)[..., 0])
