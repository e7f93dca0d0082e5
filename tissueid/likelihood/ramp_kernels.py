"""Compiled least squares of a ramp's shape at many contacts and branch lengths.

What the columns mean is in :mod:`tissueid.segment.ramp_shape`.  The static columns depend on the contact
alone: they are made orthonormal once a contact, with their priors as k further samples of 0, and the branch
is one more column each.  Orthonormal columns keep what is left exact at any noise.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.lanes import decays

__all__ = ["ramp_squares"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Largest change of force with contact, in noise sd: its square is a number.
LARGEST = 1e75
#: Least information.
LEAST = 1e-12
#: Largest exponent by which the branch's part is moved.
FURTHEST = 600.0
#: Sums over bins may be taken in any order.
SUMMED = {"contract", "reassoc", "nsz"}
#: Powers of depth in the static curve.
POWERS = 3


@kernel(fastmath=SUMMED)
def _dot(x: FloatArray, i: int, y: FloatArray, j: int) -> float:
    """Product of two rows."""
    total = 0.0
    for b in range(x.shape[1]):
        total += x[i, b] * y[j, b]
    return total


@kernel(fastmath=SUMMED)
def _less(x: FloatArray, i: int, share: float, y: FloatArray, j: int) -> None:
    """Take a share of one row from another."""
    for b in range(x.shape[1]):
        x[i, b] -= share * y[j, b]


@kernel()
def _orthonormal(basis: FloatArray, lower: FloatArray) -> None:
    """Make rows orthonormal with unit rows beside them, in place; ``lower`` becomes that part.

    It is also the inverse of the triangle that takes the basis back to the columns, transposed.  Twice,
    because once leaves what rounding has of the others.
    """
    count = basis.shape[0]
    lower[:] = 0.0
    for q in range(count):
        lower[q, q] = 1.0
        for _ in range(2):
            for r in range(q):
                share = _dot(basis, r, basis, q) + _dot(lower, r, lower, q)
                _less(basis, q, share, basis, r)
                _less(lower, q, share, lower, r)
        size = 1.0 / math.sqrt(_dot(basis, q, basis, q) + _dot(lower, q, lower, q))
        for b in range(basis.shape[1]):
            basis[q, b] *= size
        for k in range(count):
            lower[q, k] *= size


@kernel(fastmath=SUMMED)
def _outside(
    rows: FloatArray, i: int, basis: FloatArray, lower: FloatArray, beside: FloatArray, along: FloatArray
) -> float:
    """Take from a row what lies along the static columns; the square of what is left.

    What it leaves in their priors' rows is written.
    """
    k = basis.shape[0]
    for q in range(k):
        along[q] = _dot(rows, i, basis, q)
    for q in range(k):
        _less(rows, i, along[q], basis, q)
    total = 0.0
    for p in range(k):
        value = 0.0
        for q in range(p, k):
            value -= along[q] * lower[q, p]
        beside[i, p] = value
        total += value * value
    return total + _dot(rows, i, rows, i)


@kernel(fastmath={"contract"})
def _static(
    depth: FloatArray, variance: FloatArray, weight: FloatArray, contact: float, window: float,
    scale: float, prior: FloatArray, basis: FloatArray, moves: FloatArray,
) -> None:  # fmt: skip
    """Static columns and how they move with contact, over the noise."""
    for b in range(depth.size):
        beyond = (depth[b] - contact) / window
        z = max(beyond, 0.0)
        touching = 1.0 if z > 0.0 else 0.0
        within = touching * (variance[b] / (window * window))
        w = weight[b]
        basis[0, b] = z * prior[0] * w
        basis[1, b] = (z * z + within) * prior[1] * w
        basis[2, b] = z * (z * z + 3.0 * within) * prior[2] * w
        w *= scale / window
        moves[0, b] = touching * w
        moves[1, b] = 2.0 * z * w
        moves[2, b] = 3.0 * z * z * w
    if prior.size > POWERS:
        for b in range(depth.size):
            basis[3, b] = (depth[b] - contact) / window * prior[3] * weight[b]
            basis[4, b] = prior[4] * weight[b]


@kernel()
def _ahead(depth: FloatArray, from_mm: float, phase_share: float) -> float:
    """How far the first bin in contact is moved towards half a bin behind contact [mm]."""
    for b in range(depth.size):
        w = depth[b] - from_mm
        if w > 0.0:
            return phase_share * (0.5 * abs(depth[b] - depth[b - 1]) - w) if b > 0 else 0.0
    return 0.0


@kernel(fastmath={"contract"})
def _branch(
    depth: FloatArray, variance: FloatArray, weight: FloatArray, place: tuple[float, float, float, bool],
    window: float, scale: float, rows: FloatArray, work: tuple[FloatArray, FloatArray, FloatArray, IntArray],
    kept: FloatArray,
) -> None:  # fmt: skip
    """Rise of the branch, its change with contact and with ln l, over the noise: three rows."""
    from_mm, length, ahead, moves = place
    ratio, lost, power, bits = work
    n = depth.size
    for b in range(n):
        ratio[b] = max(depth[b] - from_mm, 0.0) / length
    decays(ratio, kept, lost, power, bits)
    share = length / window
    further = math.exp(min(max(-ahead / length, -FURTHEST), FURTHEST))
    shift = ahead / length
    for b in range(n):
        touching = 1.0 if ratio[b] > 0.0 else 0.0
        blurred = min(0.5 * variance[b] / (length * length), 1.0)
        rise = (lost[b] - touching * blurred * kept[b]) * share
        w = ratio[b] + shift * touching
        left = kept[b] * further * touching
        rows[0, b] = rise * (scale * weight[b])
        rows[1, b] = left * weight[b] if moves else 0.0
        rows[2, b] = (1.0 - left - w * left) * touching * share * weight[b]


@kernel(fastmath=SUMMED)
def _shared(rows: FloatArray, i: int, j: int, beside: FloatArray) -> float:
    """Product of what is left of two rows."""
    total = _dot(rows, i, rows, j)
    for q in range(beside.shape[1]):
        total += beside[i, q] * beside[j, q]
    return total


@kernel()
def _information(
    rows: FloatArray, i: int, basis: FloatArray, lower: FloatArray, beside: FloatArray, along: FloatArray,
    own: float,
) -> float:  # fmt: skip
    """Fisher information of what moves the force so, static columns and branch (row 0) projected out."""
    for b in range(rows.shape[1]):
        rows[i, b] = min(max(rows[i, b], -LARGEST), LARGEST)
    left = _outside(rows, i, basis, lower, beside, along)
    shared = _shared(rows, i, 0, beside)
    return max(left - shared * shared / own, LEAST)


@kernel()
def ramp_squares(
    bins: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    prior: FloatArray,
    scale: float,
    place: tuple[float, float, float],
    contact: FloatArray,
    length: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Least squares of the shape at every (contact, length).

    Parameters
    ----------
    bins : tuple of ndarray, shape (b,)
        Depth [mm], its variance [mm^2], one over the noise of the mean force [1/N], and the force over it.
    prior : ndarray, shape (k,)
        Prior standard deviations of the static columns [N]: three powers; drift and force in air.
    scale : float
        Of the branch [N].
    place : tuple of float
        Window [mm], first displacement of the record [mm], and the share of the way by which the first bin in
        contact is moved to the middle of its gap.
    contact, length : ndarray, shape (n,) and (n, m)

    Returns
    -------
    coefficients : ndarray, shape (n, m, k)
        Of the static columns, in their priors' standard deviations.
    branch, misfit : ndarray, shape (n, m)
        Of the branch in ``scale``; chi-square.
    judged : ndarray, shape (3, n, m)
        Information about contact and about ln length, and the variance of the initial slope over ``scale``.
    """
    depth, variance, weight, force = bins
    window, start, phase_share = place
    size, k = depth.size, prior.size
    n, m = length.shape
    coefficients, branch, misfit = np.empty((n, m, k)), np.empty((n, m)), np.empty((n, m))
    judged = np.empty((3, n, m))
    basis, lower, moves = np.empty((k, size)), np.empty((k, k)), np.empty((POWERS, size))
    rows, beside, along = np.empty((4, size)), np.empty((4, k)), np.empty(k)
    ratio, lost, power, kept = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    work = (ratio, lost, power, power.view(np.int64))
    for i in range(n):
        _static(depth, variance, weight, contact[i], window, scale, prior, basis, moves)
        _orthonormal(basis, lower)
        # the last row is the force
        rows[3] = force
        squares = _outside(rows, 3, basis, lower, beside, along)
        alone = -beside[3]
        from_mm = max(contact[i], start)
        ahead = _ahead(depth, from_mm, phase_share)
        for j in range(m):
            at = (from_mm, length[i, j], ahead, contact[i] >= start)
            _branch(depth, variance, weight, at, window, scale, rows, work, kept)
            own = 1.0 + _outside(rows, 0, basis, lower, beside, along)
            unexplained = _shared(rows, 0, 3, beside)
            share = unexplained / own
            branch[i, j] = share
            for q in range(k):
                coefficients[i, j, q] = alone[q] + beside[0, q] * share
            misfit[i, j] = max(squares - unexplained * share, 0.0)
            for b in range(size):
                rows[1, b] *= share * scale / window
                rows[2, b] *= share * scale
            for q in range(POWERS):
                _less(rows, 1, -coefficients[i, j, q], moves, q)
            judged[0, i, j] = _information(rows, 1, basis, lower, beside, along, own)
            judged[1, i, j] = _information(rows, 2, basis, lower, beside, along, own)
            spread = 1.0 + beside[0, 0]
            judged[2, i, j] = spread * spread / own
            for q in range(k):
                judged[2, i, j] += lower[q, 0] * lower[q, 0]
    return coefficients, branch, misfit, judged
