"""Compiled recursions of the branch state: exact for displacement that is linear between samples.

``tau ds/dt + s = tau dx/dt`` (Sadeghnejad et al., equations (3) and (6)) over a step ``h``::

    s[n+1] = a s[n] + phi (x[n+1] - x[n]),   a = exp(-h/tau),   phi = (1 - a) tau / h

stable for any ``h``; ``h = 0`` is a jump.  Values below 1e-200 are zero: denormal numbers slow the loop
ninefold.  For the servo the law and its memory are flat blocks, stepped without views or allocation.
"""

from __future__ import annotations

import math

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import kernel, tick_kernel, tick_part
from tissueid.model.base import MOST_BRANCHES
from tissueid.model.impact import speed_ratio
from tissueid.model.states import FLUSH_MM

#: Newton steps allowed for the detached surface; it converges in 3 or 4, bisection alone in 50.
MAX_DETACHED_ITERATIONS = 60


@kernel(error_model="python")
def step_weights(h: float, tau: float) -> tuple[float, float]:
    """Weights ``(a, phi)`` of one step of ``h`` seconds."""
    ratio = h / tau
    if ratio <= 0.0:
        return 1.0, 1.0
    return math.exp(-ratio), -math.expm1(-ratio) / ratio


# -- the law as one flat block --------------------------------------------------------------------
LAW_SIZE, MOST_PIECES = 176, 16
#: Pieces of F_s are cubics, of which piece i begins at depth (i / pieces)^2.  What the branches follow: 0 the
#: depth, 1 the static force, 2 a polynomial of depth each; 3 of a law without branches whose static force is
#: damped by the speed over that at contact.
_DEPTH, _BRANCHES, _PIECES, _FOLLOWED, _STATIC, _STIFFNESS, _TAU = 0, 1, 2, 3, 4, 68, 104
#: Coefficients of a piece, and of K a branch, constant first; a lower degree has zeros.
_STATIC_SIZE, _STIFFNESS_SIZE = 4, 3
#: Polynomials that the branches follow, constant term first (0); of a damped law chi, floor of v0 [mm/s],
#: filter of the speed [s] and hysteresis [mm].
_OWN, OWN_SIZE = 116, 5

# -- what a tissue remembers ----------------------------------------------------------------------
STATE_SIZE = 49
_SURFACE = 0
_STATES = 1
#: Room of one step: states decayed over it, and their gain by the motion of what they follow.
_DECAYED = 13
_GAIN = 25
#: What each branch follows, at the surface: a depth [mm] or a force [N].
_DRIVERS = 37


@tick_part
def _continued(block: FloatArray, at: int, size: int, x: float, depth: float) -> tuple[float, float]:
    """Value and slope of a polynomial in x, continued beyond ``depth`` with its end slope, not below 0.

    Its ``size`` coefficients stand in ``block`` from ``at``, constant term first.
    """
    inside = min(max(x, 0.0), depth)
    value, slope = 0.0, 0.0
    for k in range(at + size - 1, at - 1, -1):
        slope = slope * inside + value
        value = value * inside + block[k]
    if x > depth:
        slope = max(slope, 0.0)
        value += slope * (x - depth)
    return value, slope


@tick_part
def _static(law: FloatArray, at: int, x: float) -> tuple[float, float]:
    """F_s and its slope, piece by piece, continued beyond the depth with its end slope, not below 0."""
    depth = law[at + _DEPTH]
    pieces = int(law[at + _PIECES])
    if pieces == 1:
        return _continued(law, at + _STATIC, _STATIC_SIZE, x, depth)
    inside = min(max(x, 0.0), depth)
    piece = min(int(pieces * math.sqrt(inside / depth)), pieces - 1)
    start = depth * (piece / pieces) * (piece / pieces)
    end = depth * ((piece + 1) / pieces) * ((piece + 1) / pieces)
    value, slope = _continued(
        law, at + _STATIC + piece * _STATIC_SIZE, _STATIC_SIZE, inside - start, end - start
    )
    if x > depth:
        slope = max(slope, 0.0)
        value += slope * (x - depth)
    return value, slope


