"""Places of a controlled loop's numbers in its flat block, for compiled code.

SI units: metres, newtons, seconds, kilograms.  The tissue's own law stays in mm and N and is a block of its
own (:func:`tissueid.model.kernels.pack_law`).
"""

from __future__ import annotations

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel

#: Axes that a loop may have.
MOST_AXES = 3

# -- virtual tool
TOOL_MASS = 0
TOOL_DAMPING = 1
# -- law
REFERENCE_RATE = 2
DAMPING = 3
#: Bound of what the estimates don't cover [N].
DISTURBANCE_BOUND = 4
SIGMA_START = 5
SIGMA_RATE = 6
SIGMA_FLOOR = 7
#: 1 adapts, 0 is frozen, -1 is wrong on purpose.
ADAPTATION_SIGN = 8
PROJECTION = 9
#: Largest control force [N]; infinite without one.
SATURATION = 10
VARIANT = 11
#: 1 where the environment is touched by the device itself and not by the virtual tool.
TOUCHED_BY_DEVICE = 12
# -- environment
FORCE_SCALE = 13
MOTION_SCALE = 14
#: Unit vector into the tissue, 3 numbers.
INWARD = 15
# -- clock
PERIOD = 18
SUBSTEPS = 19
RISE = 20
# -- arm: lengths of two links, 0 without an arm; where the work begins, from its base
LINK_1 = 21
LINK_2 = 22
BASE_X = 23
BASE_Y = 24
BLOCK_SIZE = 25

VARIANT_B = 1.0
WITHOUT_ARM = 0.0
#: Parameters of an arm of two links: p1, p2, p3.
ARM_PARAMETERS = 3


#: A number each, in this order, after the vectors.
SCALARS = ("environment_force_N", "sigma", "lyapunov", "lyapunov_rate")
#: n numbers each, in this order, after the time.
VECTORS = (
    "position_m",
    "velocity_m_s",
    "tool_position_m",
    "tool_velocity_m_s",
    "hand_force_N",
    "control_force_N",
    "rho_m_s",
    "push_N",
    "disturbance_N",
)


def row_size(axes: int, parameters: int) -> int:
    """Numbers a row: time, vectors, scalars, estimates."""
    return 1 + axes * len(VECTORS) + len(SCALARS) + parameters


@tick_kernel
def record_row(
    row: FloatArray,
    time: float,
    vectors: tuple[FloatArray, ...],
    scalars: tuple[float, float, float, float],
    estimates: FloatArray,
) -> None:
    """Write a row: the time, :data:`VECTORS`, :data:`SCALARS`, the estimates."""
    row[0] = time
    at = 1
    for vector in vectors:
        for i in range(vector.size):
            row[at] = vector[i]
            at += 1
    for scalar in scalars:
        row[at] = scalar
        at += 1
    for k in range(estimates.size):
        row[at] = estimates[k]
        at += 1
