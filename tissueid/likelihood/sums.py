"""Everything the Gaussian likelihood needs of a log, in one matrix, from one pass over its samples.

The model is linear in all but the relaxation times, and the branch state of any relaxation time is a
weighted sum of the states at the nodes of a :class:`~tissueid.likelihood.basis.KernelBasis`.  The
Gram matrix of ``[1, x, x^2, x^3, s_k x^p, force]`` therefore holds the sum of squared residuals of
every candidate model; its size does not depend on the number of samples, and logs are merged by
adding.  The columns s_k x^p are one set of states times powers of x: all their products are the Gram
matrices ``sum x^q s_k s_l`` for q up to twice the degree.  Work: samples x nodes^2 / 2 multiply-adds
for each of them, memory flat.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.basis import KernelBasis
from tissueid.likelihood.gram_kernels import (
    add_grams,
    aligned_zeros,
    chunk_samples,
    mirrored,
    places,
    tiled_columns,
)
from tissueid.likelihood.kernels import fill_powers, fill_states

__all__ = [
    "N_STATIC",
    "LogData",
    "LogSums",
    "StepTables",
    "log_sums",
    "reduced_grams",
    "reduction",
    "step_tables",
]

FloatArray = NDArray[np.float64]

#: Static columns 1, x, x^2, x^3: the constant is there because a shifted cubic has one.
N_STATIC = 4
#: More distinct sampling steps than this are an irregular clock.
MAX_STEP_GROUPS = 256
#: Distance in ln(step) of the steps that are tabulated for it: exp(-dh/tau) then is a polynomial of degree 5
#: to 1e-15, because it matters only where h/tau is not large.
NEAR_STEP = 4e-3
#: Steps that differ by less than this fraction of the duration are one step printed with rounding.
STEP_RESOLUTION = 1e-11


@dataclass(frozen=True, slots=True, eq=False)
class LogData:
    """One log in the contact frame, from contact to the end of its fitted part.

    Attributes
    ----------
    time_s, depth_mm, force_N : ndarray, shape (n,)
        From contact on [s], depth [mm], compressive force [N].
    include : ndarray of bool, shape (n,)
        Samples that take part in the likelihood (the branch state runs through all of them).
    fold : ndarray of int, shape (n,)
        Held-out group of every sample; all zero where whole logs are held out.
    breaks : ndarray of bool, shape (n,), or None
        True where a sample starts a new chain of noise (:func:`~tissueid.likelihood.chains.chain_breaks`);
        ``None`` is told from the time stamps when it is needed.
    """

    time_s: FloatArray
    depth_mm: FloatArray
    force_N: FloatArray
    include: NDArray[np.bool_]
    fold: NDArray[np.int64]
    breaks: NDArray[np.bool_] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LogSums:
    """Gram matrices of one log.

    Attributes
    ----------
    gram : ndarray, shape (folds, m, m)
        Gram matrix of the design columns and the force, a fold each.
    count : ndarray of int, shape (folds,)
        Samples in each.
    degree : int
        Highest power of x that multiplies a node state.
    """

    gram: FloatArray
    count: NDArray[np.int64]
    degree: int


class StepTables(NamedTuple):
    """Weights of the branch states for every sampling step, see :func:`tissueid.model.kernels.step_weights`.

    Attributes
    ----------
    group : ndarray of int, shape (n,)
        Row of the tables for each sample.
    decay : ndarray, shape (groups, nodes)
        a = exp(-h / tau).
    gain : ndarray, shape (groups, nodes)
        phi = (1 - a) tau / h; 1 - a where ``off_s`` is given.
    off_s : ndarray, shape (n,) or (0,)
        What each step is longer than that of its group; empty where groups are of equal steps [s].
    """

    group: NDArray[np.int64]
    decay: FloatArray
    gain: FloatArray
    off_s: FloatArray


def step_tables(step_s: FloatArray, tau_s: FloatArray, duration_s: float) -> StepTables:
    """Group equal sampling steps, or near ones of an irregular clock, and tabulate their weights."""
    resolution = max(duration_s, 1e-300) * STEP_RESOLUTION
    if np.ptp(step_s[1:]) <= resolution:
        group = np.zeros(step_s.size, dtype=np.int64)
        step_s = step_s.copy()
        step_s[0] = step_s[1]
    else:
        rounded = np.round(step_s / resolution)
        first = np.flatnonzero(np.diff(rounded, prepend=np.nan))
        runs = rounded[first]
        # an irregular clock shows in its first steps
        if np.unique(runs[: 2 * MAX_STEP_GROUPS]).size > MAX_STEP_GROUPS:
            return _irregular_tables(step_s, tau_s)
        keys, kind = np.unique(runs, return_inverse=True)
        if keys.size > MAX_STEP_GROUPS:
            return _irregular_tables(step_s, tau_s)
        group = np.repeat(kind, np.diff(first, append=rounded.size))
    mean = np.bincount(group, weights=step_s) / np.bincount(group)
    ratio = mean[:, None] / tau_s
    positive = ratio > 0.0
    safe = np.where(positive, ratio, 1.0)
    return StepTables(
        group=group.astype(np.int64),
        decay=np.where(positive, np.exp(-safe), 1.0),
        gain=np.where(positive, -np.expm1(-safe) / safe, 1.0),
        off_s=np.zeros(0),
    )


def _irregular_tables(step_s: FloatArray, tau_s: FloatArray) -> StepTables:
    """Tables at steps :data:`NEAR_STEP` apart in ln(step), from which the weights of any step follow."""
    shortest = float(step_s[step_s > 0.0].min())
    place = np.log(np.maximum(step_s, shortest) / shortest) / NEAR_STEP
    bins = np.round(place).astype(np.int64)
    occupied = np.bincount(bins) > 0
    filled, group = np.flatnonzero(occupied), (np.cumsum(occupied) - 1)[bins]
    centre = shortest * np.exp(filled * NEAR_STEP)
    ratio = centre[:, None] / tau_s
    return StepTables(
        group=group.astype(np.int64),
        decay=np.exp(-ratio),
        gain=-np.expm1(-ratio),
        off_s=np.maximum(step_s, shortest) - centre[group],
    )


def log_sums(data: LogData, basis: KernelBasis, *, degree: int) -> LogSums:
    """Sum one log over the nodes of a basis.

    Parameters
    ----------
    data : LogData
    basis : KernelBasis
    degree : int
        Highest degree of K that will be asked for.

    Returns
    -------
    LogSums
        With ``4 + nodes * (degree + 1) + 1`` columns.
    """
    nodes, n = basis.tau_s.size, data.time_s.size
    # the last node fills the last register
    tau = np.pad(basis.tau_s, (0, tiled_columns(nodes) - nodes), mode="edge")
    step = np.diff(data.time_s, prepend=data.time_s[0])
    tables = step_tables(step, tau, float(data.time_s[-1] - data.time_s[0]))
    folds = int(data.fold.max()) + 1
    count = np.bincount(data.fold[data.include], minlength=folds).astype(np.int64)
    plain = tiled_columns(N_STATIC + 1 + 2 * degree)
    chunk = chunk_samples(plain + tau.size)
    rows = aligned_zeros(min(chunk, n), plain + tau.size)
    moments = np.zeros((folds, 2 * degree + 1, rows.shape[1], rows.shape[1]))
    force = N_STATIC + degree
    state, one = aligned_zeros(tau.size), np.ones(n)
    for first in range(0, n, chunk):
        last = min(first + chunk, n)
        place, bound = places(data.fold[first:last][data.include[first:last]], folds)
        to = data.include, place, rows
        fill_powers(one, data.depth_mm, first, last, *to, 0, force)
        fill_powers(data.force_N, data.depth_mm, first, last, *to, force, degree + 1)
        fill_states(data.depth_mm, step, *tables, tau, state, first, last, *to, plain)
        for fold, (start, stop) in enumerate(pairwise(bound)):
            add_grams(rows[start:stop], rows[start:stop, 1], plain, moments[fold])
    gram = _of_columns(mirrored(moments), plain, nodes, degree)
    return LogSums(gram=gram, count=count, degree=degree)


def _of_columns(moments: FloatArray, plain: int, nodes: int, degree: int) -> FloatArray:
    """Gram matrix of ``[1, x, x^2, x^3, s_k x^p, force]`` from the moments; shape (folds, m, m)."""
    force = N_STATIC + degree
    power = np.repeat(np.arange(degree + 1), nodes)
    node = plain + np.tile(np.arange(nodes), degree + 1)
    static = np.append(np.arange(N_STATIC), force)
    outer = np.append(np.arange(N_STATIC), N_STATIC + node.size + np.zeros(1, dtype=np.int64))
    inner = N_STATIC + np.arange(node.size)
    size = N_STATIC + node.size + 1
    gram = np.empty((moments.shape[0], size, size))
    gram[:, outer[:, None], outer] = moments[:, 0][:, static[:, None], static]
    across = moments[:, 0][:, static[:, None] + power, node]
    gram[:, outer[:, None], inner] = across
    gram[:, inner[:, None], outer] = np.swapaxes(across, 1, 2)
    gram[:, inner[:, None], inner] = moments[:, power[:, None] + power, node[:, None], node]
    return gram


def reduction(basis: KernelBasis, log_tau: FloatArray, *, degree: int, columns_degree: int) -> FloatArray:
    """Columns of a candidate model as weights of the node columns.

    Parameters
    ----------
    basis : KernelBasis
    log_tau : ndarray, shape (branches,)
    degree : int
        Degree of K in the candidate.
    columns_degree : int
        Degree for which the sums were made (>= ``degree``).

    Returns
    -------
    ndarray, shape (m, 4 + 2 * branches * (degree + 1) + 1)
        ``W`` such that ``W.T @ gram @ W`` is the Gram matrix of ``1, x, x^2, x^3``, then
        ``s_j x^p`` branch by branch, then ``(ds_j/dln tau_j) x^p`` branch by branch, then the force.
    """
    nodes = basis.tau_s.size
    branches = log_tau.size
    size = branches * (degree + 1)
    weights = np.zeros((N_STATIC + nodes * (columns_degree + 1) + 1, N_STATIC + 2 * size + 1))
    weights[range(N_STATIC), range(N_STATIC)] = 1.0
    weights[-1, -1] = 1.0
    if branches:
        c, dc = basis.weights(log_tau)
    for j in range(branches):
        for p in range(degree + 1):
            rows = slice(N_STATIC + p * nodes, N_STATIC + (p + 1) * nodes)
            column = N_STATIC + j * (degree + 1) + p
            weights[rows, column] = c[:, j]
            weights[rows, column + size] = dc[:, j]
    return weights


def reduced_grams(gram: FloatArray, basis: KernelBasis, log_tau: FloatArray, *, degree: int) -> FloatArray:
    """Gram matrices of a candidate model's columns.

    As ``W.T @ gram @ W`` with the weights of :func:`reduction`, without the products with its zeros: a column
    touches the nodes of one power of depth, and powers that the candidate leaves out are not read.

    Parameters
    ----------
    gram : ndarray, shape (units, m, m)
    basis : KernelBasis
    log_tau : ndarray, shape (branches,)
    degree : int
        Of K in the candidate, not above that of the sums.

    Returns
    -------
    ndarray, shape (units, r, r)
    """
    nodes, size = basis.tau_s.size, degree + 1
    both = np.hstack(basis.weights(log_tau)) if log_tau.size else np.zeros((nodes, 0))
    powers = [slice(N_STATIC + p * nodes, N_STATIC + (p + 1) * nodes) for p in range(size)]
    rows, columns = powers[-1].stop, N_STATIC + both.shape[1] * size + 1
    half = np.empty((gram.shape[0], rows, columns))
    half[:, :, :N_STATIC], half[:, :, -1] = gram[:, :rows, :N_STATIC], gram[:, :rows, -1]
    out = np.empty((gram.shape[0], columns, columns))
    for p, own in enumerate(powers):
        half[:, :, N_STATIC + p : -1 : size] = gram[:, :rows, own] @ both
    out[:, :N_STATIC] = half[:, :N_STATIC]
    for p, own in enumerate(powers):
        out[:, N_STATIC + p : -1 : size] = both.T @ half[:, own]
    out[:, -1, :-1], out[:, -1, -1] = out[:, :-1, -1], gram[:, -1, -1]
    return out
