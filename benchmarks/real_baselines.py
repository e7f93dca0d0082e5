"""Laws of relaxation in plain numpy and scipy, to judge a fit of real recordings by.

Nothing of tissueid stands here.  Every law gives columns of a log that depend on a few shape parameters
(relaxation times, exponents); their weights are never negative and follow by non-negative least squares, so
that only the shape is searched.

* :class:`Paper`: ``F = F_s(x) + sum_j K_j(x) s_j``, ``s_j' + s_j / tau_j = x'``: K outside the convolution.
* :class:`Proportional`: the same with one curve a log that scales F_s and K alike; the relaxation is shared.
* :class:`QuasiLinear`: ``F = F_e(x) + sum_j r_j z_j``, ``z_j' + z_j / tau_j = (F_e(x))'``: inside it.
* :class:`Spectrum`: the paper's law with fixed log-spaced relaxation times and no other shape.
* :class:`Yardstick`: increasing Bernstein polynomials of depth, each with its own spectrum inside the
  convolution (Pipkin & Rogers 1968), and the spectrum of x times Bernstein polynomials of the present depth
  outside it.
* :class:`FractionalPower`: ``F = A x^p + C D^alpha x^p``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb, gamma
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Roots of the squares that span the curves which are not negative (curves between them are missed by 0.2 %).
RAYS = 9
#: Steps that each interval between samples is cut into where a curve of depth stands inside the convolution.
SUBSTEPS = 4
#: Starting relaxation times a search looks at, and starts that are polished.
GRID = 9
POLISHED = 3
#: Largest ln of the ratio of a branch to the elastic curve.
RATIO = 7.0


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """A push from contact on, at rest in the first sample."""

    name: str
    time_s: Array  # (n,)
    depth_mm: Array  # (n,), below contact
    force_N: Array  # (n,), compressive
    counted: Mask  # (n,), samples that a fit counts; the history runs through the others as well

    @property
    def peak(self) -> int:
        """Sample of the largest force."""
        return int(np.argmax(self.force_N))


def rms(residual: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(residual**2)))


def nrmsd(predicted: Array, measured: Array, span: float | None = None) -> float:
    """Root-mean-square deviation over the range of the measured force, or over ``span``."""
    width = float(np.ptp(measured)) if span is None else span
    return rms(predicted - measured) / width


def rest_states(time_s: Array, signal: Array, tau_s: Array) -> Array:
    """Solution of ``z' + z / tau = signal'`` from rest, exact where the signal is straight between samples.

    ``signal`` (n,) or (n, m); ``tau_s`` (k,), infinity gives the signal less its first value.  Returns (n, k)
    or (n, k, m).
    """
    flat = signal.reshape(signal.shape[0], -1)
    ratio = np.diff(time_s)[:, None] / tau_s
    decay = np.exp(-ratio)[:, :, None]
    share = np.where(ratio > 0.0, -np.expm1(-ratio) / np.where(ratio > 0.0, ratio, 1.0), 1.0)
    push = share[:, :, None] * np.diff(flat, axis=0)[:, None, :]
    out = np.zeros((time_s.size, tau_s.size, flat.shape[1]))
    for i in range(time_s.size - 1):
        out[i + 1] = decay[i] * out[i] + push[i]
    return out[:, :, 0] if signal.ndim == 1 else out


def fractional_derivative(time_s: Array, signal: Array, order: float) -> Array:
    """Caputo derivative of the order 0 < order < 1, exact where the signal is straight between samples."""
    step = np.diff(time_s)
    moving = step > 0.0
    start, end, slope = time_s[:-1][moving], time_s[1:][moving], np.diff(signal)[moving] / step[moving]
    power = 1.0 - order
    since = np.maximum(time_s[:, None] - start, 0.0) ** power
    until = np.maximum(time_s[:, None] - end, 0.0) ** power
    return np.asarray((since - until) @ slope / gamma(2.0 - order))


def bernstein(u: Array, degree: int) -> Array:
    """Bernstein polynomials of a degree, shape (n, degree + 1)."""
    return np.stack([comb(degree, k) * u**k * (1.0 - u) ** (degree - k) for k in range(degree + 1)], axis=1)


def increasing(u: Array, degree: int) -> Array:
    """Increasing polynomials from 0 at 0 to 1 at 1, sums of the last Bernstein ones, shape (n, degree)."""
    return np.cumsum(bernstein(u, degree)[:, ::-1], axis=1)[:, -2::-1]


def ray_coefficients(degree: int, rays: int = RAYS) -> Array:
    """Ascending coefficients of the polynomials of :func:`curve_rays`, one row each."""
    if degree == 0:
        return np.ones((1, 1))
    if degree == 1:
        return np.array([[1.0, -1.0], [0.0, 1.0]])
    roots = np.linspace(0.0, 1.0, rays)
    squares = np.column_stack([roots**2, -2.0 * roots, np.ones(rays)])
    return np.vstack([squares, [0.0, 1.0, -1.0]])


def curve_rays(u: Array, degree: int, rays: int = RAYS) -> Array:
    """Polynomials whose non-negative sums are those that are not negative on [0, 1], up to degree 2.

    Of degree 2 these are ``u (1 - u)`` and the squares ``(u - r)^2`` (Lukacs), the latter for some r.
    """
    return u[:, None] ** np.arange(degree + 1.0) @ ray_coefficients(degree, rays).T


def subdivided(log: Log, substeps: int = SUBSTEPS) -> tuple[Array, Array]:
    """Times and depths with each interval cut into equal steps; every ``substeps``-th is a sample."""
    place = np.arange(log.time_s.size, dtype=np.float64)
    fine = np.linspace(0.0, place[-1], (place.size - 1) * substeps + 1)
    return np.interp(fine, place, log.time_s), np.interp(fine, place, log.depth_mm)


def resolvable(logs: Sequence[Log], count: int) -> Array:
    """Log-spaced relaxation times from half the shortest usual step to twice the longest record."""
    shortest = min(float(np.quantile(np.diff(log.time_s), 0.1)) for log in logs)
    longest = max(float(np.ptp(log.time_s)) for log in logs)
    return np.geomspace(0.5 * max(shortest, 1e-6 * longest), 2.0 * longest, count)


def deepest(logs: Sequence[Log]) -> float:
    """Largest depth of the logs [mm]."""
    return max(float(log.depth_mm.max()) for log in logs)


class Law(Protocol):
    """Columns with non-negative weights that depend on a shape."""

    def starts(self, logs: Sequence[Log]) -> list[Array]:
        """Shapes that a search begins with."""
        ...

    def bounds(self, logs: Sequence[Log]) -> tuple[Array, Array]:
        """Least and largest shape."""
        ...

    def columns(self, log: Log, shape: Array) -> Array:
        """Columns of a log, shape (n, m)."""
        ...


def _tau_starts(logs: Sequence[Log], branches: int) -> list[Array]:
    """Logarithms of ascending relaxation times on a grid."""
    grid = np.log(resolvable(logs, GRID))
    return [np.array(one) for one in combinations(grid, branches)]


def _tau_bounds(logs: Sequence[Log], branches: int) -> tuple[Array, Array]:
    """Range of the logarithms of relaxation times, wider than the grid by a factor e."""
    grid = np.log(resolvable(logs, 2))
    return np.full(branches, grid[0] - 1.0), np.full(branches, grid[1] + 1.0)


@dataclass(frozen=True, slots=True)
class Paper:
    """Cubic static force and branches whose stiffness K(x) stands outside the convolution; shape ln tau_j."""

    branches: int
    degree: int
    depth_mm: float
    rays: int = RAYS

    def starts(self, logs: Sequence[Log]) -> list[Array]:
        return _tau_starts(logs, self.branches)

    def bounds(self, logs: Sequence[Log]) -> tuple[Array, Array]:
        return _tau_bounds(logs, self.branches)

    def columns(self, log: Log, shape: Array) -> Array:
        depth = np.maximum(log.depth_mm, 0.0)
        return self.columns_of(depth, rest_states(log.time_s, depth, np.exp(shape)))

    def columns_of(self, depth_mm: Array, states: Array) -> Array:
        """Columns of depths that are not negative, and of branch states."""
        u = depth_mm / self.depth_mm
        stiffness = curve_rays(u, self.degree, self.rays)
        static = depth_mm[:, None] * curve_rays(u, 2, self.rays)
        return np.column_stack([static, *(state[:, None] * stiffness for state in states.T)])

    def coefficients(self, weights: Array) -> tuple[Array, Array]:
        """Coefficients of F_s(x) / x, shape (3,), and of K_j(x), shape (branches, degree + 1), ascending."""
        static, stiffness = ray_coefficients(2, self.rays), ray_coefficients(self.degree, self.rays)
        first = static.shape[0]
        powers = self.depth_mm ** np.arange(3.0)
        each = weights[first:].reshape(self.branches, stiffness.shape[0])
        return weights[:first] @ static / powers, each @ stiffness / powers[: self.degree + 1]


@dataclass(frozen=True, slots=True)
class Proportional:
    """A curve q(x) of each log in ``F = q(x) (x + sum_j c_j(x) s_j)``; shape ln tau_j, then the c_j."""

    branches: int
    degree: int
    depth_mm: float

    def starts(self, logs: Sequence[Log]) -> list[Array]:
        size = self.branches * (self.degree + 1)
        return [np.concatenate([tau, np.ones(size)]) for tau in _tau_starts(logs, self.branches)]

    def bounds(self, logs: Sequence[Log]) -> tuple[Array, Array]:
        low, high = _tau_bounds(logs, self.branches)
        size = self.branches * (self.degree + 1)
        return np.concatenate([low, np.zeros(size)]), np.concatenate([high, np.full(size, np.exp(RATIO))])

    def columns(self, log: Log, shape: Array) -> Array:
        u = np.maximum(log.depth_mm, 0.0) / self.depth_mm
        states = rest_states(log.time_s, log.depth_mm, np.exp(shape[: self.branches]))
        ratios = shape[self.branches :].reshape(self.branches, self.degree + 1)
        path = log.depth_mm + ((bernstein(u, self.degree) @ ratios.T) * states).sum(axis=1)
        return path[:, None] * curve_rays(u, 2)


@dataclass(frozen=True, slots=True)
class QuasiLinear:
    """Increasing elastic curve inside the convolution; shape ln tau_j, then ln of each branch's ratio."""

    branches: int
    depth_mm: float
    curve_degree: int = 3

    def starts(self, logs: Sequence[Log]) -> list[Array]:
        return [np.concatenate([tau, np.zeros(self.branches)]) for tau in _tau_starts(logs, self.branches)]

    def bounds(self, logs: Sequence[Log]) -> tuple[Array, Array]:
        low, high = _tau_bounds(logs, self.branches)
        wide = np.full(self.branches, RATIO)
        return np.concatenate([low, -wide]), np.concatenate([high, wide])

    def columns(self, log: Log, shape: Array) -> Array:
        tau, ratio = np.exp(shape[: self.branches]), np.exp(shape[self.branches :])
        time, depth = subdivided(log)
        curves = increasing(np.maximum(depth, 0.0) / self.depth_mm, self.curve_degree)
        states = rest_states(time, curves, tau)[::SUBSTEPS]
        return np.asarray(curves[::SUBSTEPS] + np.einsum("nkm,k->nm", states, ratio))


