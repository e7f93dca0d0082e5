"""Kinematics of the Falcon's three legs: closed-form inverse, Newton forward, analytic Jacobian.

Delta robot with offset pins (R. E. Stamper, "A three degree of freedom parallel manipulator with only
translational degrees of freedom", 1997).  For leg i at azimuth phi_i, with C and S its cosine and sine::

    u =  C x + S y - r        X = u + c          L(q) = d + e + sqrt(b^2 - q^2)
    v = -S x + C y - s        q = v + f          (X - a cos th)^2 + (z - a sin th)^2 = L(q)^2

The last line is the whole constraint of a leg.  Frame: x right, y up, z out toward the user; origin on the
device's axis at its base; legs 1 (top), 2 (right) and 3 (left).  [SI: m, rad, N]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import tick_kernel
from tissueid.errors import DeviceError

#: Azimuths of legs 1 (top), 2 (right) and 3 (left), seen from the front [deg].
AZIMUTHS_DEG = (105.0, -15.0, -135.0)
#: Lines of the encoder wheel, each counted four times.
COUNTS_PER_TURN = 320 * 4


@dataclass(frozen=True)
class Geometry:
    """Lengths and angles of the legs, in the letters of Stamper (1997)."""

    #: a, b, c, d + e, f, r and s [m].
    thigh_m: float
    shin_m: float
    c_m: float
    pins_m: float
    f_m: float
    r_m: float
    s_m: float
    gear: float  # turns of the encoder wheel for one turn of the arm
    #: Leg angle at count zero.  35, 40 and 50 have been reported: calibrate.
    zero_angle_deg: float

    @property
    def radians_per_count(self) -> float:
        """Leg angle of one encoder count [rad]."""
        return 2.0 * math.pi / (COUNTS_PER_TURN * self.gear)

    def block(self) -> NDArray[np.float64]:
        """The numbers for the kernels, shape (GEOMETRY_SIZE,), read-only."""
        out = np.empty(GEOMETRY_SIZE)
        out[:COSINES] = (
            self.thigh_m, self.shin_m, self.c_m, self.pins_m, self.f_m, self.r_m, self.s_m,
            math.radians(self.zero_angle_deg), self.radians_per_count,
        )  # fmt: skip
        azimuths = np.radians(AZIMUTHS_DEG)
        out[COSINES : COSINES + 3] = np.cos(azimuths)
        out[SINES : SINES + 3] = np.sin(azimuths)
        out.setflags(write=False)
        return out


GEOMETRIES = {
    # widely used with open drivers, in the notation of Stamper (1997)
    "stamper": Geometry(0.060, 0.1025, 0.01443, 0.0225, -0.025, 0.040, -0.02309, 110.0 / 14.25, 35.0),
    # Martin and Hillier (2009), as quoted by users; signs of f and s set to those of the first
    "martin-hillier": Geometry(0.060, 0.1025, 0.0157, 0.023, -0.0262, 0.0366, -0.0272, 7.62, 35.0),
}
DEFAULT_GEOMETRY = GEOMETRIES["stamper"]

#: Three numbers, and three rows of them.
Vector = tuple[float, float, float]
Rows = tuple[Vector, Vector, Vector]

#: Geometry block, float64: thigh, shin, the offsets c, d + e, f, r, s [m], angle at count zero [rad],
#: angle of one count [rad], then cosine and sine of the three azimuths.
THIGH, SHIN, C_OFFSET, PINS, F_OFFSET, R_OFFSET, S_OFFSET, ZERO_ANGLE, PER_COUNT = range(9)
COSINES, SINES, GEOMETRY_SIZE = 9, 12, 15

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
#: Commands whose squares overflow.
LARGEST_UNITS = 1e150
HALF = 0.5
ZERO = (0.0, 0.0, 0.0)


@tick_kernel
def angles_of_counts(counts: IntArray, geometry: FloatArray, out: FloatArray) -> None:
    """Leg angles [rad] of encoder counts; ``counts``, ``out`` of shape (3,)."""
    for i in range(3):
        out[i] = geometry[ZERO_ANGLE] + geometry[PER_COUNT] * counts[i]


@tick_kernel
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@tick_kernel
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@tick_kernel
def _scaled(a: Vector, factor: float) -> Vector:
    return a[0] * factor, a[1] * factor, a[2] * factor


@tick_kernel
def _largest(a: Vector) -> float:
    return max(abs(a[0]), abs(a[1]), abs(a[2]))


@tick_kernel
def _inverse_columns(rows: Rows) -> tuple[bool, Vector, Vector, Vector]:
    """Columns of the inverse of a 3 x 3 matrix; False where it is singular."""
    first = _cross(rows[1], rows[2])
    determinant = _dot(rows[0], first)
    if not abs(determinant) > SINGULAR:
        return False, ZERO, ZERO, ZERO
    over = 1.0 / determinant
    second = _cross(rows[2], rows[0])
    third = _cross(rows[0], rows[1])
    return True, _scaled(first, over), _scaled(second, over), _scaled(third, over)


@tick_kernel
def _leg(i: int, p: Vector, geometry: FloatArray) -> tuple[float, float]:
    """``(X, q)`` of a leg [m]: how far out the grip's pin stands in the leg's plane, how far beside it."""
    cosine = geometry[COSINES + i]
    sine = geometry[SINES + i]
    along = cosine * p[0] + sine * p[1] - geometry[R_OFFSET] + geometry[C_OFFSET]
    beside = -sine * p[0] + cosine * p[1] - geometry[S_OFFSET] + geometry[F_OFFSET]
    return along, beside


@tick_kernel
def _leg_angle(i: int, p: Vector, geometry: FloatArray) -> tuple[bool, float]:
    """Angle of a leg with its knee outward; False where it does not reach."""
    a = geometry[THIGH]
    b = geometry[SHIN]
    along, beside = _leg(i, p, geometry)
    if not abs(beside) <= b:
        return False, 0.0
    reach = geometry[PINS] + math.sqrt(b * b - beside * beside)
    distance = math.hypot(along, p[2])
    cosine = (distance * distance + a * a - reach * reach) / (2.0 * a * distance)
    if not abs(cosine) <= 1.0:
        return False, 0.0
    return True, math.atan2(p[2], along) - math.acos(cosine)


@tick_kernel
def inverse_kernel(position: FloatArray, geometry: FloatArray, out: FloatArray) -> bool:
    """Write the leg angles of a grip position, knees outward; False where a leg does not reach it."""
    p = (position[0], position[1], position[2])
    for i in range(3):
        reached, angle = _leg_angle(i, p, geometry)
        if not reached:
            return False
        out[i] = angle
    return True


@tick_kernel
def _constraint(
    i: int, p: Vector, cosine: float, sine: float, geometry: FloatArray
) -> tuple[bool, float, Vector, float]:
    """Constraint ``hypot(X - a cos th, z - a sin th) - L(q)`` of a leg [m], its slope, and lever [m/rad]."""
    a = geometry[THIGH]
    b = geometry[SHIN]
    along, beside = _leg(i, p, geometry)
    if not abs(beside) < b:
        return False, 0.0, ZERO, 0.0
    root = math.sqrt(b * b - beside * beside)
    out = along - a * cosine
    up = p[2] - a * sine
    length = math.hypot(out, up)
    if not length > 0.0:
        return False, 0.0, ZERO, 0.0
    bend = beside / root
    x = out / length * geometry[COSINES + i] - bend * geometry[SINES + i]
    y = out / length * geometry[SINES + i] + bend * geometry[COSINES + i]
    lever = a * (along * sine - p[2] * cosine) / length
    return True, length - geometry[PINS] - root, (x, y, up / length), lever


@tick_kernel
def _constraints(
    p: Vector, cosines: Vector, sines: Vector, geometry: FloatArray
) -> tuple[bool, Vector, Rows]:
    """Errors of the three constraints [m] and their slopes; False where a shin can't be laid."""
    reached0, error0, slope0, _ = _constraint(0, p, cosines[0], sines[0], geometry)
    reached1, error1, slope1, _ = _constraint(1, p, cosines[1], sines[1], geometry)
    reached2, error2, slope2, _ = _constraint(2, p, cosines[2], sines[2], geometry)
    return reached0 and reached1 and reached2, (error0, error1, error2), (slope0, slope1, slope2)


