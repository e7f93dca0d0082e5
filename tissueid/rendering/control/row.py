"""One recorded row of a controlled loop (compiled)."""

from __future__ import annotations

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel

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
