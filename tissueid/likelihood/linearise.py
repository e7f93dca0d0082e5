"""A specimen linearised at its optimum: from sums over nodes to the few columns that the posterior needs.

The gains and contact offsets of the logs enter the force as products with the tissue's coefficients.  At
the joint optimum each becomes one more column per log, its derivative there; the tissue's columns keep
their full dependence on the relaxation times, as states at a few of them that span the posterior.
Columns of logs with the same tissue are then added up once for all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from tissueid.likelihood import partial
from tissueid.likelihood.basis import KernelBasis
from tissueid.likelihood.lag_sums import LagSums
from tissueid.likelihood.sums import N_STATIC

__all__ = ["Columns", "Optimum", "TauNodes", "centre", "effect_columns", "linear_columns", "tau_nodes"]

FloatArray = NDArray[np.float64]

#: Interpolation error of exp(-t/tau) between nodes of ln tau that is allowed.
INTERPOLATION = 1e-9
NODE_COUNTS = (5, 6, 7, 8, 9, 10, 12, 14, 17, 21, 26, 34, 46, 64, 90, 120)
#: Distinct steps, relative to the reference step, that differ by less are one.
SAME_RATIO = 1e-6
STATIC_PARAMETERS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Optimum:
    """Where a specimen is linearised.

    Attributes
    ----------
    theta : ndarray, shape (p,)
        Coefficients by powers of u = x / scale: of F_s/x (3; none for logs with their own static curve), then
        of each K.
    log_tau : ndarray, shape (branches,)
    gamma, delta : ndarray, shape (logs,)
        Log gains and contact offsets [mm]; zero where there are none.
    own : ndarray, shape (logs, 4)
        Static coefficients by powers of x of logs that have their own curve; zero otherwise.
    scale : float
        Depth of u = 1 [mm].
    degree : int
        Of K.
    """

    theta: FloatArray
    log_tau: FloatArray
    gamma: FloatArray
    delta: FloatArray
    own: FloatArray
    scale: float
    degree: int

    @property
    def branches(self) -> int:
        """Relaxation branches."""
        return int(self.log_tau.size)

    @property
    def static(self) -> int:
        """Static coefficients in theta: 3, or none."""
        return int(self.theta.size - self.branches * (self.degree + 1))

    def full_theta(self) -> FloatArray:
        """Theta with its static coefficients, zero where the logs have their own."""
        return np.concatenate([np.zeros(STATIC_PARAMETERS - self.static), self.theta])


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Sums in the columns of :class:`tissueid.likelihood.marginal.Linearised`, see there."""

    shared: FloatArray
    cross: FloatArray
    own: FloatArray
    ratio: FloatArray
    links: FloatArray
    count: int


def _node_rows(basis: KernelBasis, power: int) -> slice:
    nodes = basis.tau_s.size
    return slice(N_STATIC + power * nodes, N_STATIC + (power + 1) * nodes)


def centre(basis: KernelBasis, columns_degree: int, optimum: Optimum, log: int) -> FloatArray:
    """Weights of the node columns in the force of the optimum for one log.

    Returns
    -------
    ndarray, shape (4 + nodes * (columns_degree + 1),)
    """
    branches, degree = optimum.branches, optimum.degree
    matrix, _ = partial.coefficients(
        float(optimum.gamma[log]), float(optimum.delta[log]), optimum.scale, degree, branches
    )
    beta = matrix @ optimum.full_theta()
    out = np.zeros(N_STATIC + basis.tau_s.size * (columns_degree + 1))
    out[:N_STATIC] = beta[:N_STATIC] + optimum.own[log]
    if branches:
        weights, _ = basis.weights(optimum.log_tau)
        for j in range(branches):
            for power in range(degree + 1):
                rows = _node_rows(basis, power)
                out[rows] += beta[N_STATIC + j * (degree + 1) + power] * weights[:, j]
    return out


