"""Draw the logs of a recipe: travel, force in closed form, rupture, load channel, noise.

Travel of the crosshead is a polyline.  Between two knots the depth changes at constant speed v, and the
extension of a branch that was s_k at the knot is

    s(t) = s_k e^{-(t - t_k)/tau} - v tau expm1(-(t - t_k)/tau),     F = F_s(x) + sum_j K_j(x) s_j.

Where the law would pull (unloading without adhesion) the surface leaves the tool and recovers under F(y) = 0;
that part is integrated on a grid :data:`OVERSAMPLING` times as fine.

Recorded displacement is 0 at t = 0 whatever the contact offset; samples are taken at ``np.arange(0, T,
1/rate)``, T the length of the program.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import accumulate
from math import exp, expm1, log1p, sqrt
from types import MappingProxyType
from typing import TypeVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import refuse
from tissueid.synth.recipe import Branch, Hold, Log, Move, Recipe, Rupture
from tissueid.trial import Protocol, Source, Trial, frozen_array

CHORDS = 200
_Place = TypeVar("_Place", float, FloatArray)


@dataclass(frozen=True, slots=True)
class Path:
    """A polyline: ``value_mm`` over strictly growing ``time_s``, both of shape (k,)."""

    time_s: FloatArray
    value_mm: FloatArray

    def at(self, time_s: FloatArray) -> FloatArray:
        """Value at given times [mm]; constant after the last knot."""
        return np.interp(time_s, self.time_s, self.value_mm)


def crosshead_path(log: Log, *, rounding_s: float = 0.0) -> Path:
    """Travel of the crosshead through a log's program."""
    times, values = [0.0], [0.0]
    for move in log.moves:
        if isinstance(move, Move):
            duration, target = abs(move.to_mm - values[-1]) / move.speed_mm_s, move.to_mm
        else:
            duration, target = move.hold_s, values[-1]
        if duration > 0.0:
            times.append(times[-1] + duration)
            values.append(target)
    knots = Path(np.array(times), np.array(values))
    return _round_stops(knots, rounding_s) if rounding_s > 0.0 else knots


def _round_stops(path: Path, rounding_s: float) -> Path:
    """Replace each corner at which a move ends in a standstill by a raised-cosine slow-down."""
    speed = np.diff(path.value_mm) / np.diff(path.time_s)
    times: list[FloatArray] = [path.time_s[:1]]
    values: list[FloatArray] = [path.value_mm[:1]]
    for k in range(1, path.time_s.size):
        corner, travel = path.time_s[k], path.value_mm[k]
        stops = k < speed.size and speed[k] == 0.0 and speed[k - 1] != 0.0
        if not stops:
            times.append(path.time_s[k : k + 1])
            values.append(path.value_mm[k : k + 1])
            continue
        room = 2.0 * min(corner - path.time_s[k - 1], path.time_s[k + 1] - corner)
        width = min(rounding_s, 0.999 * room)
        u = np.linspace(0.0, 1.0, CHORDS + 1)
        times.append(corner + (u - 0.5) * width)
        values.append(travel - 0.5 * speed[k - 1] * width * (1.0 - u - np.sin(np.pi * u) / np.pi))
    return Path(np.concatenate(times), np.concatenate(values))


def contact_path(travel: Path, offset_mm: float) -> Path:
    """Depth max(0, travel - offset) of a tool that meets the tissue at ``offset_mm`` of travel.

    A negative offset is a start that is indented already.  Knots are added where the tool crosses the
    surface, so that the result is the exact polyline.
    """
    depth = travel.value_mm - offset_mm
    crosses = np.flatnonzero(depth[:-1] * depth[1:] < 0.0)
    share = depth[crosses] / (depth[crosses] - depth[crosses + 1])
    times = travel.time_s[crosses] + share * (travel.time_s[crosses + 1] - travel.time_s[crosses])
    time_s = np.insert(travel.time_s, crosses + 1, times)
    depth = np.insert(depth, crosses + 1, 0.0)
    return Path(time_s, np.maximum(depth, 0.0))


OVERSAMPLING = 16


