"""Kinematics of the Falcon's three legs, compiled: closed-form inverse, Newton forward, analytic Jacobian.

Delta robot with offset pins (geometry after R. E. Stamper, "A three degree of freedom parallel manipulator
with only translational degrees of freedom", 1997).  For leg i at azimuth phi_i, with C and S its cosine and
sine and a grip at (x, y, z)::

    u =  C x + S y - r        X = u + c          L(q) = d + e + sqrt(b^2 - q^2)
    v = -S x + C y - s        q = v + f          (X - a cos th)^2 + (z - a sin th)^2 = L(q)^2

The last line is the whole constraint of a leg; everything here is derived from it.  [SI: m, rad, N]
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "GEOMETRY_SIZE",
    "angles_of_counts",
    "forward_kernel",
    "inverse_kernel",
    "jacobian_kernel",
    "motor_units",
    "torque_kernel",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Geometry block, float64: thigh, shin, the offsets c, d + e, f, r, s [m], angle at count zero [rad],
#: angle of one count [rad], then cosine and sine of the three azimuths.
THIGH = 0
SHIN = 1
C_OFFSET = 2
PINS = 3
F_OFFSET = 4
R_OFFSET = 5
S_OFFSET = 6
ZERO_ANGLE = 7
PER_COUNT = 8
COSINES = 9
SINES = 12
GEOMETRY_SIZE = 15

#: Newton steps of the forward solution; five or six from afar, two or three when tracking.
MAX_STEPS = 60
#: Halvings of one step before the guess is given up.
MAX_HALVINGS = 30
#: Error of the constraints, as a length, below which a position is found [m].
FOUND_M = 1e-15
#: Error that is accepted where rounding lets Newton go no further [m].
GOOD_M = 1e-12
#: Longest Newton step [m]: a third of the workspace, so that a step stays on the side of the grip.
LONGEST_STEP_M = 0.05
#: A leg this near to stretched (relative lever of the thigh) has no Jacobian worth the name.
SINGULAR = 1e-9
#: Angles of a guess and of an answer that are the same [rad].
SAME_ANGLE = 1e-6
#: Grip positions from which the forward solution starts when the guess leads nowhere [m]: the axis, then
#: the six corners of the workspace, where a shin lies almost flat.
STARTS_M = (
    (0.0, 0.0, 0.12),
    (0.0, 0.0, 0.16),
    (0.0, 0.0, 0.08),
    (0.080, 0.030, 0.09),
    (0.020, 0.085, 0.09),
    (-0.070, 0.060, 0.09),
    (-0.080, -0.030, 0.09),
    (-0.020, -0.085, 0.09),
    (0.070, -0.060, 0.09),
)
#: Share of the clamp by which rounding may exceed it; a clamp is a whole number of motor units.
HALF = 0.5


@nb.njit(cache=True, nogil=True, error_model="numpy")
def angles_of_counts(counts: IntArray, geometry: FloatArray, out: FloatArray) -> None:
    """Leg angles [rad] of encoder counts; ``counts``, ``out`` of shape (3,)."""
    for i in range(3):
        out[i] = geometry[ZERO_ANGLE] + geometry[PER_COUNT] * counts[i]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _leg(i: int, x: float, y: float, z: float, geometry: FloatArray) -> tuple[float, float, float]:
    """``(X, z, q)`` of a leg [m]: where the grip's pin stands in its plane, and how far beside it."""
    cosine = geometry[COSINES + i]
    sine = geometry[SINES + i]
    along = cosine * x + sine * y - geometry[R_OFFSET] + geometry[C_OFFSET]
    beside = -sine * x + cosine * y - geometry[S_OFFSET] + geometry[F_OFFSET]
    return along, z, beside


