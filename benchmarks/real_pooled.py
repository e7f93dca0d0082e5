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
    carried_to,
    cone_weights,
    counted_force,
    ray_coefficients,
    rest_states,
    rms,
)
from scipy.optimize import least_squares

__all__ = ["GAIN", "OFFSET_MM", "PartialFit", "PartialProblem", "PerLog", "fit_partial"]

Array = NDArray[np.float64]

#: Largest ln gain of a log, and largest contact offset [mm].
GAIN, OFFSET_MM = 3.0, 1.0
#: Step of numerical derivatives.
STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class PerLog:
    """The paper's law with a static curve of each log's own and one K for all; shape ln tau_j."""

    law: Paper
    names: tuple[str, ...]

    def starts(self, logs: Sequence[Log]) -> list[Array]:
        return self.law.starts(logs)

    def bounds(self, logs: Sequence[Log]) -> tuple[Array, Array]:
        return self.law.bounds(logs)

    def columns(self, log: Log, shape: Array) -> Array:
        own = self.law.columns(log, shape)
        size = ray_coefficients(2, self.law.rays).shape[0]
        static = np.zeros((log.time_s.size, len(self.names) * size))
        place = self.names.index(log.name) * size
        static[:, place : place + size] = own[:, :size]
        return np.column_stack([static, own[:, size:]])

    def carried_to(self, fitted: FittedLaw, log: Log) -> Array:
        """Force of a log that was not fitted: its own static curve from its ramp, K as it is [N]."""
        own = self.law.columns(log, fitted.shape)
        size = ray_coefficients(2, self.law.rays).shape[0]
        assert fitted.weights is not None
        branches = own[:, size:] @ fitted.weights[len(self.names) * size :]
        rest = Log(log.name, log.time_s, log.depth_mm, log.force_N - branches, log.counted)
        return np.asarray(branches + carried_to(own[:, :size], rest, until=log.peak))


@dataclass(frozen=True, slots=True, eq=False)
class PartialFit:
    """One tissue whose logs differ by a gain and a contact offset [mm]."""

    fitted: FittedLaw
    gain: Array
    offset_mm: Array


class PartialProblem:
    """Columns of one tissue whose logs differ by a contact offset and a gain, 1 in the geometric mean.

    Parameters
    ----------
    law : Paper
    logs : sequence of Log
    """

    def __init__(self, law: Paper, logs: Sequence[Log]) -> None:
        self.law, self.logs, self.force = law, logs, counted_force(logs)
        self._key, self._states = b"", list[Array]()

    def states(self, ln_tau: Array) -> list[Array]:
        """Branch states of every log; those of the last relaxation times are kept."""
        if ln_tau.tobytes() != self._key:
            tau = np.exp(ln_tau)
            self._states = [rest_states(log.time_s, log.depth_mm, tau) for log in self.logs]
            self._key = ln_tau.tobytes()
        return self._states

    def columns(self, ln_tau: Array, ln_gain: Array, offset_mm: Array) -> Array:
        """Columns of the counted samples of all logs."""
        gain = np.exp(ln_gain - np.mean(ln_gain))
        parts = []
        for log, states, g, d in zip(self.logs, self.states(ln_tau), gain, offset_mm, strict=True):
            counted = log.counted
            parts.append(g * self.law.columns_of(log.depth_mm[counted] + d, states[counted]))
        return np.concatenate(parts)

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
        # relaxation times come last, so that the states of this point serve all others
        for place in range(z.size)[::-1]:
            there = z.copy()
            there[place] += STEP
            moved[:, place] = (self.columns(*parts(there)) @ weights - here) / STEP
        return np.asarray(moved - basis @ (basis.T @ moved))

    def gain_start(self) -> Array:
        """Logarithms of gains by the peak force over the square of depth, a crude curve of tissue."""
        level = np.log([float(log.force_N.max()) / float(log.depth_mm.max()) ** 2 for log in self.logs])
        return np.clip(level - level.mean(), -GAIN, GAIN)


def fit_partial(law: Paper, logs: Sequence[Log]) -> PartialFit:
    """Least squares with one tissue and a gain and a contact offset a log."""
    problem = PartialProblem(law, logs)
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
    fitted = FittedLaw(law, shape, weights, rms(found.fun) / float(np.ptp(problem.force)))
    return PartialFit(fitted, np.exp(gain - gain.mean()), offset)