@dataclass(frozen=True, slots=True, eq=False)
class TauNodes:
    """How states of any relaxation time in a range are made of few.

    A state is interpolated between Chebyshev nodes in ln tau, and the states there are combinations of those
    at a third of them: exponentials of near relaxation times are nearly dependent.

    Attributes
    ----------
    log_tau : ndarray, shape (r,)
        The few ln(tau / s) whose states are summed.
    nodes, barycentric : ndarray, shape (q,)
        Chebyshev nodes and their barycentric weights.
    mixing : ndarray, shape (r, q)
        State at node k = sum over the few of ``mixing[:, k]``.
    """

    log_tau: FloatArray
    nodes: FloatArray
    barycentric: FloatArray
    mixing: FloatArray


def tau_nodes(low: float, high: float, time_s: FloatArray, *, shape: tuple[int, int] = (0, 0)) -> TauNodes:
    """Nodes for ln tau in a range, so that exp(-t/tau) is known to :data:`INTERPOLATION`.

    Parameters
    ----------
    low, high : float
        Range of ln(tau / s).
    time_s : ndarray, shape (n,)
        Times at which the error is looked at [s].
    shape : tuple of int
        Fewest (r, q).
    """
    between = np.linspace(low, high, 61)[1:-1]
    exact = np.exp(-time_s[:, None] / np.exp(between))
    for count in NODE_COUNTS:
        if count < shape[1]:
            continue
        angle = np.pi * (2.0 * np.arange(count) + 1.0) / (2.0 * count)
        nodes = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)
        weights = (-1.0) ** np.arange(count) * np.sin(angle)
        distance = between - nodes[:, None]
        terms = weights[:, None] / np.where(distance == 0.0, 1e-12, distance)
        terms /= terms.sum(axis=0)
        at_nodes = np.exp(-time_s[:, None] / np.exp(nodes))
        if np.abs(at_nodes @ terms - exact).max() <= INTERPOLATION:
            break
    _, r, pivots = qr(at_nodes, mode="economic", pivoting=True, check_finite=False)
    size = np.abs(np.diag(r))
    rank = min(max(int((size > INTERPOLATION * size[0]).sum()), shape[0]), count)
    few = np.sort(pivots[:rank])
    mixing = np.linalg.lstsq(at_nodes[:, few], at_nodes, rcond=None)[0]
    return TauNodes(log_tau=nodes[few], nodes=nodes, barycentric=weights, mixing=mixing)


def _shared_columns(
    basis: KernelBasis, columns_degree: int, optimum: Optimum, nodes: FloatArray, log: int
) -> FloatArray:
    """Node columns of one log -> the tissue's columns and the residual."""
    size, r = optimum.degree + 1, nodes.shape[1]
    full = N_STATIC + basis.tau_s.size * (columns_degree + 1) + 1
    out = np.zeros((full, optimum.static + optimum.branches * size * r + 1))
    matrix, _ = partial.coefficients(
        float(optimum.gamma[log]), float(optimum.delta[log]), optimum.scale, optimum.degree, optimum.branches
    )
    if optimum.static:
        out[:N_STATIC, :STATIC_PARAMETERS] = matrix[:N_STATIC, :STATIC_PARAMETERS]
    for j in range(optimum.branches):
        weights, _ = basis.weights(nodes[j])
        for q in range(size):
            first = optimum.static + (j * size + q) * r
            for power in range(q + 1):
                rows = _node_rows(basis, power)
                factor = matrix[N_STATIC + j * size + power, STATIC_PARAMETERS + j * size + q]
                out[rows, first : first + r] = factor * weights
    out[-1, -1] = 1.0
    return out


