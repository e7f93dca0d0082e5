"""Draw the logs of a recipe: scatter, tissue (or a body of Hertz's law), load channel, noise.

Recorded displacement is 0 at t = 0 whatever the contact offset; samples are taken at ``np.arange(0, T,
1/rate)``, T the length of the program.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import accumulate
from math import log1p, sqrt
from types import MappingProxyType

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.synth.recipe import Hold, Log, Move, Recipe
from tissueid.synth.response import (
    Path,
    after_rupture,
    crosshead_path,
    low_pass,
    oversampled,
    rupture_of,
    tissue_force,
)
from tissueid.trial import Protocol, Source, Trial, frozen_array


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
    #: that can break :meth:`tissueid.synth.response.Broken.as_truth` as well.
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
        **_plan(log),
    }
    if recipe.contact_offset_sd_mm > 0.0:
        truth["contact_offset_mm"] += recipe.contact_offset_sd_mm * float(rng.standard_normal())
    travel = crosshead_path(log, rounding_s=recipe.crosshead_rounding_s)
    time_s = np.arange(0.0, travel.time_s[-1], 1.0 / recipe.rate_Hz)
    threshold = (
        0.0 if recipe.rupture is None else recipe.rupture.threshold * tough * _gain(recipe.rupture.cv, rng)
    )
    clean = _clean_force(recipe, travel, time_s, truth, threshold)
    return _recorded(recipe, name, specimen, travel, time_s, clean, truth, rng)


def _recorded(
    recipe: Recipe, name: str, specimen: str, travel: Path, time_s: FloatArray, clean: FloatArray,
    truth: Mapping[str, float], rng: np.random.Generator,
) -> SyntheticLog:  # fmt: skip
    """A log as the machine records it: noise on both channels, and the recipe's sign."""
    displacement = travel.at(time_s)
    if recipe.sigma_mm > 0.0:
        displacement = displacement + recipe.sigma_mm * rng.standard_normal(time_s.size)
    sign = float(recipe.compression_sign)
    force_N = sign * (clean + _noise(recipe, time_s.size, rng))
    return SyntheticLog(name, specimen, time_s, sign * displacement, force_N, sign * clean, truth)


def _plan(log: Log) -> dict[str, float]:
    """Speed and depth of the first move and length of the first hold, 0 where there is none."""
    moves = [move for move in log.moves if isinstance(move, Move)]
    holds = [hold for hold in log.moves if isinstance(hold, Hold)]
    return {
        "speed_mm_s": moves[0].speed_mm_s if moves else 0.0,
        "depth_mm": moves[0].to_mm if moves else 0.0,
        "hold_s": holds[0].hold_s if holds else 0.0,
    }


def _clean_force(
    recipe: Recipe, travel: Path, time_s: FloatArray, truth: dict[str, float], threshold: float
) -> FloatArray:
    """Tissue force behind the load channel's filter, without noise; adds to ``truth`` where it broke."""
    static = tuple(truth["gain"] * a for a in recipe.static)
    branches = tuple(
        replace(branch, stiffness=tuple(truth["gain_stiffness"] * k for k in branch.stiffness))
        for branch in recipe.branches
    )
    offset_mm, rupture = truth["contact_offset_mm"], recipe.rupture
    filtered = recipe.force_filter_s > 0.0
    times = oversampled(time_s) if filtered else time_s
    force = tissue_force(travel, times, offset_mm=offset_mm, static=static, branches=branches)
    if rupture is not None:
        broken = rupture_of(rupture, threshold, travel, offset_mm=offset_mm, static=static, branches=branches)
        truth |= broken.as_truth()
        force = after_rupture(broken, rupture.residual, times, force)
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


#: Half of the step of the path's derivative [s]; its pieces are straight.
STEP_S = 1e-6


def simulate_contact_law(
    recipe: Recipe, *, stiffness: float, exponent: float, restitution: float, rng: np.random.Generator
) -> list[SyntheticLog]:
    """Simulate every log of a recipe, one specimen."""
    damping = 8.0 * (1.0 - restitution) / (5.0 * restitution)
    law = {"stiffness_N_per_mm_n": stiffness, "exponent": exponent, "restitution": restitution}
    logs = []
    for log in recipe.logs:
        for repeat in range(1, log.repeats + 1):
            travel = crosshead_path(log, rounding_s=recipe.crosshead_rounding_s)
            time_s = np.arange(0.0, travel.time_s[-1], 1.0 / recipe.rate_Hz)
            depth = travel.at(time_s) - recipe.contact_offset_mm
            ratio = _speed_ratio(travel, time_s, depth)
            force = stiffness * np.maximum(depth, 0.0) ** exponent * np.maximum(1.0 + damping * ratio, 0.0)
            truth = {**law, "contact_offset_mm": recipe.contact_offset_mm, **_plan(log)}
            name = f"{log.name}-{repeat}"
            logs.append(_recorded(recipe, name, recipe.specimen, travel, time_s, force, truth, rng))
    return logs


def _speed_ratio(travel: Path, time_s: FloatArray, depth: FloatArray) -> FloatArray:
    """Speed over that at the start of each contact, within +-1."""
    end = float(travel.time_s[-1])
    before, after = np.maximum(time_s - STEP_S, 0.0), np.minimum(time_s + STEP_S, end)
    speed = (travel.at(after) - travel.at(before)) / (after - before)
    ratio = np.zeros(time_s.size)
    begun = 0.0
    for i in range(time_s.size):
        if depth[i] <= 0.0:
            begun = 0.0
        elif begun == 0.0:
            begun = speed[i]
        ratio[i] = speed[i] / begun if begun > 0.0 else 0.0
    return np.clip(ratio, -1.0, 1.0)