class Shapeless:
    """A law of columns alone."""

    __slots__ = ()

    def starts(self, logs: Sequence[Log]) -> list[Array]:  # noqa: ARG002
        return [np.empty(0)]

    def bounds(self, logs: Sequence[Log]) -> tuple[Array, Array]:  # noqa: ARG002
        return np.empty(0), np.empty(0)


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum(Shapeless):
    """Cubic static force and fixed relaxation times, each with a K(x) of the degree; no shape."""

    tau_s: Array
    depth_mm: float
    degree: int = 0

    @classmethod
    def of(cls, logs: Sequence[Log], nodes: int = 12, degree: int = 0) -> Spectrum:
        """The law with log-spaced nodes over what the logs can resolve."""
        return cls(resolvable(logs, nodes), deepest(logs), degree)

    def columns(self, log: Log, shape: Array) -> Array:  # noqa: ARG002
        law = Paper(self.tau_s.size, self.degree, self.depth_mm)
        return law.columns(log, np.log(self.tau_s))


@dataclass(frozen=True, slots=True, eq=False)
class Yardstick(Shapeless):
    """Curves of depth with a spectrum each, inside the convolution and outside it; no law to quote."""

    tau_s: Array  # nodes; an infinite one is the static force
    depth_mm: float
    inside: int = 4  # degree of the increasing polynomials inside
    outside: int = 2  # and of those of the present depth outside

    @classmethod
    def of(
        cls, logs: Sequence[Log], per_decade: float = 12.0, inside: int = 4, outside: int = 2
    ) -> Yardstick:
        """The yardstick with so many nodes a decade over what the logs can resolve."""
        ends = resolvable(logs, 2)
        count = int(np.ceil(per_decade * np.log10(ends[1] / ends[0]))) + 1
        nodes = np.append(resolvable(logs, count), np.inf)
        return cls(nodes, deepest(logs), inside, outside)

    def columns(self, log: Log, shape: Array) -> Array:  # noqa: ARG002
        time, depth = subdivided(log)
        curves = increasing(np.maximum(depth, 0.0) / self.depth_mm, self.inside)
        # a record that starts in contact starts in a relaxed tissue: its first force is the static one
        inside = rest_states(time, curves, self.tau_s)[::SUBSTEPS]
        inside[:, ~np.isfinite(self.tau_s)] += curves[0]
        states = rest_states(log.time_s, log.depth_mm, self.tau_s)
        states[:, ~np.isfinite(self.tau_s)] += log.depth_mm[0]
        present = bernstein(np.maximum(log.depth_mm, 0.0) / self.depth_mm, self.outside)
        outside = states[:, :, None] * present[:, None, :]
        return np.concatenate([part.reshape(log.time_s.size, -1) for part in (inside, outside)], axis=1)