@tick_kernel
def _newton(p: Vector, angles: FloatArray, geometry: FloatArray) -> tuple[int, Vector]:
    """Newton with halved steps from ``p``; steps taken, or -1, and where it ended."""
    cosines = (math.cos(angles[0]), math.cos(angles[1]), math.cos(angles[2]))
    sines = (math.sin(angles[0]), math.sin(angles[1]), math.sin(angles[2]))
    reached, error, slope = _constraints(p, cosines, sines, geometry)
    if not reached:
        return -1, p
    for steps in range(MAX_STEPS):
        size = _largest(error)
        if size <= FOUND_M:
            return steps, p
        regular, first, second, third = _inverse_columns(slope)
        if not regular:
            return -1, p
        x = first[0] * error[0] + second[0] * error[1] + third[0] * error[2]
        y = first[1] * error[0] + second[1] * error[1] + third[1] * error[2]
        z = first[2] * error[0] + second[2] * error[1] + third[2] * error[2]
        factor = min(1.0, LONGEST_STEP_M / max(_largest((x, y, z)), FOUND_M))
        nearer = False
        for _ in range(MAX_HALVINGS):
            trial = (p[0] - factor * x, p[1] - factor * y, p[2] - factor * z)
            reached, trial_error, trial_slope = _constraints(trial, cosines, sines, geometry)
            if trial[2] > 0.0 and reached and _largest(trial_error) < size:
                p, error, slope, nearer = trial, trial_error, trial_slope, True
                break
            factor *= HALF
        if not nearer:
            return (steps if size <= GOOD_M else -1), p
    return (MAX_STEPS if _largest(error) <= GOOD_M else -1), p


