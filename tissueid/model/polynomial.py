"""Polynomials that are non-negative on [0, x_max]: the one passive parameterisation of the product.

A branch is passive where K(x) >= 0, and the static part where F_s(x) >= 0 on [0, x_max] (model.md
1.3, derived).  With ``u = x / x_max``, F_s(x)/x and each K(x) are polynomials q(u) of degree <= 2
that must not be negative on [0, 1].  That set is a convex cone, written here in three equal ways:

* **generators** for the active-set solver: ``(1-u)^2, u(1-u), u^2`` and ``(u-r)^2`` for r in (0, 1),
  the last added where they are needed (exact, unlike non-negative Bernstein coefficients, which
  exclude part of the cone);
* **coordinates** for Levenberg-Marquardt: ``q = (p0 (1-u) - p2 u)^2 + 2 w u (1-u)`` with w >= 0
  (Lukacs' theorem), smooth and bounded only in w;
* a **test**: the smallest value of q on [0, 1] in closed form.
"""

from __future__ import annotations

import math

import numpy as np

from tissueid.arrays import FloatArray

MAX_DEGREE = 2


def generators(degree: int) -> FloatArray:
    """Generators that every solve starts with.

    ``degree``: 0, 1 or 2.  Returns (degree + 1, degree + 1), one generator a row, coefficients by powers of
    u, constant first.
    """
    if degree == 0:
        return np.array([[1.0]])
    if degree == 1:
        return np.array([[1.0, -1.0], [0.0, 1.0]])
    if degree == MAX_DEGREE:
        return np.array([[1.0, -2.0, 1.0], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]])
    msg = f"degree {degree} is not offered, 0 to {MAX_DEGREE} are"
    raise ValueError(msg)


def minimum_on_unit(q: FloatArray) -> FloatArray:
    """Smallest values of polynomials of degree <= 2 on [0, 1].

    ``q`` (..., degree + 1): coefficients by powers of u, constant first.  Returns (...).
    """
    ends = np.minimum(q[..., 0], q.sum(axis=-1))
    if q.shape[-1] <= MAX_DEGREE:
        return np.asarray(ends)
    bent = q[..., 2] > 0.0
    vertex = np.clip(-q[..., 1] / (2.0 * np.where(bent, q[..., 2], 1.0)), 0.0, 1.0)
    turn = q[..., 0] + vertex * (q[..., 1] + vertex * q[..., 2])
    return np.asarray(np.where(bent, np.minimum(ends, turn), ends))


def coordinates(q: FloatArray) -> FloatArray:
    """Cone coordinates of a non-negative polynomial.

    ``q`` (degree + 1,): coefficients by powers of u; values that are negative by rounding are taken as zero.
    Returns (degree + 1,), ``(p0,)``, ``(p0, p2)`` or ``(p0, w, p2)``.
    """
    first = math.sqrt(max(float(q[0]), 0.0))
    last = math.sqrt(max(float(q.sum()), 0.0))
    if q.size == 1:
        return np.array([first])
    if q.size == MAX_DEGREE:
        return np.array([first, last])
    middle = float(q[0] + q[1] / 2.0)
    return np.array([first, max(middle + first * last, 0.0), last])


def from_coordinates(p: FloatArray) -> FloatArray:
    """Coefficients by powers of u from cone coordinates; inverse of :func:`coordinates`."""
    if p.size == 1:
        return np.array([p[0] ** 2])
    if p.size == MAX_DEGREE:
        return np.array([p[0] ** 2, p[1] ** 2 - p[0] ** 2])
    c0, c1, c2 = p[0] ** 2, p[1] - p[0] * p[2], p[2] ** 2
    return np.array([c0, 2.0 * (c1 - c0), c0 - 2.0 * c1 + c2])


def coordinates_jacobian(p: FloatArray) -> FloatArray:
    """Derivative of :func:`from_coordinates`, shape (degree + 1, degree + 1), rows by power of u."""
    if p.size == 1:
        return np.array([[2.0 * p[0]]])
    if p.size == MAX_DEGREE:
        return np.array([[2.0 * p[0], 0.0], [-2.0 * p[0], 2.0 * p[1]]])
    bernstein = np.array([[2.0 * p[0], 0.0, 0.0], [-p[2], 1.0, -p[0]], [0.0, 0.0, 2.0 * p[2]]])
    power = np.array([[1.0, 0.0, 0.0], [-2.0, 2.0, 0.0], [1.0, -2.0, 1.0]])
    return np.asarray(power @ bernstein)


def n_bounded(degree: int) -> tuple[int, ...]:
    """Positions of the cone coordinates that carry the bound ``>= 0``."""
    return (1,) if degree == MAX_DEGREE else ()


def shift_matrix(degree: int, shift: float) -> FloatArray:
    """Matrix T with ``coefficients of q(x - shift) = T @ coefficients of q(x)``.

    Returns (degree + 1, degree + 1), upper triangular.
    """
    matrix = np.zeros((degree + 1, degree + 1))
    for k in range(degree + 1):
        for i in range(k + 1):
            matrix[i, k] = math.comb(k, i) * (-shift) ** (k - i)
    return matrix
