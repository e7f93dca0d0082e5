"""Kinematics of the Falcon for Python: positions to angles and back, Jacobian, torques.

Frame: x right, y up, z out toward the user; origin on the device's axis at its base.  Angles are those of
the thighs of legs 1 (top), 2 (right) and 3 (left).  The servo uses the same compiled functions
(:mod:`tissueid.haptics.falcon.kinematic_kernels`, where the equations stand).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError
from tissueid.haptics.falcon.constants import DEFAULT_GEOMETRY, Geometry
from tissueid.haptics.falcon.kinematic_kernels import (
    forward_kernel,
    inverse_kernel,
    jacobian_kernel,
    torque_kernel,
)

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
        msg = f"{what} must be three finite numbers, not {value!r}"
        raise ValueError(msg)
    return vector


def inverse(position_m: ArrayLike, *, geometry: Geometry = DEFAULT_GEOMETRY) -> FloatArray:
    """Leg angles of a grip position.

    Parameters
    ----------
    position_m : array_like, shape (3,)
    geometry : Geometry

    Returns
    -------
    ndarray, shape (3,)
        [rad].

    Raises
    ------
    WorkspaceError
        Where no leg reaches.
    """
    position = _vector(position_m, "a position")
    angles = np.empty(3)
    if not inverse_kernel(position, _block(geometry), angles):
        msg = f"the position {position.tolist()} m is outside the workspace: a leg does not reach it"
        raise WorkspaceError(msg)
    return angles


def forward(
    angles_rad: ArrayLike, guess: ArrayLike | None = None, *, geometry: Geometry = DEFAULT_GEOMETRY
) -> FloatArray:
    """Grip position of three leg angles.

    Parameters
    ----------
    angles_rad : array_like, shape (3,)
    guess : array_like, shape (3,), optional
        Position nearby [m]; spares some Newton steps, and never changes the answer beyond rounding.
    geometry : Geometry

    Returns
    -------
    ndarray, shape (3,)
        [m], in front of the base (z > 0) and with the knees outward.

    Raises
    ------
    WorkspaceError
        Where no position has these angles.
    """
    angles = _vector(angles_rad, "angles")
    position = _vector(GUESS_M if guess is None else guess, "a guess")
    if forward_kernel(angles, _block(geometry), position) < 0:
        msg = f"no grip position has the leg angles {angles.tolist()} rad"
        raise WorkspaceError(msg)
    return position


def jacobian(position_m: ArrayLike, *, geometry: Geometry = DEFAULT_GEOMETRY) -> FloatArray:
    """``dp/dtheta`` at a grip position.

    Returns
    -------
    ndarray, shape (3, 3)
        Row: coordinate; column: leg [m/rad].

    Raises
    ------
    WorkspaceError
        Outside the workspace, and where a leg is stretched.
    """
    position = _vector(position_m, "a position")
    out = np.empty((3, 3))
    if not jacobian_kernel(position, _block(geometry), out):
        msg = f"there is no Jacobian at {position.tolist()} m: outside the workspace, or a leg is stretched"
        raise WorkspaceError(msg)
    return out


def torque(position_m: ArrayLike, force_N: ArrayLike, *, geometry: Geometry = DEFAULT_GEOMETRY) -> FloatArray:
    """Arm torques that push the hand with a force: ``tau = (dp/dtheta)^T F``, so ``tau.dtheta = F.dp``.

    Parameters
    ----------
    position_m, force_N : array_like, shape (3,)
        [m] and [N]; the force of the device on the hand.
    geometry : Geometry

    Returns
    -------
    ndarray, shape (3,)
        [N m].

    Raises
    ------
    WorkspaceError
        Outside the workspace, and where a leg is stretched.
    """
    position = _vector(position_m, "a position")
    force = _vector(force_N, "a force")
    out = np.empty(3)
    if not torque_kernel(position, force, _block(geometry), out):
        msg = f"there is no Jacobian at {position.tolist()} m: outside the workspace, or a leg is stretched"
        raise WorkspaceError(msg)
    return out
