"""Least squares of a ramp's shape at many contacts and branch lengths.

What the columns mean is in :mod:`tissueid.segment.ramp_shape`.  The static columns depend on the contact
alone: they are made orthonormal once a contact, with their priors as k further samples of 0, and all branch
lengths are then one product of matrices.  Orthonormal columns keep what is left exact at any noise.  Nothing
is compiled: the first look at a file must not wait for a compiler.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray

Bins = tuple[FloatArray, FloatArray, FloatArray, FloatArray]

#: Largest change of force with contact, in noise sd: its square is a number.
LARGEST = 1e75
#: Least information.
LEAST = 1e-12
#: Largest exponent by which the branch's part is moved.
FURTHEST = 600.0
#: Powers of depth in the static curve.
POWERS = 3


class _Static(NamedTuple):
    """Orthonormal static columns (n, k, b), their part in the prior rows (n, k, k), and their moves."""

    basis: FloatArray
    beside: FloatArray
    moves: FloatArray

    def outside(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Remainder of rows (n, m, b) beside the static columns, and what that leaves in prior rows."""
        along = rows @ self.basis.transpose(0, 2, 1)
        return rows - along @ self.basis, -along @ self.beside


def _static(bins: Bins, prior: FloatArray, scale: float, contact: FloatArray, window: float) -> _Static:
    """Static columns over the noise, made orthonormal, and their change with contact."""
    depth, variance, weight, _ = bins
    beyond = (depth - contact[:, None]) / window
    z = np.maximum(beyond, 0.0)
    touching = z > 0.0
    within = touching * (variance / window**2)
    columns = [z, z * z + within, z * (z * z + 3.0 * within)]
    if prior.size > POWERS:
        columns += [beyond, np.ones_like(beyond)]
    rows = np.stack(columns, axis=1) * (prior[:, None] * weight)
    moves = np.stack([1.0 * touching, 2.0 * z, 3.0 * z * z], axis=1) * (weight * scale / window)
    unit = np.broadcast_to(np.eye(prior.size), (contact.size, prior.size, prior.size))
    orthonormal, _ = np.linalg.qr(np.concatenate([rows.transpose(0, 2, 1), unit], axis=1))
    turned = orthonormal.transpose(0, 2, 1)
    return _Static(turned[:, :, : depth.size], turned[:, :, depth.size :], moves)


def _ahead(depth: FloatArray, from_mm: FloatArray, phase_share: float) -> FloatArray:
    """Shift of the first bin in contact towards half a bin behind contact [mm], shape (n,)."""
    beyond = depth > from_mm[:, None]
    first = beyond.argmax(axis=1)
    gap = 0.5 * np.abs(depth[first] - depth[first - 1]) - (depth[first] - from_mm)
    return np.where(beyond.any(axis=1) & (first > 0), phase_share * gap, 0.0)


def _branch(
    bins: Bins, contact: FloatArray, length: FloatArray, place: tuple[float, float, float], scale: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rise of the branch, its change with contact and with ln l, over the noise: (n, m, b) each."""
    depth, variance, weight, _ = bins
    window, start, phase_share = place
    from_mm = np.maximum(contact, start)
    of = length[:, :, None]
    ahead = _ahead(depth, from_mm, phase_share)[:, None, None] / of
    ratio = np.maximum(depth - from_mm[:, None], 0.0)[:, None, :] / of
    touching = ratio > 0.0
    kept = np.exp(-ratio)
    lost = -np.expm1(-ratio)
    share = of / window
    left = kept * touching * np.exp(np.clip(-ahead, -FURTHEST, FURTHEST))
    blurred = np.minimum(0.5 * variance / of**2, 1.0)
    rise = (lost - touching * blurred * kept) * (share * (scale * weight))
    turned = (1.0 - left - (ratio + ahead * touching) * left) * touching * (share * weight)
    moves = (contact >= start)[:, None, None]
    return rise, left * (weight * moves), turned


def _products(one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Products of what is left of rows, with what they leave in the priors' rows; shape (n, m)."""
    beside = (one[1] * other[1]).sum(axis=-1)
    return np.asarray(np.einsum("nmb,nmb->nm", *np.broadcast_arrays(one[0], other[0])) + beside)


def ramp_squares(
    bins: Bins,
    prior: FloatArray,
    scale: float,
    place: tuple[float, float, float],
    contact: FloatArray,
    length: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Least squares of the shape at every (contact, length).

    ``bins`` (b,): depth [mm], its variance [mm^2], one over the noise of the mean force [1/N], and the force
    over it; ``prior`` (k,): prior standard deviations of the static columns [N]: three powers; drift and
    force in air; ``scale``: of the branch [N]; ``place``: window [mm], first displacement of the record [mm],
    and the share of the way by which the first bin in contact is moved to the middle of its gap; ``contact``
    (n,), ``length`` (n, m).  Returns ``coefficients`` (n, m, k): of the static columns, in their priors'
    standard deviations; ``branch, misfit`` (n, m): of the branch in ``scale``; chi-square; ``judged`` (3, n,
    m): information about contact and about ln length, and the variance of the initial slope over ``scale``.
    """
    static = _static(bins, prior, scale, contact, place[0])
    rise, moved, turned = _branch(bins, contact, length, place, scale)
    force = static.outside(np.broadcast_to(bins[3], (contact.size, 1, bins[3].size)))
    rose = static.outside(rise)
    own = 1.0 + _products(rose, rose)
    unexplained = _products(rose, force)
    branch = unexplained / own
    coefficients = rose[1] * branch[:, :, None] - force[1]
    misfit = np.maximum(_products(force, force) - unexplained * branch, 0.0)
    moved *= (branch * (scale / place[0]))[:, :, None]
    moved += coefficients[:, :, :POWERS] @ static.moves
    turned *= (branch * scale)[:, :, None]
    judged = np.empty((3, *length.shape))
    for row, changed in enumerate((moved, turned)):
        left = static.outside(np.clip(changed, -LARGEST, LARGEST))
        shared = _products(left, rose)
        judged[row] = np.maximum(_products(left, left) - shared * shared / own, LEAST)
    slope = (static.beside[:, :, 0] ** 2).sum(axis=1)
    judged[2] = (1.0 + rose[1][:, :, 0]) ** 2 / own + slope[:, None]
    return coefficients, branch, misfit, judged
