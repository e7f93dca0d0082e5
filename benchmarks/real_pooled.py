"""Least squares of the paper's law on several logs that share a tissue and differ by something."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from real_baselines import FittedLaw, Log, Paper, cone_weights, counted_force, rest_states, rms
from scipy.optimize import least_squares

Array = NDArray[np.float64]

#: Largest ln gain of a log, and largest contact offset [mm].
GAIN, OFFSET_MM = 3.0, 1.0
#: Largest ln gain at the surface and at half depth beside that at the largest depth.
SHAPE = 3.0
#: Largest ln by which a log relaxes slower than the tissue.
SLOWER = 1.0
#: Step of numerical derivatives.
STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class PooledFit:
    """A mean tissue with the gain and contact offset [mm] of each log."""

    fitted: FittedLaw
    gain: Array
    offset_mm: Array


class PooledProblem:
    """Columns of one tissue whose logs differ by a contact offset and a gain, 1 in the geometric mean."""

    def __init__(self, law: Paper, logs: Sequence[Log]) -> None:
        self.law, self.logs, self.force = law, logs, counted_force(logs)
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

    def columns(self, ln_tau: Array, ln_gain: Array, offset_mm: Array, shape: Array) -> Array:
        """Columns of the counted samples of all logs, whose shapes (logs, 3) are how much slower they relax
        (ln), and what bends their gain over depth.

        Gains and shapes count from their mean over logs, which is the tissue's.
        """
        gain, shape = ln_gain - np.mean(ln_gain), shape - shape.mean(axis=0)
        parts = []
        for i in range(len(self.logs)):
            depth, states = self.moved(i, ln_tau + shape[i, 0], float(offset_mm[i]))
            u = depth / self.law.depth_mm
            bend = (1.0 - u) * (shape[i, 1] * (1.0 - u) + 2.0 * shape[i, 2] * u)
            parts.append(np.exp(gain[i] + bend)[:, None] * self.law.columns_of(depth, states))
        return np.concatenate(parts)

    def residual(self, columns: Array) -> Array:
        """Residuals at the best weights [N]."""
        return np.asarray(columns @ cone_weights(columns, self.force) - self.force)

    def jacobian(self, z: Array, parts: Callable[[Array], tuple[Array, Array, Array, Array]]) -> Array:
        """Derivative of the residuals by all that isn't linear, the weights following (Kaufman 1975).

        ``parts``: ln tau, ln gains, contact offsets and shapes of a point z (p,).
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


def fit_pooled(law: Paper, logs: Sequence[Log], *, shaped: bool = False) -> PooledFit:
    """Least squares with a gain and a contact offset of each log's own.

    ``shaped``: a log's gain is a curve of depth, the exponential of a quadratic, and it relaxes at its rate.
    """
    problem = PooledProblem(law, logs)
    count, size = len(logs), law.branches
    bent = 3 * count if shaped else 0
    low, high = law.bounds(logs)

    def split(z: Array) -> tuple[Array, Array, Array, Array]:
        offset, shape = z[size + count : size + 2 * count], z[size + 2 * count :]
        return z[:size], z[size : size + count], offset, np.resize(shape if bent else 0.0, (count, 3))

    gains, still = problem.gain_start(), np.zeros(count)
    starts = law.starts(logs)
    flat = np.zeros((count, 3))
    squares = [(problem.residual(problem.columns(one, gains, still, flat)) ** 2).sum() for one in starts]
    first = np.concatenate([starts[int(np.argmin(squares))], gains, still, np.zeros(bent)])
    wide = np.concatenate(
        [np.repeat([GAIN + 1.0, OFFSET_MM], count), np.resize([SLOWER, SHAPE, SHAPE], bent)]
    )
    lower, upper = np.concatenate([low, -wide]), np.concatenate([high, wide])
    found = least_squares(
        lambda z: problem.residual(problem.columns(*split(z))),
        jac=lambda z: problem.jacobian(z, split),
        x0=np.clip(first, lower + 1e-6, upper - 1e-6),
        bounds=(lower, upper),
        x_scale="jac",
        max_nfev=80,
    )
    parts = split(found.x)
    weights = cone_weights(problem.columns(*parts), problem.force)
    fitted = FittedLaw(law, parts[0], weights, rms(found.fun) / float(np.ptp(problem.force)))
    return PooledFit(fitted, np.exp(parts[1] - parts[1].mean()), parts[2])
