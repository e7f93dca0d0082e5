"""Compiled pass over the samples of a log: the node states of a chunk, and powers of the depth.

Rows of the result belong to samples, with nodes running fastest: all nodes take one step together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.model.kernels import FLUSH_MM

__all__ = ["fill_powers", "fill_products", "fill_states"]

FloatArray = NDArray[np.float64]

#: Coefficients of 1 - exp(-r) = r - r^2/2! + r^3/3! - r^4/4! + r^5/5!
HALF, SIXTH, FOURTH, FIFTH = 1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0


@kernel(fastmath={"contract"})
def fill_states(
    depth_mm: FloatArray,
    step_s: FloatArray,
    group: NDArray[np.int64],
    decay: FloatArray,
    gain: FloatArray,
    off_s: FloatArray,
    tau_s: FloatArray,
    state: FloatArray,
    first: int,
    last: int,
    include: NDArray[np.bool_],
    place: NDArray[np.int64],
    rows: FloatArray,
    column: int,
) -> None:
    """Advance the node states over samples [first, last) and write those of samples that count.

    Parameters
    ----------
    depth_mm, step_s : ndarray, shape (n,)
        Depth [mm], time since the previous sample [s] (the first is unused).
    group, decay, gain, off_s
        :class:`tissueid.likelihood.sums.StepTables`.
    tau_s : ndarray, shape (nodes,)
    state : ndarray, shape (nodes,)
        Node states before ``first``; updated in place.
    include : ndarray of bool, shape (n,)
        Samples that take part in the likelihood.
    place : ndarray of int, shape (samples that count,)
        Row of each.
    rows : ndarray, shape (samples, columns)
        Written from ``column`` on.
    column : int
    """
    nodes = tau_s.size
    rate = 1.0 / tau_s
    at = 0
    for i in range(first, last):
        if i > 0:
            dx = depth_mm[i] - depth_mm[i - 1]
            a = decay[group[i]]
            phi = gain[group[i]]
            if off_s.size == 0:
                for k in range(nodes):
                    state[k] = a[k] * state[k] + phi[k] * dx
            elif step_s[i] > 0.0:
                off = off_s[i]
                share = dx / step_s[i]
                for k in range(nodes):
                    # 1 - exp(-h/tau) from its value at a near step: no cancellation for any h/tau
                    r = off * rate[k]
                    less = r * (1.0 - r * (HALF - r * (SIXTH - r * (FOURTH - r * FIFTH))))
                    lost = phi[k] + a[k] * less
                    state[k] = state[k] - lost * (state[k] - share * tau_s[k])
            else:
                for k in range(nodes):
                    state[k] += dx
        if include[i]:
            row = rows[place[at], column : column + nodes]
            for k in range(nodes):
                row[k] = state[k]
            at += 1
    for k in range(nodes):
        if abs(state[k]) < FLUSH_MM:
            state[k] = 0.0


@kernel()
def fill_products(rows: FloatArray, factor: int, column: int, nodes: int, degree: int) -> None:
    """Write node states times the powers of a factor behind the states, power by power.

    Parameters
    ----------
    rows : ndarray, shape (samples, columns)
        The states stand from ``column`` on.
    factor, column, nodes, degree : int
        ``factor`` is a column, too.
    """
    for i in range(rows.shape[0]):
        x = rows[i, factor]
        for block in range(column + nodes, column + nodes * (degree + 1), nodes):
            before, now = rows[i, block - nodes : block], rows[i, block : block + nodes]
            for k in range(nodes):
                now[k] = before[k] * x


@kernel()
def fill_powers(
    value: FloatArray,
    depth_mm: FloatArray,
    first: int,
    last: int,
    include: NDArray[np.bool_],
    place: NDArray[np.int64],
    rows: FloatArray,
    column: int,
    powers: int,
) -> None:
    """Write ``value * x^q`` of those samples [first, last) that count, a column for every power q.

    Parameters
    ----------
    value, depth_mm : ndarray, shape (n,)
    first, last : int
    include : ndarray of bool, shape (n,)
    place : ndarray of int, shape (samples that count,)
        Row of each.
    rows : ndarray, shape (samples, columns)
        Written from ``column`` on.
    column, powers : int
    """
    at = 0
    for i in range(first, last):
        if include[i]:
            product = value[i]
            row = rows[place[at]]
            for q in range(powers):
                row[column + q] = product
                product *= depth_mm[i]
            at += 1