@dataclass(frozen=True, slots=True)
class FractionalPower:
    """Spring and springpot of a power of depth, ``F = A x^p + C D^alpha x^p``; shape (alpha, p)."""

    depth_mm: float

    def starts(self, logs: Sequence[Log]) -> list[Array]:  # noqa: ARG002
        return [
            np.array([order, power]) for order in (0.05, 0.15, 0.3, 0.6) for power in (1.0, 1.5, 2.0, 3.0)
        ]

    def bounds(self, logs: Sequence[Log]) -> tuple[Array, Array]:  # noqa: ARG002
        return np.array([0.005, 0.5]), np.array([0.95, 6.0])

    def columns(self, log: Log, shape: Array) -> Array:
        order, power = shape
        time, depth = subdivided(log)
        curve = (np.maximum(depth, 0.0) / self.depth_mm) ** power
        return np.column_stack([curve, fractional_derivative(time, curve, order)])[::SUBSTEPS]


def cone_weights(columns: Array, force: Array) -> Array:
    """Non-negative weights of least squares; columns are brought to one length first."""
    size = np.maximum(np.sqrt((columns**2).sum(axis=0)), 1e-300)
    scaled = columns / size
    if columns.shape[0] > columns.shape[1]:
        q, r = np.linalg.qr(scaled)
        return np.asarray(nnls(r, q.T @ force, maxiter=30 * columns.shape[1])[0] / size)
    return np.asarray(nnls(scaled, force, maxiter=30 * columns.shape[1])[0] / size)