def effect_columns(
    basis: KernelBasis, columns_degree: int, optimum: Optimum, effects: tuple[str, ...], log: int
) -> FloatArray:
    """Node columns of one log -> its effects: ``gain``, ``offset``, or ``static`` (a free cubic).

    Parameters
    ----------
    basis, columns_degree, optimum, log
        As in :func:`centre`.
    effects : tuple of str

    Returns
    -------
    ndarray, shape (4 + nodes * (columns_degree + 1) + 1, q)
        The last row is that of the residual, and zero.
    """
    full = N_STATIC + basis.tau_s.size * (columns_degree + 1) + 1
    columns = []
    if "gain" in effects:
        columns.append(np.append(centre(basis, columns_degree, optimum, log), 0.0))
    if "offset" in effects:
        _, shifted = partial.coefficients(
            float(optimum.gamma[log]),
            float(optimum.delta[log]),
            optimum.scale,
            optimum.degree,
            optimum.branches,
        )
        beta = shifted @ optimum.full_theta()
        column = np.zeros(full)
        column[:N_STATIC] = beta[:N_STATIC]
        if optimum.branches:
            weights, _ = basis.weights(optimum.log_tau)
            for j in range(optimum.branches):
                for power in range(optimum.degree + 1):
                    rows = _node_rows(basis, power)
                    column[rows] += beta[N_STATIC + j * (optimum.degree + 1) + power] * weights[:, j]
        columns.append(column)
    if "static" in effects:
        columns += [np.eye(full)[k] * optimum.scale**-k for k in range(N_STATIC)]
    return np.column_stack(columns) if columns else np.zeros((full, 0))


def _kinds(sums: LagSums, ratio: FloatArray) -> FloatArray:
    """Matrices of one log in the common order: start, then later, earlier, difference of every step."""
    m = sums.start.shape[0]
    out = np.zeros((1 + 3 * ratio.size, m, m))
    out[0] = sums.start
    for k, value in enumerate(sums.ratio):
        at = int(np.abs(ratio - value).argmin())
        out[1 + 3 * at] += sums.later[k]
        out[2 + 3 * at] += sums.earlier[k]
        out[3 + 3 * at] += sums.difference[k]
    return out


def linear_columns(
    logs: Sequence[LagSums],
    basis: KernelBasis,
    optimum: Optimum,
    nodes: FloatArray,
    effects: tuple[str, ...],
    *,
    centred: Optimum,
) -> Columns:
    """Sums of a specimen in the columns of its linearised model.

    Parameters
    ----------
    logs : sequence of LagSums
    basis : KernelBasis
        Of the sums.
    optimum : Optimum
        Where the specimen is linearised.
    nodes : ndarray, shape (branches, r)
        ln tau whose states are summed (:attr:`TauNodes.log_tau`).
    effects : tuple of str
        Of every log, some of ``gain`` and ``offset``, or ``static``.
    centred : Optimum
        Whose residuals stand in the sums (:func:`centre`).
    """
    every = np.concatenate([one.ratio for one in logs])
    order = np.sort(every)
    ratio = order[np.concatenate([[True], np.diff(order) > SAME_RATIO * order[1:]])] if order.size else order
    parts, cross, own = [], [], []
    links = np.zeros(ratio.size)
    for i, one in enumerate(logs):
        tissue = _shared_columns(basis, one.degree, optimum, nodes, i)
        if centred is not optimum:
            tissue[:-1, -1] = centre(basis, one.degree, centred, i) - centre(basis, one.degree, optimum, i)
        effect = effect_columns(basis, one.degree, optimum, effects, i)
        kinds = _kinds(one, ratio)
        by_tissue = kinds @ tissue
        parts.append(tissue.T @ by_tissue)
        cross.append(effect.T @ by_tissue)
        own.append(effect.T @ kinds @ effect)
        for k, value in enumerate(one.ratio):
            links[int(np.abs(ratio - value).argmin())] += one.links[k]
    return Columns(
        shared=np.ascontiguousarray(sum(parts)),
        cross=np.ascontiguousarray(np.stack(cross)),
        own=np.ascontiguousarray(np.stack(own)),
        ratio=ratio,
        links=links,
        count=sum(one.count for one in logs),
    )
