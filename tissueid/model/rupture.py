"""Measures of loading until a tissue ruptures: work, weighted force, stored energy, depth.

``W = int F dx``, ``F_s + w F_d``, ``V = int F_s dx + sum_j int_0^{s_j} K_j(x - s_j + u) u du`` (derived).
Of an exponential inside the convolution, whose force g q follows F_s, the spring is the static law itself
from the place y where it held Q = F_s(x) - q: ``V_j = g int_y^x (F_s - Q) dx`` (derived; what is lost is
``g q (x - y) / tau``).  Energies of other relaxations are sums over their nodes.  For v tau << x under
constant work dF/dv = K tau (1 - x F_s'/F): :func:`hardening_ratio`.  The compiled ones are of the state that
:func:`tissueid.model.kernels.tissue_step_in` works on.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_part
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.model.kernels import (
    _BRANCHES,
    _DEPTH,
    _DRIVERS,
    _FOLLOWED,
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
from tissueid.model.states import branch_states
from tissueid.rupture_law import CRITERIA, DEFAULT_WEIGHT

#: Depths at which a ramp is examined: the force at rupture is then good to 1e-5 of itself.
RAMP_DEPTHS = 4001
#: Two Gauss points on 0 to 1 integrate K_j(y) u exactly: degree 3 at the most.
NEAR, FAR = (1.0 - 3.0**-0.5) / 2.0, (1.0 + 3.0**-0.5) / 2.0
#: Halvings of a depth that is sought: an energy is stationary there, and good to their square.
HALVINGS = 24


def rupture_measures(
    model: ChannelModel, theta: FloatArray, path: ContactPath, *, weight: float = DEFAULT_WEIGHT
) -> dict[str, FloatArray]:
    """Measures along a path in contact from rest, (n,): criteria, ``force`` and ``dynamic`` part [N]."""
    x = path.depth_mm
    elastic, force = model.static_force(theta, x), model.force(theta, path)
    steps = 0.5 * (force[1:] + force[:-1]) * np.diff(x)
    return {
        "work": np.concatenate([[0.0], np.cumsum(steps)]),
        "weighted-force": elastic + weight * (force - elastic),
        "stored-energy": _stored(model, theta, path, elastic),
        "depth": x,
        "force": force,
        "dynamic": force - elastic,
    }


def _stored(model: ChannelModel, theta: FloatArray, path: ContactPath, elastic: FloatArray) -> FloatArray:
    """Energy that the springs of a law hold along a path, (n,) [N mm]."""
    x = path.depth_mm
    depth = float(x.max()) * np.linspace(0.0, 1.0, RAMP_DEPTHS) ** 2
    force = model.static_force(theta, depth)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(depth))])
    static = stored = np.interp(x, depth, work)
    for part in model.parts:
        weights, tau = model.exponentials(theta, part)
        states = branch_states(path.time_s, elastic if model.inside else x, tau)
        if part.ratio is not None:
            left = elastic - states
            at = np.interp(left, force, depth)
            energy = static - np.interp(at, depth, work) - left * (x - at)
            stored = stored + theta[part.ratio] * (weights @ energy)
            continue
        for share in (NEAR, FAR):
            stiffness = np.polynomial.polynomial.polyval(x - (1.0 - share) * states, theta[part.stiffness])
            stored = stored + weights @ (0.5 * share * states**2 * stiffness)
    return np.asarray(stored)


def rupture_at_speed(
    model: ChannelModel, theta: FloatArray, criterion: str, threshold: float, *, speed_mm_s: float
) -> dict[str, float] | None:
    """Measures where a ramp from rest first reaches a criterion's threshold; ``None`` within the depth.

    Raises ValueError: no such criterion.
    """
    if criterion not in CRITERIA:
        raise ValueError(f"no criterion of rupture {criterion!r}; there are {', '.join(CRITERIA)}")
    depth = np.linspace(0.0, model.depth_mm, RAMP_DEPTHS)
    measures = rupture_measures(model, theta, ContactPath(depth / speed_mm_s, depth))
    reached = measures[criterion] >= threshold
    if not reached.any():
        return None
    k = max(int(np.argmax(reached)), 1)
    low, high = measures[criterion][k - 1], measures[criterion][k]
    share = float((threshold - low) / (high - low))
    return {name: float(one[k - 1] + share * (one[k] - one[k - 1])) for name, one in measures.items()}


def hardening_ratio(model: ChannelModel, theta: FloatArray, depth_mm: float, force_N: float) -> float:
    """Static tangent over secant stiffness, x F_s'(x) / F: above 1 force at rupture falls with speed."""
    return depth_mm * float(model.static_slope(theta, np.array([depth_mm]))[0]) / force_N


@tick_part
def static_force_in(law: FloatArray, at: int, state: FloatArray, first: int) -> float:
    """F_s at the surface [N]; ``law``, ``at``, ``state``, ``first`` as of ``tissue_step_in``."""
    value, _slope = _static(law, at, state[first + _SURFACE])
    return value


@tick_part
def _static_work_in(law: FloatArray, at: int, x: float) -> float:
    """Work that the static law takes from the surface to a depth [N mm]."""
    depth, pieces = law[at + _DEPTH], int(law[at + _PIECES])
    inside, work = min(x, depth), 0.0
    for piece in range(pieces):
        start = depth * (piece / pieces) * (piece / pieces)
        end = depth * ((piece + 1) / pieces) * ((piece + 1) / pieces)
        width, part = min(inside, end) - start, 0.0
        if width <= 0.0:
            break
        for k in range(_STATIC_SIZE - 1, -1, -1):
            part = (part + law[at + _STATIC + piece * _STATIC_SIZE + k] / (k + 1.0)) * width
        work += part
    if x > depth:
        force, slope = _static(law, at, depth)
        beyond = x - depth
        work += (force + 0.5 * max(slope, 0.0) * beyond) * beyond
    return work


@tick_part
def _depth_of(law: FloatArray, at: int, force: float, low: float, high: float) -> float:
    """Depth between two at which a static law that grows holds a force."""
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        value, _slope = _static(law, at, middle)
        if value < force:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@tick_part
def stored_energy_in(law: FloatArray, at: int, state: FloatArray, first: int) -> float:
    """Energy that the springs hold [N mm], as :func:`rupture_measures` has it."""
    depth = law[at + _DEPTH]
    x = state[first + _SURFACE]
    static = _static_work_in(law, at, x)
    energy = static
    for j in range(int(law[at + _BRANCHES])):
        s = state[first + _STATES + j]
        block = at + _STIFFNESS + j * _STIFFNESS_SIZE
        if law[at + _FOLLOWED] > 0.0:
            left = state[first + _DRIVERS + j] - s
            # a surface that rises holds more than the force there: its spring is pulled
            y = _depth_of(law, at, left, 0.0, max(x, depth))
            energy += law[block] * (static - _static_work_in(law, at, y) - left * (x - y))
            continue
        near, _ = _continued(law, block, _STIFFNESS_SIZE, x - s + NEAR * s, depth)
        far, _ = _continued(law, block, _STIFFNESS_SIZE, x - s + FAR * s, depth)
        energy += 0.5 * s * s * (NEAR * near + FAR * far)
    return energy