def static_force(static: tuple[float, ...], depth_mm: FloatArray) -> FloatArray:
    """F_s = a1 x + a2 x^2 + ... [N] at depths of any shape [mm]."""
    return _at((0.0, *static), depth_mm)


def branch_extension(depth: Path, tau_s: float, time_s: FloatArray) -> FloatArray:
    """Extension of the spring of a branch, relaxed at t = 0."""
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


@dataclass(frozen=True, slots=True)
class Body:
    """Relaxed tissue that a tool meets at ``offset_mm`` of travel; a negative one starts indented."""

    static: tuple[float, ...]  # a1, a2, ... of the static force [N/mm, N/mm2, ...]
    branches: tuple[Branch, ...]
    offset_mm: float = 0.0


def tissue_force(travel: Path, time_s: FloatArray, body: Body) -> FloatArray:
    """Force [N] on a tool along its travel."""
    depth = contact_path(travel, body.offset_mm)
    x = depth.at(time_s)
    force = static_force(body.static, x)
    for branch in body.branches:
        force += _at(branch.stiffness, x) * branch_extension(depth, branch.tau_s, time_s)
    # rounding error of a sum of terms of the size of the largest force
    if force.size and force.min() < -1e-9 * np.abs(force).max():
        return _with_contact_loss(travel, time_s, body)
    return np.maximum(force, 0.0)


def _with_contact_loss(travel: Path, time_s: FloatArray, body: Body) -> FloatArray:
    """The same where the tool leaves the surface: step the surface y and the branches on a fine grid.

    In contact y follows the tool.  Free, F(y, s) = 0 is kept: with s_j' = y' - s_j/tau_j,
    y' = (sum K_j s_j/tau_j) / (F_s' + sum (K_j' s_j + K_j)).
    """
    fine = np.union1d(oversampled(time_s), travel.time_s[travel.time_s < time_s[-1]])
    tool = (travel.at(fine) - body.offset_mm).tolist()
    steps = np.diff(fine, prepend=fine[0]).tolist()
    curve = (0.0, *body.static)
    tangent = tuple(power * a for power, a in enumerate(curve))[1:]
    laws = [
        (b.stiffness, tuple(i * k for i, k in enumerate(b.stiffness))[1:], b.tau_s) for b in body.branches
    ]
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


def _at(coefficients: tuple[float, ...], x: _Place) -> _Place:
    """Polynomial at one point or many, lowest power first."""
    total = 0.0 * x
    for coefficient in reversed(coefficients):
        total = total * x + coefficient
    return total


def oversampled(time_s: FloatArray) -> FloatArray:
    """Times with ``OVERSAMPLING - 1`` more between each two; the given ones are kept exactly."""
    share = np.arange(OVERSAMPLING) / OVERSAMPLING
    between = time_s[:-1, None] + np.diff(time_s)[:, None] * share
    return np.append(between.ravel(), time_s[-1])


def low_pass(time_s: FloatArray, force_N: FloatArray, filter_s: float) -> FloatArray:
    """First-order low-pass, exact for a force that is linear between samples, at rest at the start."""
    step = (time_s[-1] - time_s[0]) / (time_s.size - 1)
    keep = exp(-step / filter_s)
    gain = -expm1(-step / filter_s) * filter_s / step
    rises = np.diff(force_N).tolist()
    lag: FloatArray = np.array(
        list(accumulate(rises, lambda behind, rise: keep * behind - gain * rise, initial=0.0))
    )
    return force_N + lag


#: Times at which the measure is looked at; the depth of rupture is then good to 1e-7 of the travel.
GRID = 20_001


#: Entries of ``truth`` of the rupture; of the end of the program where there is none.
RUPTURE = ("rupture_time_s", "rupture_depth_mm", "rupture_force_N", "rupture_work_N_mm")


