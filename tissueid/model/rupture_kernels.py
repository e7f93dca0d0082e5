"""Static force and stored energy of a tissue that is being rendered, for its criterion of rupture (compiled).

The same measures as :func:`tissueid.model.rupture.rupture_measures`, of the law and the state that
:func:`tissueid.model.kernels.tissue_step_in` works on, its continuation beyond the identified depth included.
"""

from __future__ import annotations

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_part
from tissueid.model.kernels import (
    _BRANCHES,
    _DEPTH,
    _PIECES,
    _STATES,
    _STATIC,
    _STATIC_SIZE,
    _STIFFNESS,
    _STIFFNESS_SIZE,
    _SURFACE,
    _continued,
    _static,
)

#: Two Gauss points on 0 to 1 integrate K_j(y) u exactly: degree 3 at the most.
NEAR, FAR = (1.0 - 3.0**-0.5) / 2.0, (1.0 + 3.0**-0.5) / 2.0


@tick_part
def static_force_in(law: FloatArray, at: int, state: FloatArray, first: int) -> float:
    """F_s at the surface [N]; ``law``, ``at``, ``state``, ``first`` as of ``tissue_step_in``."""
    value, _slope = _static(law, at, state[first + _SURFACE])
    return value


@tick_part
def stored_energy_in(law: FloatArray, at: int, state: FloatArray, first: int) -> float:
    """Energy that the springs hold [N mm]: int F_s dx + sum_j int_0^{s_j} K_j(x - s_j + u) u du."""
    depth = law[at + _DEPTH]
    x = state[first + _SURFACE]
    inside = min(x, depth)
    energy, pieces = 0.0, int(law[at + _PIECES])
    for piece in range(pieces):
        start = depth * (piece / pieces) * (piece / pieces)
        end = depth * ((piece + 1) / pieces) * ((piece + 1) / pieces)
        width, part = min(inside, end) - start, 0.0
        if width <= 0.0:
            break
        for k in range(_STATIC_SIZE - 1, -1, -1):
            part = (part + law[at + _STATIC + piece * _STATIC_SIZE + k] / (k + 1.0)) * width
        energy += part
    if x > depth:
        force, slope = _static(law, at, depth)
        beyond = x - depth
        energy += (force + 0.5 * max(slope, 0.0) * beyond) * beyond
    for j in range(int(law[at + _BRANCHES])):
        s = state[first + _STATES + j]
        block = at + _STIFFNESS + j * _STIFFNESS_SIZE
        near, _ = _continued(law, block, _STIFFNESS_SIZE, x - s + NEAR * s, depth)
        far, _ = _continued(law, block, _STIFFNESS_SIZE, x - s + FAR * s, depth)
        energy += 0.5 * s * s * (NEAR * near + FAR * far)
    return energy
