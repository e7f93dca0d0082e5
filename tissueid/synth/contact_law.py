"""Recordings of a body that resists by Hertz's law with the damping of Flores, drawn from a recipe's program.

::

    F = k d^n (1 + 8 (1 - e) / (5 e) v / v0),    never negative

v0 is the speed at which each contact begins.  Tissue, scatter and filter of the recipe take no part; path,
sampling, contact offset and noise do.  Nothing here is shared with :mod:`tissueid.model.impact`.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.synth.path import Path, crosshead_path
from tissueid.synth.recipe import Log, Recipe
from tissueid.synth.simulate import SyntheticLog, _noise, _plan

#: Half of the step of the path's derivative [s]; its pieces are straight.
STEP_S = 1e-6


def simulate_contact_law(
    recipe: Recipe, *, stiffness: float, exponent: float, restitution: float, rng: np.random.Generator
) -> list[SyntheticLog]:
    """Simulate every log of a recipe, one specimen.

    ``stiffness``: k [N/mm^n]; ``exponent``, ``restitution``: n and e.  Returns their ``truth`` has k, n and e
    beside the program.
    """
    damping = 8.0 * (1.0 - restitution) / (5.0 * restitution)
    logs = []
    for log in recipe.logs:
        for repeat in range(1, log.repeats + 1):
            travel = crosshead_path(log, rounding_s=recipe.crosshead_rounding_s)
            time_s = np.arange(0.0, travel.time_s[-1], 1.0 / recipe.rate_Hz)
            depth = travel.at(time_s) - recipe.contact_offset_mm
            ratio = _speed_ratio(travel, time_s, depth)
            force = stiffness * np.maximum(depth, 0.0) ** exponent * np.maximum(1.0 + damping * ratio, 0.0)
            truth = {"stiffness_N_per_mm_n": stiffness, "exponent": exponent, "restitution": restitution}
            logs.append(_recorded(recipe, log, f"{log.name}-{repeat}", time_s, travel, force, truth, rng))
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


def _recorded(
    recipe: Recipe,
    log: Log,
    name: str,
    time_s: FloatArray,
    travel: Path,
    force: FloatArray,
    truth: dict[str, float],
    rng: np.random.Generator,
) -> SyntheticLog:
    """Recording of the machine."""
    displacement = travel.at(time_s)
    if recipe.sigma_mm > 0.0:
        displacement = displacement + recipe.sigma_mm * rng.standard_normal(time_s.size)
    sign = float(recipe.compression_sign)
    return SyntheticLog(
        name=name,
        specimen=recipe.specimen,
        time_s=time_s,
        displacement_mm=sign * displacement,
        force_N=sign * (force + _noise(recipe, time_s.size, rng)),
        force_clean_N=sign * force,
        truth={**truth, "contact_offset_mm": recipe.contact_offset_mm, **_plan(log)},
    )
