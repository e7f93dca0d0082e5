"""Device and hand as a mechanical system that is linear in its parameters (compiled), equation (19).

::

    Y(x, v, vr, ar) theta = M(x) ar + C(x, v) vr + B vr + K x

M, B and K of the axes are symmetric matrices, their upper triangles row by row the parameters: one axis has
theta = [M, B, K].  A device may be an arm of two links in the plane in addition: a horizontal one, with
p1 = I1 + I2 + m1 c1^2 + m2 (l1^2 + c2^2), p2 = I2 + m2 c2^2, p3 = m2 l1 c2 in front of theta (c: where a
link's centre of mass lies), whose M(x) depends on where it is and obeys the skew symmetry of M' - 2 C.
Joint equations of the arm: any book of robotics, e.g. Slotine & Li, Applied Nonlinear Control, 1991, 9.1.

What a plant does follows from the same function at its true parameters, so that plant and controller can't
differ in their form.
"""

from __future__ import annotations

import math

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel
from tissueid.rendering.control.block import ARM_PARAMETERS, BASE_X, BASE_Y, LINK_1, LINK_2


@tick_kernel
def _arm_columns(
    block: FloatArray, x: FloatArray, v: FloatArray, vr: FloatArray, ar: FloatArray, Y: FloatArray
) -> None:
    """Columns of p1, p2, p3: the joint regressor, seen from the tip; elbow to the left."""
    l1, l2 = block[LINK_1], block[LINK_2]
    px, py = x[0] + block[BASE_X], x[1] + block[BASE_Y]
    cosine = (px * px + py * py - l1 * l1 - l2 * l2) / (2.0 * l1 * l2)
    q2 = math.acos(min(max(cosine, -1.0), 1.0))
    s2, c2 = math.sin(q2), math.cos(q2)
    q1 = math.atan2(py, px) - math.atan2(l2 * s2, l1 + l2 * c2)
    s1, c1 = math.sin(q1), math.cos(q1)
    s12, c12 = math.sin(q1 + q2), math.cos(q1 + q2)
    j00, j01, j10, j11 = -l1 * s1 - l2 * s12, -l2 * s12, l1 * c1 + l2 * c12, l2 * c12
    det = j00 * j11 - j01 * j10
    w1, w2 = (j11 * v[0] - j01 * v[1]) / det, (-j10 * v[0] + j00 * v[1]) / det
    r1, r2 = (j11 * vr[0] - j01 * vr[1]) / det, (-j10 * vr[0] + j00 * vr[1]) / det
    turn = w1 + w2
    # acceleration of the joints: J^-1 (ar - J' r)
    d01, d11 = -l2 * c12 * turn, -l2 * s12 * turn
    d00, d10 = d01 - l1 * c1 * w1, d11 - l1 * s1 * w1
    g0, g1 = ar[0] - d00 * r1 - d01 * r2, ar[1] - d10 * r1 - d11 * r2
    a1, a2 = (j11 * g0 - j01 * g1) / det, (-j10 * g0 + j00 * g1) / det
    first = (a1, a2, c2 * (2.0 * a1 + a2) - s2 * (w2 * r1 + turn * r2))
    second = (0.0, a1 + a2, c2 * a1 + s2 * w1 * r1)
    for k in range(3):
        # torques to forces at the tip: J^-T
        Y[0, k] = (j11 * first[k] - j10 * second[k]) / det
        Y[1, k] = (-j01 * first[k] + j00 * second[k]) / det


@tick_kernel
def regress(
    block: FloatArray, x: FloatArray, v: FloatArray, vr: FloatArray, ar: FloatArray, Y: FloatArray
) -> None:
    """Write the regressor.

    ``block`` (BLOCK_SIZE,): of :mod:`tissueid.rendering.control.block`: the arm; ``x``, ``v`` (n,): position
    [m] and velocity [m/s] of the device; ``vr``, ``ar`` (n,): reference velocity and acceleration; the
    device's own give the force that it needs; ``Y`` (n, p): **Written**; p is 3 n (n + 1) / 2, and 3 more
    with an arm.
    """
    n, size = Y.shape
    for i in range(n):
        for k in range(size):
            Y[i, k] = 0.0
    at = 0
    if block[LINK_1] > 0.0:
        _arm_columns(block, x, v, vr, ar, Y)
        at = ARM_PARAMETERS
    entries = n * (n + 1) // 2
    column = at
    for i in range(n):
        for j in range(i, n):
            Y[i, column] += ar[j]
            Y[i, column + entries] += vr[j]
            Y[i, column + 2 * entries] += x[j]
            if i != j:
                Y[j, column] += ar[i]
                Y[j, column + entries] += vr[i]
                Y[j, column + 2 * entries] += x[i]
            column += 1


@tick_kernel
def generalised_force(
    block: FloatArray,
    theta: FloatArray,
    x: FloatArray,
    v: FloatArray,
    vr: FloatArray,
    ar: FloatArray,
    Y: FloatArray,
    out: FloatArray,
) -> None:
    """Write Y(x, v, vr, ar) theta [N] into ``out``, shape (n,); ``Y`` is room to work in, and written."""
    regress(block, x, v, vr, ar, Y)
    for i in range(out.size):
        total = 0.0
        for k in range(theta.size):
            total += Y[i, k] * theta[k]
        out[i] = total


@tick_kernel
def inertia(
    block: FloatArray, theta: FloatArray, x: FloatArray, spare: FloatArray, Y: FloatArray, M: FloatArray
) -> None:
    """Write M(x) [kg] of these parameters into ``M``, shape (n, n).

    ``Y`` and ``spare``, shape (2, n), are room to work in, and written.
    """
    n = x.size
    nothing, unit = spare[0], spare[1]
    for j in range(n):
        nothing[j] = 0.0
        unit[j] = 0.0
    for j in range(n):
        unit[j] = 1.0
        regress(block, x, nothing, nothing, unit, Y)
        unit[j] = 0.0
        for i in range(n):
            # stiffness is the only part that a plant at rest still has: its columns are the last third
            total = 0.0
            for k in range(theta.size - n * (n + 1) // 2):
                total += Y[i, k] * theta[k]
            M[i, j] = total


@tick_kernel
def damping_form(theta: FloatArray, r: FloatArray) -> float:
    """Power [W] that the damping B among the parameters takes at a velocity r: r' B r."""
    n = r.size
    entries = n * (n + 1) // 2
    column = theta.size - 2 * entries
    total = 0.0
    for i in range(n):
        for j in range(i, n):
            total += theta[column] * r[i] * r[j] * (1.0 if i == j else 2.0)
            column += 1
    return float(total)


@tick_kernel
def solve(A: FloatArray, b: FloatArray) -> None:
    """Solve A y = b by elimination with pivots; the answer takes the place of ``b``, A is destroyed."""
    n = b.size
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(k, n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            b[k], b[pivot] = b[pivot], b[k]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            for j in range(k, n):
                A[i, j] -= factor * A[k, j]
            b[i] -= factor * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= A[k, j] * b[j]
        b[k] /= A[k, k]
