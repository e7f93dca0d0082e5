"""Compiled pass over the samples of a log: the node states of a chunk, ready for one matrix product."""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from tissueid.model.kernels import FLUSH_MM, step_weights

__all__ = ["fill_design"]

FloatArray = NDArray[np.float64]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def fill_design(
    depth_mm: FloatArray,
    step_s: FloatArray,
    step_group: NDArray[np.int64],
    table_a: FloatArray,
    table_phi: FloatArray,
    tau_s: FloatArray,
    state: FloatArray,
    first: int,
    last: int,
    include: NDArray[np.bool_],
    force_N: FloatArray,
    degree: int,
    out: FloatArray,
) -> int:
    """Advance the node states over samples [first, last) and write the design rows that count.

    Parameters
    ----------
    depth_mm, step_s, force_N : ndarray, shape (n,)
        Depth [mm], time since the previous sample [s] (the first is unused), force [N].
    step_group : ndarray of int, shape (n,)
        Row of the weight tables for a sample's step, or -1 where the step is not tabulated.
    table_a, table_phi : ndarray, shape (groups, nodes)
    tau_s : ndarray, shape (nodes,)
    state : ndarray, shape (nodes,)
        Node states before ``first``; updated in place.
    include : ndarray of bool, shape (n,)
        Samples that take part in the likelihood.
    degree : int
        Degree of K.
    out : ndarray, shape (chunk, 4 + nodes * (degree + 1) + 1)
        Rows ``1, x, x^2, x^3, s_k, s_k x, ..., force``.

    Returns
    -------
    int
        Rows written.
    """
    nodes = tau_s.size
    rows = 0
    y = 4 + nodes * (degree + 1)
    for i in range(first, last):
        x = depth_mm[i]
        if i > 0:
            dx = x - depth_mm[i - 1]
            group = step_group[i]
            if group >= 0:
                a = table_a[group]
                phi = table_phi[group]
                for k in range(nodes):
                    s = a[k] * state[k] + phi[k] * dx
                    state[k] = s if abs(s) >= FLUSH_MM else 0.0
            else:
                for k in range(nodes):
                    weight, gain = step_weights(step_s[i], tau_s[k])
                    s = weight * state[k] + gain * dx
                    state[k] = s if abs(s) >= FLUSH_MM else 0.0
        if include[i]:
            row = out[rows]
            row[0] = 1.0
            row[1] = x
            row[2] = x * x
            row[3] = x * x * x
            for k in range(nodes):
                row[4 + k] = state[k]
            factor = 1.0
            for power in range(1, degree + 1):
                factor *= x
                base = 4 + power * nodes
                for k in range(nodes):
                    row[base + k] = state[k] * factor
            row[y] = force_N[i]
            rows += 1
    return rows