@nb.njit(cache=True, nogil=True, error_model="numpy")
def inverse_kernel(position: FloatArray, geometry: FloatArray, out: FloatArray) -> bool:
    """Leg angles of a grip position, in closed form.

    Of the two angles that satisfy a leg's constraint the one with the knee outward is the Falcon's.

    Parameters
    ----------
    position : ndarray, shape (3,)
        [m].
    geometry : ndarray, shape (GEOMETRY_SIZE,)
    out : ndarray, shape (3,)
        Angles [rad]; meaningless where the answer is False.

    Returns
    -------
    bool
        False where no leg reaches the position.
    """
    a = geometry[THIGH]
    b = geometry[SHIN]
    for i in range(3):
        along, w, beside = _leg(i, position[0], position[1], position[2], geometry)
        if not abs(beside) <= b:
            return False
        reach = geometry[PINS] + math.sqrt(b * b - beside * beside)
        distance = math.hypot(along, w)
        cosine = (distance * distance + a * a - reach * reach) / (2.0 * a * distance)
        if not abs(cosine) <= 1.0:
            return False
        out[i] = math.atan2(w, along) - math.acos(cosine)
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _constraints(
    x: float,
    y: float,
    z: float,
    angles: FloatArray,
    geometry: FloatArray,
    error: FloatArray,
    slope: FloatArray,
) -> bool:
    """Constraints of the three legs at a position, as lengths [m], and their slopes by the position.

    A constraint is written ``hypot(X - a cos th, z - a sin th) - L(q)``: its error is a distance.
    """
    a = geometry[THIGH]
    b = geometry[SHIN]
    for i in range(3):
        along, w, beside = _leg(i, x, y, z, geometry)
        if not abs(beside) < b:
            return False
        root = math.sqrt(b * b - beside * beside)
        du = along - a * math.cos(angles[i])
        dw = w - a * math.sin(angles[i])
        length = math.hypot(du, dw)
        if not length > 0.0:
            return False
        error[i] = length - geometry[PINS] - root
        cosine = geometry[COSINES + i]
        sine = geometry[SINES + i]
        bend = beside / root
        slope[i, 0] = du / length * cosine - bend * sine
        slope[i, 1] = du / length * sine + bend * cosine
        slope[i, 2] = dw / length
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _solve(matrix: FloatArray, right: FloatArray, out: FloatArray) -> bool:
    """Solve a 3 x 3 system by Cramer's rule; False where it is singular."""
    determinant = _determinant(matrix)
    if not abs(determinant) > SINGULAR:
        return False
    for k in range(3):
        p = (k + 1) % 3
        q = (k + 2) % 3
        # column k replaced by the right-hand side; cyclic order keeps the sign
        out[k] = (
            right[0] * (matrix[1, p] * matrix[2, q] - matrix[1, q] * matrix[2, p])
            + right[1] * (matrix[2, p] * matrix[0, q] - matrix[2, q] * matrix[0, p])
            + right[2] * (matrix[0, p] * matrix[1, q] - matrix[0, q] * matrix[1, p])
        ) / determinant
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _determinant(m: FloatArray) -> float:
    return float(
        m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
        - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
        + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    )


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _largest(values: FloatArray) -> float:
    return float(max(abs(values[0]), abs(values[1]), abs(values[2])))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _newton(angles: FloatArray, geometry: FloatArray, position: FloatArray) -> int:
    """Newton with halved steps from ``position``, which is changed; steps taken, or -1."""
    error = np.empty(3)
    trial_error = np.empty(3)
    slope = np.empty((3, 3))
    trial_slope = np.empty((3, 3))
    step = np.empty(3)
    if not _constraints(position[0], position[1], position[2], angles, geometry, error, slope):
        return -1
    size = _largest(error)
    for steps in range(MAX_STEPS):
        if size <= FOUND_M:
            return steps
        if not _solve(slope, error, step):
            return -1
        factor = min(1.0, LONGEST_STEP_M / max(_largest(step), FOUND_M))
        moved = False
        for _ in range(MAX_HALVINGS):
            x = position[0] - factor * step[0]
            y = position[1] - factor * step[1]
            z = position[2] - factor * step[2]
            if z > 0.0 and _constraints(x, y, z, angles, geometry, trial_error, trial_slope):
                trial = _largest(trial_error)
                if trial < size:
                    moved = True
                    break
            factor *= HALF
        if not moved:
            return steps if size <= GOOD_M else -1
        position[0], position[1], position[2] = x, y, z
        size = trial
        error[:] = trial_error
        slope[:] = trial_slope
    return MAX_STEPS if size <= GOOD_M else -1


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _same_angles(angles: FloatArray, geometry: FloatArray, position: FloatArray) -> bool:
    """Whether a position that satisfies the constraints is the one with the knees outward."""
    back = np.empty(3)
    if not inverse_kernel(position, geometry, back):
        return False
    back -= angles
    return _largest(back) <= SAME_ANGLE


