"""Compiled recursions of the branch state: exact for displacement that is linear between samples.

The series branch of the modified Kelvin-Voigt model obeys ``tau ds/dt + s = tau dx/dt`` (reconstructed from
Sadeghnejad et al., equations (3) and (6)).  With ``x`` linear over a step ``h``::

    s[n+1] = a s[n] + phi (x[n+1] - x[n]),   a = exp(-h/tau),   phi = (1 - a) tau / h

which has no step-size error and is stable for any ``h``; ``h = 0`` is a jump (a = phi = 1).  Values
below 1e-200 are set to zero, because denormal numbers slow the loop ninefold.

A servo steps the tissue a thousand times a second, so the law and what it remembers also have a flat
form, :func:`pack_law` and :func:`tissue_step_in`: no views, nothing allocated, and it can be part of a
larger block.
"""

from __future__ import annotations

import math

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import kernel, tick_kernel, tick_part
from tissueid.model.impact import speed_ratio

#: Magnitude below which a branch state counts as zero [mm]; far above the denormal range.
FLUSH_MM = 1e-200
#: Newton steps allowed for the detached surface; it converges in 3 or 4, bisection alone in 50.
MAX_DETACHED_ITERATIONS = 60


@kernel(error_model="python")
def step_weights(h: float, tau: float) -> tuple[float, float]:
    """Weights ``(a, phi)`` of one step of ``h`` seconds."""
    ratio = h / tau
    if ratio <= 0.0:
        return 1.0, 1.0
    return math.exp(-ratio), -math.expm1(-ratio) / ratio


@kernel(error_model="python")
def branch_state(time_s: FloatArray, depth_mm: FloatArray, tau: float, initial: float) -> FloatArray:
    """State of one branch at every sample.

    ``time_s``, ``depth_mm`` (n,): non-decreasing times [s] and depths [mm]; ``tau``: relaxation time [s];
    ``initial``: state at the first sample [mm]; 0 for a tissue at rest.  Returns (n,), spring elongation of
    the branch [mm].
    """
    n = time_s.size
    out = np.empty(n)
    s = initial
    out[0] = s
    last_h = -1.0
    a = 1.0
    phi = 1.0
    for i in range(1, n):
        h = time_s[i] - time_s[i - 1]
        if h != last_h:
            a, phi = step_weights(h, tau)
            last_h = h
        s = a * s + phi * (depth_mm[i] - depth_mm[i - 1])
        if abs(s) < FLUSH_MM:
            s = 0.0
        out[i] = s
    return out


@kernel(error_model="python")
def branch_sensitivity(time_s: FloatArray, depth_mm: FloatArray, tau: float) -> tuple[FloatArray, FloatArray]:
    """State of one branch from rest and its derivative by the relaxation time.

    Returns ``state, derivative`` (n,): [mm] and [mm/s].
    """
    n = time_s.size
    state = np.zeros(n)
    derivative = np.zeros(n)
    s = 0.0
    d = 0.0
    for i in range(1, n):
        h = time_s[i] - time_s[i - 1]
        dx = depth_mm[i] - depth_mm[i - 1]
        a, phi = step_weights(h, tau)
        if h > 0.0:
            da = a * h / (tau * tau)
            ratio = h / tau
            # (1 - a)/h - a/tau loses all digits for h << tau; the series takes over
            if ratio < 1e-4:
                dphi = ratio * (0.5 - ratio * (1.0 / 3.0 - ratio / 8.0)) / tau
            else:
                dphi = -math.expm1(-ratio) / h - a / tau
        else:
            da = 0.0
            dphi = 0.0
        d = a * d + da * s + dphi * dx
        s = a * s + phi * dx
        if abs(s) < FLUSH_MM:
            s = 0.0
        if abs(d) < FLUSH_MM:
            d = 0.0
        state[i] = s
        derivative[i] = d
    return state, derivative


