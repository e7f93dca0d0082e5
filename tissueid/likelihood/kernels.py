"""Compiled pass over the samples of a log: the node states of a chunk, ready for one matrix product."""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from tissueid.model.kernels import FLUSH_MM

__all__ = ["fill_design"]

FloatArray = NDArray[np.float64]

#: Coefficients of 1 - exp(-r) = r - r^2/2! + r^3/3! - r^4/4! + r^5/5!
HALF, SIXTH, FOURTH, FIFTH = 1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0


@nb.njit(cache=True, nogil=True, error_model="numpy")
def fill_design(
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
    force_N: FloatArray,
    degree: int,
    out: FloatArray,
) -> int:
    """Advance the node states over samples [first, last) and write the design rows that count.

    Parameters
    ----------
    depth_mm, step_s, force_N : ndarray, shape (n,)
        Depth [mm], time since the previous sample [s] (the first is unused), force [N].
    group, decay, gain, off_s
        :class:`tissueid.likelihood.sums.StepTables`.
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
    rate = 1.0 / tau_s
    rows = 0
    y = 4 + nodes * (degree + 1)
    for i in range(first, last):
        x = depth_mm[i]
        if i > 0:
            dx = x - depth_mm[i - 1]
            a = decay[group[i]]
            phi = gain[group[i]]
            if off_s.size == 0:
                for k in range(nodes):
                    s = a[k] * state[k] + phi[k] * dx
                    state[k] = s if abs(s) >= FLUSH_MM else 0.0
            elif step_s[i] > 0.0:
                off = off_s[i]
                share = dx / step_s[i]
                for k in range(nodes):
                    # 1 - exp(-h/tau) from its value at a near step: no cancellation for any h/tau
                    r = off * rate[k]
                    less = r * (1.0 - r * (HALF - r * (SIXTH - r * (FOURTH - r * FIFTH))))
                    lost = phi[k] + a[k] * less
                    s = state[k] - lost * (state[k] - share * tau_s[k])
                    state[k] = s if abs(s) >= FLUSH_MM else 0.0
            else:
                for k in range(nodes):
                    state[k] += dx
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
