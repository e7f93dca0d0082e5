"""Compiled pass over the samples of a log: the node states of a chunk, and powers of the depth.

Rows of the result belong to nodes, with samples running fastest, as the products behind them want it.  Where
steps are tabulated each state is carried along its own row, four of them at a time.  On an irregular clock
the weights of a step cost more than the state: all nodes take one step together, and are turned afterwards.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.gram_kernels import TILE
from tissueid.model.kernels import FLUSH_MM

__all__ = ["fill_powers", "fill_states"]

FloatArray = NDArray[np.float64]

#: Coefficients of 1 - exp(-r) = r - r^2/2! + r^3/3! - r^4/4! + r^5/5!
HALF, SIXTH, FOURTH, FIFTH = 1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0


@nb.njit(cache=True, nogil=True, error_model="numpy")
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
    out: FloatArray,
) -> None:
    """Advance the node states over samples [first, last) and write those of samples that count.

    Parameters
    ----------
    depth_mm, step_s : ndarray, shape (n,)
        Depth [mm], time since the previous sample [s] (the first is unused).
    group, decay, gain, off_s
        :class:`tissueid.likelihood.sums.StepTables`.
    tau_s : ndarray, shape (nodes,)
        Their number is a multiple of :data:`~tissueid.likelihood.gram_kernels.TILE`.
    state : ndarray, shape (nodes,)
        Node states before ``first``; updated in place.
    include : ndarray of bool, shape (n,)
        Samples that take part in the likelihood.
    place : ndarray of int, shape (samples that count,)
        Column of each.
    out : ndarray, shape (nodes, samples)
    """
    if off_s.size == 0:
        for k in range(0, tau_s.size, TILE):
            _tabulated(depth_mm, group, decay, gain, state, k, first, last, include, place, out)
    else:
        turned = _irregular(depth_mm, step_s, group, decay, gain, off_s, tau_s, state, first, last, include)
        _turn(turned, place, out)
    for k in range(state.size):
        if abs(state[k]) < FLUSH_MM:
            state[k] = 0.0


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _tabulated(
    depth_mm: FloatArray,
    group: NDArray[np.int64],
    decay: FloatArray,
    gain: FloatArray,
    state: FloatArray,
    k: int,
    first: int,
    last: int,
    include: NDArray[np.bool_],
    place: NDArray[np.int64],
    out: FloatArray,
) -> None:
    """States of the nodes [k, k + TILE)."""
    row0, row1, row2, row3 = out[k], out[k + 1], out[k + 2], out[k + 3]
    s0, s1, s2, s3 = state[k], state[k + 1], state[k + 2], state[k + 3]
    known = -1
    a0 = a1 = a2 = a3 = p0 = p1 = p2 = p3 = 0.0
    at = 0
    for i in range(first, last):
        if i > 0:
            if group[i] != known:
                known = group[i]
                a0, a1, a2, a3 = (
                    decay[known, k],
                    decay[known, k + 1],
                    decay[known, k + 2],
                    decay[known, k + 3],
                )
                p0, p1, p2, p3 = gain[known, k], gain[known, k + 1], gain[known, k + 2], gain[known, k + 3]
            dx = depth_mm[i] - depth_mm[i - 1]
            s0 = a0 * s0 + p0 * dx
            s1 = a1 * s1 + p1 * dx
            s2 = a2 * s2 + p2 * dx
            s3 = a3 * s3 + p3 * dx
        if include[i]:
            j = place[at]
            row0[j] = s0
            row1[j] = s1
            row2[j] = s2
            row3[j] = s3
            at += 1
    state[k], state[k + 1], state[k + 2], state[k + 3] = s0, s1, s2, s3


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _irregular(
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
) -> FloatArray:
    """States of the samples that count, sample by sample."""
    nodes = tau_s.size
    rate = 1.0 / tau_s
    out = np.empty((last - first, nodes))
    rows = 0
    for i in range(first, last):
        dx = depth_mm[i] - depth_mm[i - 1] if i > 0 else 0.0
        if i > 0 and step_s[i] > 0.0:
            a = decay[group[i]]
            phi = gain[group[i]]
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
            row = out[rows]
            for k in range(nodes):
                row[k] = state[k]
            rows += 1
    return out[:rows]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _turn(states: FloatArray, place: NDArray[np.int64], out: FloatArray) -> None:
    """Lay states that stand sample by sample behind one another node by node."""
    for k in range(0, states.shape[1], TILE):
        row0, row1, row2, row3 = out[k], out[k + 1], out[k + 2], out[k + 3]
        for i in range(states.shape[0]):
            j = place[i]
            row0[j] = states[i, k]
            row1[j] = states[i, k + 1]
            row2[j] = states[i, k + 2]
            row3[j] = states[i, k + 3]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def fill_powers(
    value: FloatArray,
    depth_mm: FloatArray,
    first: int,
    last: int,
    include: NDArray[np.bool_],
    place: NDArray[np.int64],
    out: FloatArray,
) -> None:
    """Write ``value * x^q`` of those samples [first, last) that count, a row for every power q.

    Parameters
    ----------
    value, depth_mm : ndarray, shape (n,)
    first, last : int
    include : ndarray of bool, shape (n,)
    place : ndarray of int, shape (samples that count,)
        Column of each.
    out : ndarray, shape (powers, samples)
    """
    at = 0
    for i in range(first, last):
        if include[i]:
            product = value[i]
            for q in range(out.shape[0]):
                out[q, place[at]] = product
                product *= depth_mm[i]
            at += 1