# -- the law as one flat block --------------------------------------------------------------------
LAW_SIZE = 176
MOST_BRANCHES = 12
MOST_PIECES = 16
_DEPTH = 0
_BRANCHES = 1
#: Pieces of F_s, cubic each: piece i begins at depth (i / pieces)^2.
_PIECES = 2
#: What the branches follow: 0 the depth, 1 the static force, 2 a polynomial of depth each; 3 of a law without
#: branches whose static force is damped by the speed over that at contact.
_FOLLOWED = 3
_STATIC = 4
_STATIC_SIZE = 4
_STIFFNESS = 68
#: Coefficients of K kept a branch, constant first; a lower degree has zeros.
_STIFFNESS_SIZE = 3
_TAU = 104
#: Polynomials that the branches follow, constant term first (0); of a damped law chi, floor of v0 [mm/s],
#: filter of the speed [s] and hysteresis [mm].
_OWN = 116
OWN_SIZE = 5

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

    Its ``size`` coefficients stand in ``block`` from ``at``, constant term first.  Below 0 the value at 0
    is kept, and the slope there is returned.
    """
    inside = min(max(x, 0.0), depth)
    value = 0.0
    slope = 0.0
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
    """Position deeper than ``target`` at which a free surface ends this step: bracketed Newton.

    The force at ``target`` is negative.  Where a fast branch still pushes while a slow one pulls, or
    where the force falls with depth, the surface may even have to end deeper than it started.
    """
    depth = law[at + _DEPTH]
    low = target
    high = max(state[first + _SURFACE], target)
    width = 1e-3 * depth
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
        if force > 0.0:
            high = y
        else:
            low = y
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
    """Advance the tissue by one step under a tool that can push but not pull.

    Unilateral contact (derived): force >= 0, surface >= tool, and one of the two is an
    equality.  If following the tool would need tension, the surface detaches and recovers along the
    force-free path, found as the root of the force in the surface position of this very step, so that
    the step stays exact for a surface that moves linearly.

    ``law``: holds what :func:`pack_law` wrote, from index ``at``; ``state``: holds :data:`STATE_SIZE` numbers
    from index ``first``: the surface [mm], the branch states, room to work in, and what the branches follow
    there; all zero at rest.  **Updated in place.**; ``x``: tool position at the end of the step [mm];
    negative is in air; ``h``: measured step [s].  Returns force on the tool [N], never negative.
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

    ``static`` (4,): coefficients of F_s by powers of x, constant term first (0) [N/mm^k]; ``stiffness``
    (branches, degree + 1): coefficients of K_j by powers of x [N/mm^(k+1)]; at most :data:`MOST_BRANCHES`,
    degree at most 2; ``tau`` (branches,): relaxation times [s]; ``depth``: largest identified depth [mm]; the
    law is continued beyond it; ``law``: written from index ``at``, :data:`LAW_SIZE` numbers.
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

    ``pieces`` (n, 4): cubic of each piece by powers of the distance from its beginning, at most
    :data:`MOST_PIECES`; ``followed``: what the branches follow: 0 the depth, 1 the static force (their
    stiffness is then a ratio to it), 2 a polynomial each; 3 of a damped law without branches; ``own``
    (branches, OWN_SIZE): these polynomials by powers of x, constant term first (0); of a damped law chi,
    floor of v0 [mm/s], filter of the speed [s] and hysteresis [mm], shape (1, 4); empty otherwise.
    """
    law[at + _PIECES] = len(pieces)
    law[at + _FOLLOWED] = float(followed)
    law[at + _OWN : at + _OWN + own.size] = own.ravel()
    law[at + _STATIC : at + _STATIC + pieces.size] = pieces.ravel()


#: For compiled callers; writing one law from Python is not worth setting numba up for.
_pack_law = kernel(error_model="python")(pack_law)


@kernel(error_model="python")
def tissue_step(
    static: FloatArray,
    stiffness: FloatArray,
    tau: FloatArray,
    depth: float,
    surface: float,
    states: FloatArray,
    x: float,
    h: float,
) -> tuple[float, float]:
    """:func:`tissue_step_in` for a law in its parts.

    ``static``, ``stiffness``, ``tau``, ``depth``: as in :func:`pack_law`; ``surface``: surface position at
    the start of the step [mm]; ``states`` (branches,): branch states [mm]; **updated in place**; ``x``,
    ``h``: as in :func:`tissue_step_in`.  Returns ``force, surface``: force on the tool [N], never negative,
    and the new surface position [mm], never negative.
    """
    law = np.empty(LAW_SIZE)
    _pack_law(static, stiffness, tau, depth, law, 0)
    state = np.zeros(STATE_SIZE)
    state[_SURFACE] = surface
    for j in range(states.size):
        state[_STATES + j] = states[j]
        state[_DRIVERS + j] = surface
    force = tissue_step_in(law, 0, state, 0, x, h)
    for j in range(states.size):
        states[j] = state[_STATES + j]
    return force, state[_SURFACE]


@kernel(error_model="python")
def surface_path(
    static: FloatArray,
    stiffness: FloatArray,
    tau: FloatArray,
    depth: float,
    time_s: FloatArray,
    tool_mm: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Surface of a tissue and force on a tool along a whole path, at rest at the first sample.

    ``static``, ``stiffness``, ``tau``, ``depth``: as in :func:`pack_law`; ``time_s``, ``tool_mm`` (n,):
    non-decreasing times [s] and tool position [mm], negative in air.  Returns ``surface, force`` (n,): [mm],
    never negative and never above the tool; [N], never negative.
    """
    n = time_s.size
    surface = np.empty(n)
    force = np.empty(n)
    law = np.empty(LAW_SIZE)
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
