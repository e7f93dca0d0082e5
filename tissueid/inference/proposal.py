"""Independent proposals: the normal approximation at the optimum, cut to the passive set.

Many chains of hit-and-run (Smith 1984, doi 10.1287/opre.32.6.1296) walk in the polytope in whitened
coordinates, where the normal is a sphere; their states are independent of each other, and their density is
known up to a constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.special import ndtr, ndtri

from tissueid.arrays import FloatArray, IntArray

#: Chains, steps of each for every coordinate, and width over that of the normal approximation.
CHAINS, STEPS_EACH, WIDER = 1000, 40, 1.06
#: Shares of the steps that change one slack of a likely constraint, and none.
ONE_SLACK, NO_SLACK = 0.6, 0.2
#: Half width of the box in which a starting point is sought.
REACH = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class CutNormal:
    """A normal in whitened coordinates, cut by half spaces."""

    centre: FloatArray  # (d,)
    width: float
    #: (c, d): half spaces ``rows @ z >= least``.
    rows: FloatArray
    least: FloatArray  # (c,)
    pool: FloatArray  # (n, d), draws

    def _whole(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws of the normal that is not cut, shape (count, d)."""
        return self.centre + self.width * rng.standard_normal((count, self.centre.size))

    def _inside(self, z: FloatArray) -> FloatArray:
        """Those of some points that the half spaces leave, (n, d) -> (k, d)."""
        return z[(z @ self.rows.T >= self.least).all(axis=1)]

    def left(self, rng: np.random.Generator) -> float:
        """Share of the normal that the half spaces leave."""
        return len(self._inside(self._whole(CHAINS, rng))) / CHAINS

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws by rejection, shape (count, d)."""
        parts, known = [], 0
        while known < count:
            parts.append(self._inside(self._whole(2 * (count - known), rng)))
            known += len(parts[-1])
        return np.concatenate(parts)[:count]

    def log_density(self, z: FloatArray) -> FloatArray:
        """Up to a constant, within the polytope; (n, d) -> (n,)."""
        return np.asarray(-0.5 * ((z - self.centre) ** 2).sum(axis=-1) / self.width**2)


def _truncated(mean: FloatArray, sd: float, low: FloatArray, high: FloatArray, u: FloatArray) -> FloatArray:
    """Normal draws between bounds, by the tail that is nearer."""
    a, b = (low - mean) / sd, (high - mean) / sd
    flip = a > 0.0
    a, b = np.where(flip, -b, a), np.where(flip, -a, b)
    p, q = ndtr(a), ndtr(b)
    z = ndtri(np.clip(p + u * (q - p), 1e-300, 1.0 - 1e-16))
    far = q < 1e-290
    if far.any():
        # beyond this the normal's tail is exponential
        rate = np.maximum(-b[far], 1.0)
        z[far] = b[far] + np.log1p(-u[far] * -np.expm1(np.maximum(rate * (a[far] - b[far]), -700.0))) / rate
    z = np.clip(z, a, b)
    return np.asarray(mean + sd * np.where(flip, -z, z))


def _inside(rows: FloatArray, least: FloatArray) -> FloatArray:
    """Point of the polytope far from its walls, near zero."""
    c, d = rows.shape
    found = linprog(
        np.append(np.zeros(d), -1.0),
        A_ub=np.hstack([-rows, np.ones((c, 1))]),
        b_ub=-least,
        bounds=[(-REACH, REACH)] * d + [(0.0, 1.0)],
        method="highs",
    )
    return np.asarray(found.x[:d]) if found.x is not None else np.zeros(d)


def _directions(key: FloatArray, d: int, steps: int, rng: np.random.Generator) -> FloatArray:
    """Unit directions of the walk: one slack at a time, none of them, or at random.

    ``key`` (k, d): rows of the constraints that are likely to be active.
    """
    out = rng.standard_normal((steps, d))
    if len(key):
        dual = np.linalg.pinv(key, rcond=1e-10)
        kind = rng.random(steps)
        one = kind < ONE_SLACK
        out[one] = dual.T[rng.integers(len(key), size=int(one.sum()))]
        free = (kind >= ONE_SLACK) & (kind < ONE_SLACK + NO_SLACK)
        out[free] -= out[free] @ key.T @ dual.T
    size = np.linalg.norm(out, axis=1, keepdims=True)
    return np.asarray(out / np.maximum(size, 1e-300))


def cut_normal(
    centre: FloatArray, rows: FloatArray, least: FloatArray, likely: IntArray, rng: np.random.Generator
) -> CutNormal:
    """Draw from a normal of width :data:`WIDER` around a centre with ``rows @ z >= least``.

    ``centre`` (d,); ``rows`` (c, d), ``least`` (c,); ``likely``: rows that may be active.
    """
    d = centre.size
    size = np.linalg.norm(rows, axis=1)
    likely = likely[size[likely] > 0.0]
    key = rows[likely] / size[likely, None]
    kept = size > 0.0
    rows, least = rows[kept] / size[kept, None], np.minimum(least[kept] / size[kept], -1e-9)
    z = np.repeat(_inside(rows, least)[None], CHAINS, axis=0)
    slack = z @ rows.T - least
    for direction in _directions(key, d, STEPS_EACH * d, rng):
        along = rows @ direction
        up, down = along > 1e-12, along < -1e-12
        low = np.full(CHAINS, -np.inf)
        high = np.full(CHAINS, np.inf)
        if up.any():
            low = (-slack[:, up] / along[up]).max(axis=1)
        if down.any():
            high = (slack[:, down] / -along[down]).min(axis=1)
        mean = (centre - z) @ direction
        move = _truncated(mean, WIDER, np.minimum(low, 0.0), np.maximum(high, 0.0), rng.random(CHAINS))
        z += move[:, None] * direction
        slack += move[:, None] * along
    return CutNormal(centre, WIDER, rows, least, z)
