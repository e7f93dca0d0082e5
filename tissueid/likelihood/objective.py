"""The objective of a fit as a function of the relaxation times alone.

Variable projection (Golub & Pereyra, doi 10.1088/0266-5611/19/2/201): for given relaxation times the
best passive linear parameters are found exactly, and only ln tau is searched.  Three ways to pool the
logs of a specimen share one interface:

* :class:`PooledObjective` for ``shared`` (one static curve) and ``per-log`` (a free cubic and
  constant for every log, eliminated once), a plain quadratic form;
* :class:`PartialObjective` for ``partial`` (one tissue, a gain and a contact offset a log).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood import partial
from tissueid.likelihood.basis import KernelBasis
from tissueid.likelihood.cone import cone_least_squares, least_squares_values
from tissueid.likelihood.sums import N_STATIC, reduced_grams, reduction
from tissueid.model.polynomial import generators

__all__ = [
    "Evaluation",
    "Objective",
    "PartialObjective",
    "PooledObjective",
    "cone_start",
    "eliminate_static",
    "per_log_gram",
    "shared_gram",
]

FloatArray = NDArray[np.float64]

STATIC_PARAMETERS = 3
#: Weight, relative to the Gram diagonal, that keeps a per-log static block solvable where a log does
#: not determine all of it (a hold has no shape in x).
STATIC_RIDGE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """The optimum at given relaxation times.

    Attributes
    ----------
    value : float
        (Penalised) sum of squares [N^2].
    log_tau : ndarray, shape (branches,)
    theta : ndarray, shape (p,)
        Passive coefficients by powers of u = x / scale: of F_s/x (3; none in ``per-log``), then of
        each K.
    generators, weights : ndarray
        Support of theta in the passive cone.
    gradient : ndarray, shape (branches,)
        Derivative of value by ln tau (theta and random effects following).
    curvature : ndarray, shape (p + branches, p + branches)
        Half the Gauss-Newton Hessian in (theta, ln tau), random effects eliminated.
    gamma, delta : ndarray, shape (logs,)
        Log gains and contact offsets [mm]; empty where there are none.
    """

    value: float
    log_tau: FloatArray
    theta: FloatArray
    generators: FloatArray
    weights: FloatArray
    gradient: FloatArray
    curvature: FloatArray
    gamma: FloatArray = field(default_factory=lambda: np.zeros(0))
    delta: FloatArray = field(default_factory=lambda: np.zeros(0))


class Objective(Protocol):
    """What a search needs to know."""

    @property
    def branches(self) -> int:
        """Relaxation times to search."""
        ...

    @property
    def blocks(self) -> NDArray[np.int64]:
        """Sizes of the polynomial blocks of theta."""
        ...

    def evaluate(self, log_tau: FloatArray, warm: Evaluation | None = None) -> Evaluation:
        """The optimum at these relaxation times."""
        ...

    def values(self, points: Sequence[FloatArray]) -> FloatArray:
        """(Penalised) sums of squares at many relaxation times."""
        ...


def cone_start(blocks: NDArray[np.int64]) -> FloatArray:
    """Block-diagonal matrix of the generators that a solve begins with, shape (p, p)."""
    p = int(blocks.sum())
    start = np.zeros((p, p))
    first = 0
    for size in blocks:
        start[first : first + size, first : first + size] = generators(int(size) - 1)
        first += int(size)
    return start


def shared_gram(gram: FloatArray) -> FloatArray:
    """One static curve for all logs: the constant dropped, because F_s(0) = 0.

    Parameters
    ----------
    gram : ndarray, shape (m, m)
        Sum over logs.

    Returns
    -------
    ndarray, shape (m - 1, m - 1)
    """
    return np.ascontiguousarray(gram[1:, 1:])


def eliminate_static(gram: FloatArray, n_static: int) -> FloatArray:
    """Schur complement of the first ``n_static`` columns of one Gram matrix."""
    a = gram[:n_static, :n_static]
    unit = 1.0 / np.sqrt(np.maximum(np.diag(a), 1e-300))
    scaled = a * unit[:, None] * unit + STATIC_RIDGE * np.eye(n_static)
    cross = gram[:n_static, n_static:] * unit[:, None]
    return np.asarray(gram[n_static:, n_static:] - cross.T @ np.linalg.solve(scaled, cross))


def per_log_gram(gram: FloatArray, logs: NDArray[np.int64]) -> FloatArray:
    """A free cubic and constant for every log, eliminated; shape (m - 4, m - 4)."""
    return np.asarray(sum(eliminate_static(gram[i], N_STATIC) for i in logs))


@dataclass(frozen=True, slots=True, eq=False)
class PooledObjective:
    """``shared`` or ``per-log``: one Gram matrix, one passive least-squares problem a point.

    Attributes
    ----------
    gram : ndarray, shape (r, r)
        Columns: static x, x^2, x^3 (or none), node states by power of x, force.
    basis : KernelBasis
    scale : float
        Depth of u = 1 [mm].
    branches, degree : int
    columns_degree : int
        Degree the sums were made for.
    static : bool
        False in ``per-log``.
    """

    gram: FloatArray
    basis: KernelBasis
    scale: float
    branches: int
    degree: int
    columns_degree: int
    static: bool

    @property
    def blocks(self) -> NDArray[np.int64]:
        """Sizes of the polynomial blocks of theta."""
        static = [STATIC_PARAMETERS] if self.static else []
        return np.array(static + [self.degree + 1] * self.branches, dtype=np.int64)

    def quadratic(self, log_tau: FloatArray) -> FloatArray:
        """Gram matrix of (theta columns, their derivatives by ln tau, force), in powers of u."""
        full = reduction(self.basis, log_tau, degree=self.degree, columns_degree=self.columns_degree)
        powers = np.tile(self.scale ** -np.arange(self.degree + 1.0), self.branches)
        column = np.concatenate([np.ones(N_STATIC), powers, powers, [1.0]])
        if self.static:
            column[1:N_STATIC] = self.scale ** -np.arange(1.0, N_STATIC)
            weights = (full * column)[1:, 1:]
        else:
            weights = (full * column)[N_STATIC:, N_STATIC:]
        return np.asarray(weights.T @ self.gram @ weights)

    def values(self, points: Sequence[FloatArray]) -> FloatArray:
        """Sums of squares at many relaxation times, from one reduction of the Gram matrix."""
        every, position = np.unique(np.concatenate(points), return_inverse=True)
        size = self.degree + 1
        full = reduction(self.basis, every, degree=self.degree, columns_degree=self.columns_degree)
        scale = np.tile(self.scale ** -np.arange(float(size)), every.size)
        first = STATIC_PARAMETERS if self.static else 0
        unit = np.concatenate([self.scale ** -np.arange(1.0, N_STATIC), scale, [1.0]])[
            -scale.size - 1 - first :
        ]
        rows = slice(1 if self.static else N_STATIC, None)
        columns = np.r_[N_STATIC - first : N_STATIC + every.size * size, full.shape[1] - 1]
        weights = full[rows][:, columns] * unit
        branch = position.reshape(len(points), self.branches, 1) * size + np.arange(size) + first
        picks = np.hstack(
            [np.tile(np.arange(first), (len(points), 1)), branch.reshape(len(points), -1)]
        ).astype(np.int64)
        gram = np.ascontiguousarray(weights.T @ self.gram @ weights)
        return least_squares_values(gram, picks, self.blocks, cone_start(self.blocks))

    def evaluate(self, log_tau: FloatArray, warm: Evaluation | None = None) -> Evaluation:
        """The optimum at these relaxation times (``warm`` is not needed: one linear problem)."""
        del warm
        q = self.quadratic(log_tau)
        blocks = self.blocks
        p = int(blocks.sum())
        h = np.ascontiguousarray(q[:p, :p])
        b = np.ascontiguousarray(q[:p, -1])
        theta, support, weights = cone_least_squares(h, b, blocks, cone_start(blocks))
        value = float(q[-1, -1] - 2.0 * b @ theta + theta @ h @ theta)
        size = self.branches * (self.degree + 1)
        # columns of ln tau: K_j ds_j / dln tau_j
        to_tau = np.zeros((q.shape[0], self.branches))
        for j in range(self.branches):
            span = slice(j * (self.degree + 1), (j + 1) * (self.degree + 1))
            to_tau[p : p + size][span, j] = theta[p - size :][span]
        slopes = q @ to_tau
        residual = np.zeros(q.shape[0])
        residual[:p] = theta
        residual[-1] = -1.0
        curvature = np.zeros((p + self.branches, p + self.branches))
        curvature[:p, :p] = h
        curvature[:p, p:] = slopes[:p]
        curvature[p:, :p] = slopes[:p].T
        curvature[p:, p:] = to_tau.T @ slopes
        return Evaluation(
            value=value,
            log_tau=np.array(log_tau, dtype=np.float64),
            theta=theta,
            generators=support,
            weights=weights,
            gradient=2.0 * slopes.T @ residual,
            curvature=curvature,
        )


@dataclass(frozen=True, slots=True, eq=False)
class PartialObjective:
    """``partial``: one tissue, a random gain and a random contact offset for every log.

    Attributes
    ----------
    gram : ndarray, shape (units, m, m)
        Columns 1, x, x^2, x^3, node states by power of x, force.
    logs : ndarray of int, shape (logs,)
        Units that take part; the others are held out, without a copy.
    weight_gain : float
        (sigma / sigma_g)^2 [N^2].
    weight_offset : ndarray, shape (logs,)
        (sigma / sigma_i)^2 [N^2/mm^2].
    basis, scale, branches, degree, columns_degree
        As in :class:`PooledObjective`.
    """

    gram: FloatArray
    basis: KernelBasis
    scale: float
    branches: int
    degree: int
    columns_degree: int
    weight_gain: float
    weight_offset: FloatArray
    logs: NDArray[np.int64]

    @property
    def blocks(self) -> NDArray[np.int64]:
        """Sizes of the polynomial blocks of theta."""
        return np.array([STATIC_PARAMETERS] + [self.degree + 1] * self.branches, dtype=np.int64)

    def reduced(self, log_tau: FloatArray) -> FloatArray:
        """Reduced Gram matrices, shape (logs, r, r)."""
        every = reduced_grams(self.gram, self.basis, log_tau, degree=self.degree)
        # few are held out: a copy of the others would cost more than their products
        return every if self.logs.size == every.shape[0] else every[self.logs]

    def values(self, points: Sequence[FloatArray]) -> FloatArray:
        """Penalised sums of squares at many relaxation times, each started from the one before."""
        warm: Evaluation | None = None
        out = np.empty(len(points))
        for i, point in enumerate(points):
            warm = self.evaluate(point, warm)
            out[i] = warm.value
        return out

    def evaluate(self, log_tau: FloatArray, warm: Evaluation | None = None) -> Evaluation:
        """The optimum at these relaxation times, started from ``warm`` where given."""
        q = self.reduced(log_tau)
        blocks = self.blocks
        p = int(blocks.sum())
        logs = q.shape[0]
        gain, offset = self.weight_gain, self.weight_offset
        scale, degree, branches = self.scale, self.degree, self.branches
        start = (np.zeros(p), np.zeros(logs), np.zeros(logs))
        if warm is not None and warm.theta.size == p and warm.gamma.size == logs:
            start = (warm.theta, warm.gamma, warm.delta)
        value, theta, gamma, delta, support, weights = partial.solve(
            q, *start, gain, offset, scale, degree, branches, blocks, cone_start(blocks)
        )
        h, b, _, _, _ = partial.assemble(q, theta, gamma, delta, gain, offset, scale, degree, branches)
        return Evaluation(
            value=float(value),
            log_tau=np.array(log_tau, dtype=np.float64),
            theta=theta,
            generators=support,
            weights=weights,
            gradient=2.0 * (h[p:, :p] @ theta - b[p:]),
            curvature=h,
            gamma=gamma,
            delta=delta,
        )