@dataclass(frozen=True, slots=True, eq=False)
class FittedLaw:
    """A law with its shape, and weights where all logs share them."""

    law: Law
    shape: Array
    weights: Array | None  # ``None`` where each log has its own
    nrmsd: float  # over the counted samples of all logs, over the range of their forces

    def force(self, log: Log) -> Array:
        """Force along a log with the shared weights [N]."""
        if self.weights is None:
            msg = "each log has its own weights, so there is no force of a log that was not fitted"
            raise ValueError(msg)
        return self.law.columns(log, self.shape) @ self.weights


def counted_force(logs: Sequence[Log]) -> Array:
    """Forces of the counted samples, log after log [N]."""
    return np.concatenate([log.force_N[log.counted] for log in logs])


def law_residual(law: Law, logs: Sequence[Log], shape: Array, *, own: bool) -> Array:
    """Residuals of the counted samples at the best weights [N]."""
    parts = [law.columns(log, shape)[log.counted] for log in logs]
    forces = [log.force_N[log.counted] for log in logs]
    if own:
        return np.concatenate([a @ cone_weights(a, f) - f for a, f in zip(parts, forces, strict=True)])
    stacked, force = np.concatenate(parts), np.concatenate(forces)
    return np.asarray(stacked @ cone_weights(stacked, force) - force)


def _searched(law: Law, logs: Sequence[Log], *, own: bool) -> tuple[Array, Array]:
    """Best shape and its residuals: all starts are looked at, the best few polished."""
    starts = law.starts(logs)
    if starts[0].size == 0:
        return starts[0], law_residual(law, logs, starts[0], own=own)
    low, high = law.bounds(logs)
    squares = [float((law_residual(law, logs, start, own=own) ** 2).sum()) for start in starts]
    best: tuple[float, Array, Array] | None = None
    for place in np.argsort(squares)[:POLISHED]:
        found = least_squares(
            lambda shape: law_residual(law, logs, shape, own=own),
            np.clip(starts[place], low + 1e-9, high - 1e-9),
            bounds=(low, high),
            diff_step=1e-5,
            max_nfev=60,
        )
        if best is None or found.cost < best[0]:
            best = float(found.cost), found.x, found.fun
    assert best is not None
    return best[1], best[2]


def fit_law(law: Law, logs: Sequence[Log]) -> FittedLaw:
    """Least squares with one shape and one set of weights for all logs."""
    shape, residual = _searched(law, logs, own=False)
    columns = np.concatenate([law.columns(log, shape)[log.counted] for log in logs])
    force = counted_force(logs)
    return FittedLaw(law, shape, cone_weights(columns, force), rms(residual) / float(np.ptp(force)))


def fit_own(law: Law, logs: Sequence[Log]) -> FittedLaw:
    """Least squares with one shape for all logs, and weights of each log's own."""
    shape, residual = _searched(law, logs, own=True)
    return FittedLaw(law, shape, None, rms(residual) / float(np.ptp(counted_force(logs))))


def carried_to(columns: Array, log: Log) -> Array:
    """Force of a log whose own curve follows from its ramp: weights of the samples up to the peak [N].

    ``columns`` (n, m) of the log, with the relaxation that others gave.
    """
    ramp = log.counted & (np.arange(log.time_s.size) <= log.peak)
    return np.asarray(columns @ cone_weights(columns[ramp], log.force_N[ramp]))
