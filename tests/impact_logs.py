"""Synthetic logs of a body of Hertz's law with an exponent, which gives back less speed than it takes."""

from dataclasses import replace

import numpy as np

from tissueid.synth.recipe import Recipe
from tissueid.synth.simulate import SyntheticLog, crosshead_path, simulate

#: Half of the step of the path's derivative [s]; its pieces are straight.
STEP_S = 1e-6


def impact_logs(
    plan: Recipe, *, stiffness: float, exponent: float, restitution: float, rng: np.random.Generator
) -> list[SyntheticLog]:
    """Every log of the program of a recipe, with its noise."""
    damping = 8.0 * (1.0 - restitution) / (5.0 * restitution)
    programs = {log.name: log for log in plan.logs}
    found = []
    for empty in simulate(replace(plan, static=(0.0,), branches=()), rng=rng):
        program = programs[empty.name.rpartition("-")[0]]
        travel = crosshead_path(program, rounding_s=plan.crosshead_rounding_s)
        depth = travel.at(empty.time_s) - plan.contact_offset_mm
        before = np.maximum(empty.time_s - STEP_S, 0.0)
        after = np.minimum(empty.time_s + STEP_S, travel.time_s[-1])
        ratio = speed_ratio((travel.at(after) - travel.at(before)) / (after - before), depth)
        force = stiffness * np.maximum(depth, 0.0) ** exponent * np.maximum(1.0 + damping * ratio, 0.0)
        found.append(replace(empty, force_N=empty.force_N + plan.compression_sign * force))
    return found


def speed_ratio(speed: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Speed over that at the start of each contact, within +-1."""
    ratio, begun = np.zeros(depth.size), 0.0
    for i in range(depth.size):
        if depth[i] <= 0.0:
            begun = 0.0
        elif begun == 0.0:
            begun = speed[i]
        ratio[i] = speed[i] / begun if begun > 0.0 else 0.0
    return np.clip(ratio, -1.0, 1.0)
