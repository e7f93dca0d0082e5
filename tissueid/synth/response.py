"""Force of the modified Kelvin-Voigt tissue along a polyline of depth, in closed form.

Between two knots the depth changes at constant speed v, and the branch extension that was s_k at the knot is

    s(t) = s_k e^{-(t - t_k)/tau} - v tau expm1(-(t - t_k)/tau),     F = F_s(x) + sum_j K_j(x) s_j.

For one move this is the constant-velocity ramp, for a standstill the exponential decay; corners may lie
between samples.  Where the law would pull (unloading without adhesion) the surface leaves the tool and
recovers under F(y) = 0; that part is integrated on a grid :data:`OVERSAMPLING` times as fine.
"""

from __future__ import annotations

from itertools import accumulate
from math import exp, expm1

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.synth.path import Path, contact_path
from tissueid.synth.recipe import Branch

OVERSAMPLING = 16


def static_force(static: tuple[float, ...], depth_mm: FloatArray) -> FloatArray:
    """F_s = a1 x + a2 x^2 + ... [N] at depths of any shape [mm]."""
    total = np.zeros_like(depth_mm)
    for coefficient in reversed(static):
        total = (total + coefficient) * depth_mm
    return total


def _stiffness(coefficients: tuple[float, ...], depth_mm: FloatArray) -> FloatArray:
    total = np.zeros_like(depth_mm)
    for coefficient in reversed(coefficients):
        total = total * depth_mm + coefficient
    return total


def branch_extension(depth: Path, tau_s: float, time_s: FloatArray) -> FloatArray:
    """Extension of the spring of a branch, relaxed at t = 0.

    ``depth``: polyline of depth; ``time_s`` (n,): times at which it is wanted, from 0 on [s].  Returns (n,),
    s [mm].
    """
    duration = np.diff(depth.time_s)
    speed = np.diff(depth.value_mm) / duration
    moves = zip(duration.tolist(), speed.tolist(), strict=True)
    at_knots = accumulate(
        moves, lambda s, m: s * exp(-m[0] / tau_s) - m[1] * tau_s * expm1(-m[0] / tau_s), initial=0.0
    )
    at_knot = np.array(list(at_knots))
    segment = np.clip(np.searchsorted(depth.time_s, time_s, side="right") - 1, 0, duration.size)
    speed = np.append(speed, 0.0)
    elapsed = (time_s - depth.time_s[segment]) / tau_s
    return at_knot[segment] * np.exp(-elapsed) - speed[segment] * tau_s * np.expm1(-elapsed)


def tissue_force(
    travel: Path,
    time_s: FloatArray,
    *,
    offset_mm: float,
    static: tuple[float, ...],
    branches: tuple[Branch, ...],
) -> FloatArray:
    """Force on a tool that meets relaxed tissue at ``offset_mm`` of travel.

    ``travel``: crosshead travel; ``time_s`` (n,); ``offset_mm``: travel of first contact; negative where the
    tissue is indented, and relaxed, at t = 0; ``static``, ``branches``: the law; gains are already in it.
    Returns (n,), force >= 0 [N].
    """
    depth = contact_path(travel, offset_mm)
    x = depth.at(time_s)
    force = static_force(static, x)
    for branch in branches:
        force += _stiffness(branch.stiffness, x) * branch_extension(depth, branch.tau_s, time_s)
    # rounding error of a sum of terms of the size of the largest force
    if force.size and force.min() < -1e-9 * np.abs(force).max():
        return _with_contact_loss(travel, time_s, offset_mm, static, branches)
    return np.maximum(force, 0.0)


def _with_contact_loss(
    travel: Path,
    time_s: FloatArray,
    offset_mm: float,
    static: tuple[float, ...],
    branches: tuple[Branch, ...],
) -> FloatArray:
    """The same where the tool leaves the surface: step the surface y and the branches on a fine grid.

    In contact y follows the tool.  Free, F(y, s) = 0 is kept: with s_j' = y' - s_j/tau_j,
    y' = (sum K_j s_j/tau_j) / (F_s' + sum (K_j' s_j + K_j)).
    """
    fine = np.union1d(oversampled(time_s), travel.time_s[travel.time_s < time_s[-1]])
    tool = (travel.at(fine) - offset_mm).tolist()
    steps = np.diff(fine, prepend=fine[0]).tolist()
    curve = (0.0, *static)
    tangent = tuple(power * a for power, a in enumerate(curve))[1:]
    laws = [(b.stiffness, tuple(i * k for i, k in enumerate(b.stiffness))[1:], b.tau_s) for b in branches]
    surface, touches, s = max(tool[0], 0.0), tool[0] >= 0.0, [0.0] * len(laws)
    last = _at(curve, surface)
    force = [last if touches else 0.0]

    def follow(step: float, target: float) -> tuple[list[float], float]:
        """Extensions and force after the surface has moved to a target."""
        moved, total, after = target - surface, _at(curve, target), []
        for (k, _, tau), extension in zip(laws, s, strict=True):
            after.append(extension * exp(-step / tau) - expm1(-step / tau) * tau / step * moved)
            total += _at(k, target) * after[-1]
        return after, total

    for step, position in zip(steps[1:], tool[1:], strict=True):
        # what is left of F at the last step goes as well (one Newton step), so that F = 0 does not drift
        pull, resist = -last / step, _at(tangent, surface)
        for (k, slope, tau), extension in zip(laws, s, strict=True):
            pull += _at(k, surface) * extension / tau
            resist += _at(slope, surface) * extension + _at(k, surface)
        free = surface + step * pull / resist
        touches = follow(step, position)[1] >= 0.0 if touches else free <= position
        target = position if touches else free
        s, last = follow(step, target)
        surface = target
        force.append(max(last, 0.0) if touches else 0.0)
    force_at: FloatArray = np.array(force)
    return force_at[np.searchsorted(fine, time_s)]


def _at(coefficients: tuple[float, ...], x: float) -> float:
    """Polynomial at one point, lowest power first."""
    total = 0.0
    for coefficient in reversed(coefficients):
        total = total * x + coefficient
    return total


def oversampled(time_s: FloatArray) -> FloatArray:
    """Times with ``OVERSAMPLING - 1`` more between each two; the given ones are kept exactly."""
    share = np.arange(OVERSAMPLING) / OVERSAMPLING
    between = time_s[:-1, None] + np.diff(time_s)[:, None] * share
    return np.append(between.ravel(), time_s[-1])


def low_pass(time_s: FloatArray, force_N: FloatArray, filter_s: float) -> FloatArray:
    """First-order low-pass, exact for a force that is linear between samples, at rest at the start.

    ``time_s``, ``force_N`` (n,): equally spaced times; ``filter_s``: time constant [s].
    """
    step = (time_s[-1] - time_s[0]) / (time_s.size - 1)
    keep = exp(-step / filter_s)
    gain = -expm1(-step / filter_s) * filter_s / step
    rises = np.diff(force_N).tolist()
    lag: FloatArray = np.array(
        list(accumulate(rises, lambda behind, rise: keep * behind - gain * rise, initial=0.0))
    )
    return force_N + lag