def rupture_of(rupture: Rupture, travel: Path, body: Body) -> dict[str, float]:
    """Find where a test breaks the tissue, as entries of ``truth``; the threshold is that of this test."""
    depth = contact_path(travel, body.offset_mm)
    time_s = np.union1d(np.linspace(0.0, travel.time_s[-1], GRID), depth.time_s)
    x = depth.at(time_s)
    elastic = static_force(body.static, x)
    extensions = [branch_extension(depth, branch.tau_s, time_s) for branch in body.branches]
    pairs = list(zip(body.branches, extensions, strict=True))
    dynamic = sum((_at(branch.stiffness, x) * s for branch, s in pairs), 0.0 * x)
    force = np.maximum(elastic + dynamic, 0.0)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(x))])
    stored = static_force(tuple(a / (k + 2) for k, a in enumerate(body.static)), x) * x
    measure = {
        "work": work,
        "weighted-force": elastic + rupture.weight * dynamic,
        "stored-energy": sum((_spring(branch.stiffness, x, s) for branch, s in pairs), stored),
        "depth": x,
    }[rupture.criterion]
    reached = measure >= rupture.threshold
    k = max(int(np.argmax(reached)), 1) if reached.any() else measure.size - 1
    share = (rupture.threshold - measure[k - 1]) / (measure[k] - measure[k - 1]) if reached.any() else 1.0
    at = [float(one[k - 1] + share * (one[k] - one[k - 1])) for one in (time_s, x, force, work)]
    found = {"ruptured": float(reached.any()), **dict(zip(RUPTURE, at, strict=True))}
    return found | {"threshold": rupture.threshold}


def _spring(stiffness: tuple[float, ...], x: FloatArray, extension: FloatArray) -> FloatArray:
    """Energy int_{x_d}^{x} K(y) (y - x_d) dy of a spring whose damper stands at x_d = x - s [N mm]."""
    damper = x - extension
    energy = np.zeros_like(x)
    for power, k in enumerate(stiffness):
        upper, lower = power + 2, power + 1
        energy += k * ((x**upper - damper**upper) / upper - damper * (x**lower - damper**lower) / lower)
    return energy


