"""Deflection of a compliant frame: ``x_tip = x - u(F)``, u the integral of a compliance linear between knots.

``u(F) = sum_k c_k A_k(F)``, A_k the integral of the k-th hat function; c is constant beyond the last knot and
below 0.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.manifest import FrameCurve


def deflection_basis(knots_N: FloatArray, force_N: FloatArray) -> FloatArray:
    """A_k(F): deflection by the compliance at each knot, of forces (n,) [N], (n, k)."""
    width = np.diff(knots_N)
    piece = np.clip(np.searchsorted(knots_N, force_N, side="right") - 1, 0, width.size - 1)
    within = np.clip(force_N - knots_N[piece], 0.0, width[piece])
    beyond = np.maximum(force_N - knots_N[-1], 0.0)
    rows = np.arange(force_N.size)
    # whole pieces below the one the force lies in: half a width to each of their two knots
    both = np.eye(width.size, knots_N.size) + np.eye(width.size, knots_N.size, 1)
    basis = np.vstack([np.zeros(knots_N.size), np.cumsum(0.5 * width[:, None] * both, axis=0)])[piece]
    share = within**2 / (2.0 * width[piece])
    basis[rows, piece] += within - share
    basis[rows, piece + 1] += share
    basis[:, -1] += beyond
    basis[:, 0] += np.minimum(force_N, 0.0)
    return basis


def deflection(frame: FrameCurve, force_N: FloatArray) -> FloatArray:
    """u(F) [mm] at compressive forces of shape (n,) [N]."""
    return np.asarray(deflection_basis(frame.force_N, force_N) @ frame.compliance_mm_per_N)


def deflection_sd(frame: FrameCurve, force_N: FloatArray) -> FloatArray:
    """Standard deviation of u(F) [mm], shape (n,)."""
    basis = deflection_basis(frame.force_N, force_N)
    variance = np.einsum("ij,jk,ik->i", basis, frame.covariance, basis)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def tangent_stiffness(frame: FrameCurve, force_N: float) -> float:
    """dF/du [N/mm] at one force; infinite where nothing gives."""
    compliance = float(np.interp(force_N, frame.force_N, frame.compliance_mm_per_N))
    return 1.0 / compliance if compliance > 0.0 else float("inf")


def tangent_stiffness_sd(frame: FrameCurve, force_N: float) -> float:
    """Standard deviation of :func:`tangent_stiffness` [N/mm]: that of the compliance times k^2."""
    knots = np.eye(frame.force_N.size)
    share = np.array([np.interp(force_N, frame.force_N, hat) for hat in knots])
    variance = max(float(share @ frame.covariance @ share), 0.0)
    return float(np.sqrt(variance)) * tangent_stiffness(frame, force_N) ** 2


def linear_frame(stiffness_N_per_mm: float, sd_N_per_mm: float = 0.0) -> FrameCurve:
    """A frame of one stiffness, for all forces: u = F / k, sd(1/k) = sd(k) / k^2."""
    compliance = 1.0 / stiffness_N_per_mm
    variance = (sd_N_per_mm * compliance**2) ** 2
    return FrameCurve(np.array([0.0, 1.0]), np.full(2, compliance), np.full((2, 2), variance))