@tick_part
def _followed(law: FloatArray, at: int, j: int, y: float, force: float, slope: float) -> tuple[float, float]:
    """Driver of a branch at a surface position, and its rate by it; static force and slope are given."""
    kind = law[at + _FOLLOWED]
    if kind < 1.0:
        return y, 1.0
    if kind < 2.0:
        return force, slope
    return _continued(law, at + _OWN + j * OWN_SIZE, OWN_SIZE, y, law[at + _DEPTH])


@tick_part
def _following_force(
    law: FloatArray, at: int, state: FloatArray, first: int, y: float
) -> tuple[float, float]:
    """Force on a surface that moves linearly to ``y`` in this step, and its slope by y."""
    depth = law[at + _DEPTH]
    static, rise = _static(law, at, y)
    force, slope = static, rise
    for j in range(int(law[at + _BRANCHES])):
        gain = state[first + _GAIN + j]
        driver, rate = _followed(law, at, j, y, static, rise)
        elongation = state[first + _DECAYED + j] + gain * (driver - state[first + _DRIVERS + j])
        k, dk = _continued(law, at + _STIFFNESS + j * _STIFFNESS_SIZE, _STIFFNESS_SIZE, y, depth)
        force += k * elongation
        slope += dk * elongation + k * gain * rate
    return force, slope


@tick_kernel
def _force_free_surface(law: FloatArray, at: int, state: FloatArray, first: int, target: float) -> float:
    """Position deeper than ``target``, perhaps than before, of a free surface after this step (Newton)."""
    depth = law[at + _DEPTH]
    low, high, width = target, max(state[first + _SURFACE], target), 1e-3 * depth
    force, slope = _following_force(law, at, state, first, high)
    for _ in range(MAX_DETACHED_ITERATIONS):
        if force >= 0.0:
            break
        low = high
        high += width
        width *= 2.0
        force, slope = _following_force(law, at, state, first, high)
    y = high
    resolution = 1e-14 * depth
    for _ in range(MAX_DETACHED_ITERATIONS):
        if abs(force) <= resolution * slope or high - low <= resolution:
            break
        low, high = (low, y) if force > 0.0 else (y, high)
        candidate = y - force / slope if slope > 0.0 else low
        if not low < candidate < high:
            candidate = 0.5 * (low + high)
        y = candidate
        force, slope = _following_force(law, at, state, first, y)
    return float(y)


@tick_part
def _damped_step(law: FloatArray, at: int, state: FloatArray, first: int, x: float, h: float) -> float:
    """:func:`tissue_step_in` of a damped law, whose surface has the tool's depth."""
    ratio = speed_ratio(law, at + _OWN + 1, state, first + _STATES, x, h)
    state[first + _SURFACE] = max(x, 0.0)
    static, _slope = _static(law, at, x)
    return max(static * (1.0 + law[at + _OWN] * ratio), 0.0) if x >= 0.0 else 0.0


