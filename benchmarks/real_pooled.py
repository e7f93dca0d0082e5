"""Least squares of the paper's law on several logs that share a tissue and differ by something."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from real_baselines import (
    FittedLaw,
    Log,
    Paper,
    cone_weights,
    counted_force,
    ray_coefficients,
    rest_states,
    rms,
)
from scipy.optimize import least_squares

__all__ = ["GAIN", "OFFSET_MM", "PooledFit", "PooledProblem", "fit_pooled"]

Array = NDArray[np.float64]

#: Largest ln gain of a log, and largest contact offset [mm].
GAIN, OFFSET_MM = 3.0, 1.0
#: Powers of depth in a log's own static curve.
POWERS = np.array([1.0, 2.0, 3.0])
#: Step of numerical derivatives.
STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class PooledFit:
    """A mean tissue with the gain and contact offset [mm] of each log."""

    fitted: FittedLaw
    gain: Array
    offset_mm: Array


class PooledProblem:
    """Columns of one tissue whose logs differ by a contact offset and a gain, 1 in the geometric mean.

    Parameters
    ----------
    law : Paper
    logs : sequence of Log
    own_static : bool
        Give each log a static cubic of its own, of any sign, so that the gain is one of K.
    """

    def __init__(self, law: Paper, logs: Sequence[Log], *, own_static: bool = False) -> None:
        self.law, self.logs, self.force = law, logs, counted_force(logs)
        self.own_static = own_static and len(logs) > 1
        self._size = ray_coefficients(2, law.rays).shape[0]
        self._kept: dict[int, tuple[tuple[bytes, float], tuple[Array, Array]]] = {}

    def moved(self, place: int, ln_tau: Array, offset_mm: float) -> tuple[Array, Array]:
        """Depths and branch states of a log's counted samples; those of its last point are kept."""
        key = (ln_tau.tobytes(), offset_mm)
        kept = self._kept.get(place)
        if kept is not None and kept[0] == key:
            return kept[1]
        log = self.logs[place]
        # tissue that isn't touched yet is at rest
        depth = np.maximum(log.depth_mm + offset_mm, 0.0)
        states = rest_states(log.time_s, depth, np.exp(ln_tau))
        self._kept[place] = key, (depth[log.counted], states[log.counted])
        return self._kept[place][1]

    def columns(self, ln_tau: Array, ln_gain: Array, offset_mm: Array) -> Array:
        """Columns of the counted samples of all logs."""
        gain = np.exp(ln_gain - np.mean(ln_gain))
        parts = []
        for i in range(len(self.logs)):
            depth, states = self.moved(i, ln_tau, float(offset_mm[i]))
            own = gain[i] * self.law.columns_of(depth, states)
            if self.own_static:
                powers = (depth / self.law.depth_mm)[:, None] ** POWERS
                blocks = np.zeros((depth.size, len(self.logs), 2 * POWERS.size))
                blocks[:, i] = np.column_stack([powers, -powers])
                own = np.column_stack([blocks.reshape(depth.size, -1), own[:, self._size :]])
            parts.append(own)
        return np.concatenate(parts)

    def tissue(self, weights: Array) -> Array:
        """Weights of the law, of the mean static curve where each log has its own."""
        if not self.own_static:
            return weights
        last = len(self.logs) * 2 * POWERS.size
        each = weights[:last].reshape(len(self.logs), 2, POWERS.size)
        mean = (each[:, 0] - each[:, 1]).mean(axis=0) / self.law.depth_mm
        static = np.linalg.lstsq(ray_coefficients(2, self.law.rays).T, mean, rcond=None)[0]
        return np.concatenate([static, weights[last:]])

    def residual(self, columns: Array) -> Array:
        """Residuals at the best weights [N]."""
        return np.asarray(columns @ cone_weights(columns, self.force) - self.force)

    def jacobian(self, z: Array, parts: Callable[[Array], tuple[Array, Array, Array]]) -> Array:
        """Derivative of the residuals by all that isn't linear, the weights following (Kaufman 1975).

        Parameters
        ----------
        z : ndarray, shape (p,)
        parts : callable
            ln tau, ln gains and contact offsets of a point.
        """
        columns = self.columns(*parts(z))
        weights = cone_weights(columns, self.force)
        active = weights > 0.0
        basis = np.linalg.qr(columns[:, active] * weights[active])[0]
        here = columns @ weights
        moved = np.empty((here.size, z.size))
        for place in range(z.size):
            there = z.copy()
            there[place] += STEP
            moved[:, place] = (self.columns(*parts(there)) @ weights - here) / STEP
        return np.asarray(moved - basis @ (basis.T @ moved))

    def gain_start(self) -> Array:
        """Logarithms of gains by the peak force over the square of depth, a crude curve of tissue."""
        level = np.log([float(log.force_N.max()) / float(log.depth_mm.max()) ** 2 for log in self.logs])
        return np.clip(level - level.mean(), -GAIN, GAIN)


def fit_pooled(law: Paper, logs: Sequence[Log], *, own_static: bool = False) -> PooledFit:
    """Least squares with a gain, a contact offset and, if wanted, a static curve of each log's own."""
    problem = PooledProblem(law, logs, own_static=own_static)
    count, size = len(logs), law.branches
    low, high = law.bounds(logs)

    def split(z: Array) -> tuple[Array, Array, Array]:
        return z[:size], z[size : size + count], z[size + count :]

    gains, still = problem.gain_start(), np.zeros(count)
    starts = law.starts(logs)
    squares = [(problem.residual(problem.columns(one, gains, still)) ** 2).sum() for one in starts]
    first = np.concatenate([starts[int(np.argmin(squares))], gains, still])
    lower = np.concatenate([low, np.full(count, -GAIN - 1.0), np.full(count, -OFFSET_MM)])
    upper = np.concatenate([high, np.full(count, GAIN + 1.0), np.full(count, OFFSET_MM)])
    found = least_squares(
        lambda z: problem.residual(problem.columns(*split(z))),
        jac=lambda z: problem.jacobian(z, split),
        x0=np.clip(first, lower + 1e-6, upper - 1e-6),
        bounds=(lower, upper),
        x_scale="jac",
        max_nfev=80,
    )
    shape, gain, offset = split(found.x)
    weights = cone_weights(problem.columns(shape, gain, offset), problem.force)
    fitted = FittedLaw(law, shape, problem.tissue(weights), rms(found.fun) / float(np.ptp(problem.force)))
    return PooledFit(fitted, np.exp(gain - gain.mean()), offset)