@nb.njit(cache=True, nogil=True, error_model="numpy")
def forward_kernel(angles: FloatArray, geometry: FloatArray, position: FloatArray) -> int:
    """Grip position of three leg angles, by Newton's method from a guess, then from fixed starts.

    Parameters
    ----------
    angles : ndarray, shape (3,)
        [rad].
    geometry : ndarray, shape (GEOMETRY_SIZE,)
    position : ndarray, shape (3,)
        Guess [m], replaced by the answer; kept where there is none.

    Returns
    -------
    int
        Newton steps taken, or -1 where no position in front of the base has these angles.
    """
    found = np.empty(3)
    for start in range(-1, len(STARTS_M)):
        if start < 0:
            found[:] = position
        else:
            found[0], found[1], found[2] = STARTS_M[start]
        steps = _newton(angles, geometry, found)
        if steps >= 0 and _same_angles(angles, geometry, found):
            position[:] = found
            return steps
    return -1


@nb.njit(cache=True, nogil=True, error_model="numpy")
def jacobian_kernel(position: FloatArray, geometry: FloatArray, out: FloatArray) -> bool:
    """``D = dp/dtheta`` at a grip position, by implicit differentiation of the constraints.

    Parameters
    ----------
    position : ndarray, shape (3,)
        [m].
    geometry : ndarray, shape (GEOMETRY_SIZE,)
    out : ndarray, shape (3, 3)
        Row: coordinate; column: leg [m/rad].

    Returns
    -------
    bool
        False outside the workspace and where a leg is stretched or folded.
    """
    angles = np.empty(3)
    if not inverse_kernel(position, geometry, angles):
        return False
    error = np.empty(3)
    rates = np.empty((3, 3))
    if not _constraints(position[0], position[1], position[2], angles, geometry, error, rates):
        return False
    a = geometry[THIGH]
    for i in range(3):
        along, w, _beside = _leg(i, position[0], position[1], position[2], geometry)
        cosine = math.cos(angles[i])
        sine = math.sin(angles[i])
        length = math.hypot(along - a * cosine, w - a * sine)
        # slope of the constraint by the angle [m/rad]
        lever = a * (along * sine - w * cosine) / length
        if not abs(lever) > SINGULAR * a:
            return False
        for k in range(3):
            rates[i, k] = -rates[i, k] / lever
    unit = np.zeros(3)
    column = np.empty(3)
    for i in range(3):
        unit[i] = 1.0
        if not _solve(rates, unit, column):
            return False
        unit[i] = 0.0
        for k in range(3):
            out[k, i] = column[k]
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def torque_kernel(position: FloatArray, force: FloatArray, geometry: FloatArray, out: FloatArray) -> bool:
    """Arm torques ``D^T F`` [N m] that push the hand with a force [N]; False where there is no Jacobian."""
    rates = np.empty((3, 3))
    if not jacobian_kernel(position, geometry, rates):
        return False
    for i in range(3):
        out[i] = rates[0, i] * force[0] + rates[1, i] * force[1] + rates[2, i] * force[2]
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def motor_units(
    force: FloatArray,
    position: FloatArray,
    geometry: FloatArray,
    units_per_Nm: float,
    clamp_units: float,
    out: IntArray,
) -> bool:
    """Motor commands of a force on the hand, scaled down together where one exceeds the clamp.

    ``motor = -units_per_Nm D^T F``; the sign is that of recorded packets of the vendor's driver.

    Parameters
    ----------
    force, position : ndarray, shape (3,)
        [N], [m].
    geometry : ndarray, shape (GEOMETRY_SIZE,)
    units_per_Nm : float
        Motor units of one N m of arm torque.
    clamp_units : float
        Largest command of a motor, at most 4095.
    out : ndarray of int64, shape (3,)
        Filled; zeros where the position has no Jacobian or a number is not finite.

    Returns
    -------
    bool
        Whether the command is not what was asked for.
    """
    out[:] = 0
    torque = np.empty(3)
    if not torque_kernel(position, force, geometry, torque):
        return True
    largest = units_per_Nm * _largest(torque)
    if not largest < math.inf:
        return True
    scale = -units_per_Nm
    clipped = largest > clamp_units
    if clipped:
        scale *= clamp_units / largest
    for i in range(3):
        # towards zero where it was clipped, so that rounding never exceeds the clamp
        value = scale * torque[i]
        out[i] = int(value) if clipped else math.floor(value + HALF)
    return clipped