@tick_kernel
def _knees_outward(p: Vector, angles: FloatArray, geometry: FloatArray) -> bool:
    """True where a position that satisfies the constraints is the one of the Falcon."""
    for i in range(3):
        reached, angle = _leg_angle(i, p, geometry)
        if not reached or abs(angle - angles[i]) > SAME_ANGLE:
            return False
    return True


@tick_kernel
def forward_kernel(angles: FloatArray, geometry: FloatArray, position: FloatArray) -> int:
    """Write the grip position of leg angles over its guess; Newton steps taken, or -1 where there is none."""
    start = (position[0], position[1], position[2])
    for k in range(len(STARTS_M) + 1):
        steps, found = _newton(start, angles, geometry)
        if steps >= 0 and _knees_outward(found, angles, geometry):
            position[0], position[1], position[2] = found
            return steps
        if k < len(STARTS_M):
            start = STARTS_M[k]
    return -1


@tick_kernel
def _rates(p: Vector, geometry: FloatArray) -> tuple[bool, Vector, Vector, Vector]:
    """Columns ``dp/dtheta_i`` [m/rad], by implicit differentiation of the constraints."""
    rows = (ZERO, ZERO, ZERO)
    for i in range(3):
        reached, angle = _leg_angle(i, p, geometry)
        if not reached:
            return False, ZERO, ZERO, ZERO
        reached, _error, slope, lever = _constraint(i, p, math.cos(angle), math.sin(angle), geometry)
        if not reached or abs(lever) <= SINGULAR * geometry[THIGH]:
            return False, ZERO, ZERO, ZERO
        rows = (rows[1], rows[2], _scaled(slope, -1.0 / lever))
    return _inverse_columns(rows)


@tick_kernel
def _torques(position: FloatArray, force: FloatArray, geometry: FloatArray) -> tuple[bool, Vector]:
    """Arm torques ``D^T F`` [N m] that push the hand with a force [N]; False where there is no Jacobian."""
    regular, first, second, third = _rates((position[0], position[1], position[2]), geometry)
    push = (force[0], force[1], force[2])
    return regular, (_dot(first, push), _dot(second, push), _dot(third, push))