@tick_part
def tissue_step_in(law: FloatArray, at: int, state: FloatArray, first: int, x: float, h: float) -> float:
    """Advance the tissue by ``h`` seconds under a tool at ``x`` [mm] that can push but not pull.

    Unilateral contact (derived): force >= 0, surface >= tool, and one of the two is an equality. A
    surface that would need tension detaches, and its position is the root of the force in this very step,
    exact for linear motion. ``law``: by :func:`pack_law`; ``state``: :data:`STATE_SIZE` numbers, zero at
    rest. **Updated in place.**  Returns the force [N].
    """
    if law[at + _FOLLOWED] > 2.0:
        return _damped_step(law, at, state, first, x, h)
    n = int(law[at + _BRANCHES])
    target = max(x, 0.0)
    for j in range(n):
        a, phi = step_weights(h, law[at + _TAU + j])
        state[first + _DECAYED + j] = a * state[first + _STATES + j]
        state[first + _GAIN + j] = phi
    force, _slope = _following_force(law, at, state, first, target)
    y = target
    if force < 0.0 and n > 0:
        y = _force_free_surface(law, at, state, first, target)
    static, rise = 0.0, 0.0
    if law[at + _FOLLOWED] > 0.0:
        static, rise = _static(law, at, y)
    for j in range(n):
        driver, _rate = _followed(law, at, j, y, static, rise)
        moved = driver - state[first + _DRIVERS + j]
        elongation = state[first + _DECAYED + j] + state[first + _GAIN + j] * moved
        state[first + _STATES + j] = elongation if abs(elongation) >= FLUSH_MM else 0.0
        state[first + _DRIVERS + j] = driver
    state[first + _SURFACE] = y
    # a tool in air touches nothing, even where rounding leaves a force at the rest level
    return max(force, 0.0) if x >= 0.0 else 0.0


def pack_law(
    static: FloatArray, stiffness: FloatArray, tau: FloatArray, depth: float, law: FloatArray, at: int
) -> None:
    """Write a law in its flat form.

    ``static`` (4,) and ``stiffness`` (branches, degree + 1): by powers of x, constant term first, at most
    :data:`MOST_BRANCHES` of degree 2; ``law``: written from index ``at``, :data:`LAW_SIZE` numbers.
    """
    for k in range(LAW_SIZE):
        law[at + k] = 0.0
    law[at + _DEPTH] = depth
    law[at + _BRANCHES] = tau.size
    law[at + _PIECES] = 1.0
    for k in range(_STATIC_SIZE):
        law[at + _STATIC + k] = static[k]
    for j in range(min(tau.size, MOST_BRANCHES)):
        law[at + _TAU + j] = tau[j]
        for k in range(stiffness.shape[1]):
            law[at + _STIFFNESS + j * _STIFFNESS_SIZE + k] = stiffness[j, k]


def pack_pieces(law: FloatArray, at: int, pieces: FloatArray, *, followed: int, own: FloatArray) -> None:
    """Write a static law by pieces over one that :func:`pack_law` wrote.

    ``pieces`` (n, 4): cubics by powers of the distance from their beginning, at most :data:`MOST_PIECES`;
    ``followed``: as :data:`_FOLLOWED` has it; ``own``: what stands at :data:`_OWN`.
    """
    law[at + _PIECES] = len(pieces)
    law[at + _FOLLOWED] = float(followed)
    law[at + _OWN : at + _OWN + own.size] = own.ravel()
    law[at + _STATIC : at + _STATIC + pieces.size] = pieces.ravel()


#: For compiled callers; writing one law from Python is not worth setting numba up for.
_pack_law = kernel(error_model="python")(pack_law)


@kernel(error_model="python")
def surface_path(
    static: FloatArray,
    stiffness: FloatArray,
    tau: FloatArray,
    depth: float,
    time_s: FloatArray,
    tool_mm: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Surface (n,) [mm] and force [N] on a tool along a whole path, at rest at the first sample."""
    n, law = time_s.size, np.empty(LAW_SIZE)
    surface, force = np.empty(n), np.empty(n)
    _pack_law(static, stiffness, tau, depth, law, 0)
    state = np.zeros(STATE_SIZE)
    surface[0] = max(tool_mm[0], 0.0)
    state[_SURFACE] = surface[0]
    for j in range(tau.size):
        state[_DRIVERS + j] = surface[0]
    force[0] = _static(law, 0, surface[0])[0] if tool_mm[0] >= 0.0 else 0.0
    for i in range(1, n):
        force[i] = tissue_step_in(law, 0, state, 0, tool_mm[i], time_s[i] - time_s[i - 1])
        surface[i] = state[_SURFACE]
    return surface, force
