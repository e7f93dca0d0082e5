"""Measures of loading until a tissue ruptures: work, weighted force, stored energy, depth.

``W = int F dx``, ``F_s + w F_d``, ``V = int F_s dx + sum_j int_0^{s_j} K_j(x - s_j + u) u du`` (derived).
For v tau << x under constant work dF/dv = K tau (1 - x F_s'/F): :func:`hardening_ratio`.  The compiled ones
are of the state that :func:`tissueid.model.kernels.tissue_step_in` works on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_part
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel, branch_states
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
from tissueid.rupture_law import CRITERIA, DEFAULT_WEIGHT

#: Depths at which a ramp is examined: the force at rupture is then good to 1e-5 of itself.
RAMP_DEPTHS = 4001
#: Two Gauss points on 0 to 1 integrate K_j(y) u exactly: degree 3 at the most.
NEAR, FAR = (1.0 - 3.0**-0.5) / 2.0, (1.0 + 3.0**-0.5) / 2.0


@dataclass(frozen=True, slots=True)
class RupturePoint:
    """End of a ramp in a rupture."""

    speed_mm_s: float
    depth_mm: float
    force_N: float
    dynamic_N: float  # part of the force that relaxes
    work_N_mm: float  # from contact


def rupture_measures(
    model: ChannelModel, theta: FloatArray, path: ContactPath, *, weight: float = DEFAULT_WEIGHT
) -> dict[str, FloatArray]:
    """Measures along a path in contact from rest, (n,): criteria, ``force`` and ``dynamic`` part [N]."""
    x = path.depth_mm
    static, _, tau = model.split(theta)
    states = branch_states(path.time_s, path.depth_mm, tau)
    dynamic = (model.stiffness(theta, x) * states).sum(axis=0)
    elastic = model.static_force(theta, x)
    force = elastic + dynamic
    steps = 0.5 * (force[1:] + force[:-1]) * np.diff(x)
    stored = x * x * (static[0] / 2.0 + x * (static[1] / 3.0 + x * static[2] / 4.0))
    for share in (NEAR, FAR):
        for branch, state in enumerate(states):
            stored = (
                stored + 0.5 * share * state**2 * model.stiffness(theta, x - (1.0 - share) * state)[branch]
            )
    return {
        "work": np.concatenate([[0.0], np.cumsum(steps)]),
        "weighted-force": elastic + weight * dynamic,
        "stored-energy": stored,
        "depth": x,
        "force": force,
        "dynamic": dynamic,
    }


def rupture_at_speed(
    model: ChannelModel,
    theta: FloatArray,
    criterion: str,
    threshold: float,
    *,
    speed_mm_s: float,
    weight: float = DEFAULT_WEIGHT,
) -> RupturePoint | None:
    """Point at which a ramp from rest first reaches a criterion's threshold; ``None`` within the depth.

    Raises ValueError: no such criterion.
    """
    if criterion not in CRITERIA:
        msg = f"no criterion of rupture {criterion!r}; there are {', '.join(CRITERIA)}"
        raise ValueError(msg)
    depth = np.linspace(0.0, model.depth_mm, RAMP_DEPTHS)
    measures = rupture_measures(model, theta, ContactPath(depth / speed_mm_s, depth), weight=weight)
    reached = measures[criterion] >= threshold
    if not reached.any():
        return None
    k = max(int(np.argmax(reached)), 1)
    low, high = measures[criterion][k - 1], measures[criterion][k]
    share = float((threshold - low) / (high - low))

    def between(name: str) -> float:
        values = measures[name]
        return float(values[k - 1] + share * (values[k] - values[k - 1]))

    return RupturePoint(speed_mm_s, between("depth"), between("force"), between("dynamic"), between("work"))


def peak_force_against_speed(
    model: ChannelModel,
    theta: FloatArray,
    criterion: str,
    threshold: float,
    speeds_mm_s: Sequence[float],
    *,
    weight: float = DEFAULT_WEIGHT,
) -> FloatArray:
    """Force at rupture over speed, (n,) [N]: Fig. 4 of paper A; NaN without a rupture within the depth."""
    points = [
        rupture_at_speed(model, theta, criterion, threshold, speed_mm_s=speed, weight=weight)
        for speed in speeds_mm_s
    ]
    return np.array([np.nan if point is None else point.force_N for point in points])


def hardening_ratio(model: ChannelModel, theta: FloatArray, depth_mm: float, force_N: float) -> float:
    """Static tangent over secant stiffness, x F_s'(x) / F: above 1 force at rupture falls with speed."""
    static, _, _ = model.split(theta)
    slope = static[0] + depth_mm * (2.0 * static[1] + 3.0 * static[2] * depth_mm)
    return float(depth_mm * slope / force_N)


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