@dataclass(frozen=True, slots=True)
class SyntheticLog:
    """One simulated recording, with what is true of it."""

    name: str  # ``<log>-<repeat>``, with the specimen before it where there are several
    specimen: str
    #: (n,): as recorded (signed, with noise, not rounded), read-only.
    time_s: FloatArray
    displacement_mm: FloatArray  # (n,)
    force_N: FloatArray  # (n,)
    force_clean_N: FloatArray  # (n,), force without noise, after the load channel's filter
    #: ``gain`` (of the static force), ``gain_stiffness`` (of the branches), ``contact_offset_mm``,
    #: ``speed_mm_s`` and ``depth_mm`` of the first move, ``hold_s`` of the first hold (0 without); of tissue
    #: that can break ``ruptured``, :data:`RUPTURE` and ``threshold`` as well.
    truth: Mapping[str, float]

    def __post_init__(self) -> None:
        for name in ("time_s", "displacement_mm", "force_N", "force_clean_N"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        object.__setattr__(self, "truth", MappingProxyType(dict(self.truth)))


def simulate(recipe: Recipe, *, rng: np.random.Generator) -> list[SyntheticLog]:
    """Simulate every log of a recipe."""
    logs = []
    for specimen in range(1, recipe.specimens + 1):
        label = recipe.specimen if recipe.specimens == 1 else f"{recipe.specimen}-{specimen:02d}"
        gain = _gain(recipe.cv_specimen, rng)
        tough = 1.0 if recipe.rupture is None else _gain(recipe.rupture.cv_specimen, rng)
        for repeat in range(1, max(log.repeats for log in recipe.logs) + 1):
            for log in recipe.logs:
                if repeat <= log.repeats:
                    name = f"{log.name}-{repeat}" if recipe.specimens == 1 else f"{label}-{log.name}-{repeat}"
                    logs.append(_one_log(recipe, log, name, label, gain=gain, tough=tough, rng=rng))
    return logs


def _gain(cv: float, rng: np.random.Generator) -> float:
    """A log-normal gain of median 1; draws nothing where there is no scatter."""
    return float(np.exp(sqrt(log1p(cv * cv)) * rng.standard_normal())) if cv > 0.0 else 1.0


def _one_log(
    recipe: Recipe, log: Log, name: str, specimen: str, *, gain: float, tough: float, rng: np.random.Generator
) -> SyntheticLog:
    both = gain * _gain(recipe.cv_both, rng)
    truth = {
        "gain": both * _gain(recipe.cv_static, rng),
        "gain_stiffness": both,
        "contact_offset_mm": recipe.contact_offset_mm,
        "speed_mm_s": next((move.speed_mm_s for move in log.moves if isinstance(move, Move)), 0.0),
        "depth_mm": next((move.to_mm for move in log.moves if isinstance(move, Move)), 0.0),
        "hold_s": next((move.hold_s for move in log.moves if isinstance(move, Hold)), 0.0),
    }
    if recipe.contact_offset_sd_mm > 0.0:
        truth["contact_offset_mm"] += recipe.contact_offset_sd_mm * float(rng.standard_normal())
    travel = crosshead_path(log, rounding_s=recipe.crosshead_rounding_s)
    time_s = np.arange(0.0, travel.time_s[-1], 1.0 / recipe.rate_Hz)
    if time_s.size < 2:
        refuse(
            f"log {log.name!r} lasts {travel.time_s[-1]:g} s, less than two samples at "
            f"{recipe.rate_Hz:g} Hz: raise rate_Hz, or let it last longer"
        )
    rupture = recipe.rupture
    if rupture is not None:
        rupture = replace(rupture, threshold=rupture.threshold * tough * _gain(rupture.cv, rng))
    clean = _clean_force(replace(recipe, rupture=rupture), travel, time_s, truth)
    displacement = travel.at(time_s)
    if recipe.sigma_mm > 0.0:
        displacement = displacement + recipe.sigma_mm * rng.standard_normal(time_s.size)
    sign = float(recipe.compression_sign)
    force_N = sign * (clean + _noise(recipe, time_s.size, rng))
    return SyntheticLog(name, specimen, time_s, sign * displacement, force_N, sign * clean, truth)


def _clean_force(recipe: Recipe, travel: Path, time_s: FloatArray, truth: dict[str, float]) -> FloatArray:
    """Tissue force behind the load channel's filter, without noise; adds to ``truth`` where it broke."""
    branches = tuple(
        replace(branch, stiffness=tuple(truth["gain_stiffness"] * k for k in branch.stiffness))
        for branch in recipe.branches
    )
    body = Body(tuple(truth["gain"] * a for a in recipe.static), branches, truth["contact_offset_mm"])
    rupture, filtered = recipe.rupture, recipe.force_filter_s > 0.0
    times = oversampled(time_s) if filtered else time_s
    force = tissue_force(travel, times, body)
    if rupture is not None:
        truth |= rupture_of(rupture, travel, body)
        if truth["ruptured"]:
            force = np.where(times > truth["rupture_time_s"], rupture.residual * force, force)
    if not filtered:
        return force
    return low_pass(times, force, recipe.force_filter_s)[:: (times.size - 1) // (time_s.size - 1)]


def _noise(recipe: Recipe, size: int, rng: np.random.Generator) -> FloatArray:
    """White noise plus stationary first-order autoregressive noise [N]."""
    noise = recipe.sigma_N * rng.standard_normal(size)
    if recipe.ar1_sigma_N > 0.0:
        draws = recipe.ar1_sigma_N * rng.standard_normal(size)
        draws[1:] *= sqrt(1.0 - recipe.ar1_phi**2)
        phi = recipe.ar1_phi
        noise += np.array(list(accumulate(draws.tolist(), lambda last, draw: phi * last + draw)))
    return noise


def as_trials(logs: list[SyntheticLog], *, specimen: str | None = None) -> list[Trial]:
    """The logs as trials in memory, nothing rounded."""
    trials = []
    for log in logs:
        hold_s = log.truth["hold_s"]
        protocol = Protocol(
            kind="crelax" if hold_s > 0.0 else "comp",
            speed_mm_s=log.truth["speed_mm_s"],
            depth_mm=log.truth["depth_mm"],
            hold_s=hold_s or None,
        )
        source = Source(path=f"{log.name}.csv", recipe="synthetic")
        label = log.specimen if specimen is None else specimen
        trials.append(Trial(label, log.time_s, log.displacement_mm, log.force_N, protocol, source))
    return trials