@tick_kernel
def motor_units(
    force: FloatArray,
    position: FloatArray,
    geometry: FloatArray,
    units_per_Nm: float,
    clamp_units: float,
    out: IntArray,
    left: FloatArray,
) -> bool:
    """Motor commands of a force on the hand, scaled down together where they exceed the clamp.

    ``motor = -units_per_Nm D^T F``; the sign is that of recorded packets of the vendor's driver.
    ``clamp_units``: largest root of the sum of their squares; ``left`` (3,): what rounding left of the
    command before, which is made up for, so that the mean of commands is the force.  Zeros where there is no
    force, no Jacobian or no finite number.  Returns whether the command is not what was asked for.
    """
    out[0] = out[1] = out[2] = 0
    regular, torque = _torques(position, force, geometry)
    finite = math.isfinite(torque[0]) and math.isfinite(torque[1]) and math.isfinite(torque[2])
    # a torque that may be squared
    largest = units_per_Nm * _largest(torque)
    known = regular and finite and largest < LARGEST_UNITS
    if not known or largest == 0.0:
        left[0] = left[1] = left[2] = 0.0
        return not known
    scale = -units_per_Nm
    together = units_per_Nm * math.sqrt(_dot(torque, torque))
    clipped = together > clamp_units
    if clipped:
        scale *= clamp_units / together
    square = 0.0
    for i in range(3):
        wanted = scale * torque[i] + left[i]
        out[i] = math.floor(wanted + HALF)
        left[i] = wanted - out[i]
        square += float(out[i] * out[i])
    if clipped or square > clamp_units * clamp_units:
        # towards zero, so that rounding never exceeds the clamp
        for i in range(3):
            out[i], left[i] = int(scale * torque[i]), 0.0
    return clipped


#: Where the forward solution starts without a guess: mid-workspace, on the axis [m].
GUESS_M = (0.0, 0.0, 0.12)


class WorkspaceError(DeviceError, ValueError):
    """No leg reaches the position, or no position has the angles."""


@cache
def _block(geometry: Geometry) -> FloatArray:
    return geometry.block()


def _vector(value: ArrayLike, what: str) -> FloatArray:
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise ValueError(f"{what} must be three finite numbers, not {value!r}")
    return vector


def inverse(position_m: ArrayLike, *, geometry: Geometry = DEFAULT_GEOMETRY) -> FloatArray:
    """Leg angles (3,) [rad] of a grip position (3,) [m]; WorkspaceError where a leg does not reach."""
    position = _vector(position_m, "a position")
    angles = np.empty(3)
    if not inverse_kernel(position, _block(geometry), angles):
        msg = f"the position {position.tolist()} m is outside the workspace: a leg does not reach it"
        raise WorkspaceError(msg)
    return angles


def forward(
    angles_rad: ArrayLike, guess: ArrayLike | None = None, *, geometry: Geometry = DEFAULT_GEOMETRY
) -> FloatArray:
    """Grip position (3,) [m] of leg angles (3,) [rad], in front of the base and with the knees outward.

    ``guess``: position nearby [m]; spares some Newton steps, and within the stops never changes the answer
    beyond rounding: outside them several positions may have these angles.
    Raises WorkspaceError: no position has these angles.
    """
    angles = _vector(angles_rad, "angles")
    position = _vector(GUESS_M if guess is None else guess, "a guess")
    if forward_kernel(angles, _block(geometry), position) < 0:
        raise WorkspaceError(f"no grip position has the leg angles {angles.tolist()} rad")
    return position


def torque(position_m: ArrayLike, force_N: ArrayLike, *, geometry: Geometry = DEFAULT_GEOMETRY) -> FloatArray:
    """Torques (3,) [N m] that push the hand with a force (3,) [N], ``(dp/dtheta)^T F``; or WorkspaceError."""
    position = _vector(position_m, "a position")
    regular, torques = _torques(position, _vector(force_N, "a force"), _block(geometry))
    if not regular:
        msg = f"there is no Jacobian at {position.tolist()} m: outside the workspace, or a leg is stretched"
        raise WorkspaceError(msg)
    return np.array(torques)
