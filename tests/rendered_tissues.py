"""Tissues, bundles and a stepping hand for the tests of rendering."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from fit_factory import identification, specimen_fit

from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.rendering import environment as env
from tissueid.rendering.tissue_block import Tissue
from tissueid.store.bundle import Bundle, bundle_from_fit, write_bundle

DEPTH_MM = 8.0
SPEEDS_MM_S = (10.0 / 60.0, 500.0 / 60.0)
_ONE, _TWO = (kelvin_voigt(branches=k, stiffness_degree=2 * k - 2, depth_mm=DEPTH_MM) for k in (1, 2))
_THETA = np.array([47.42, -5.577, 0.3804, 63.62, 0.021])
PAPER_A = Tissue(_ONE, _THETA, SPEEDS_MM_S, tip_radius_mm=2.0, name="paper-a")
_STATIC, _STIFFNESS = np.array([12.0, -1.5, 0.35]), np.array([[20.0, 3.0, 0.4], [9.0, -0.8, 0.05]])
_THETA = _TWO.join(_STATIC, _STIFFNESS, np.array([0.021, 0.4]))
TWO_BRANCHES = Tissue(_TWO, _THETA, SPEEDS_MM_S, tip_radius_mm=2.0, name="two branches")


def walk(block: np.ndarray, positions_m: np.ndarray, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces and infos of the environment along a path, first sample at rest."""
    memory = np.zeros(env.MEMORY_SIZE)
    force, velocity = np.zeros(3), np.zeros(3)
    info = np.zeros(env.INFO_SIZE)
    forces, infos = np.zeros((len(times_s), 3)), np.zeros((len(times_s), env.INFO_SIZE))
    for i in range(len(times_s)):
        dt = times_s[i] - times_s[i - 1] if i else 0.001
        if i:
            velocity = (positions_m[i] - positions_m[i - 1]) / dt
        env.environment_step(block, memory, positions_m[i].copy(), velocity, dt, force, info)
        forces[i], infos[i] = force, info
    return forces, infos


def pressed(depth_mm: np.ndarray, *, motion: float, top_m: float = 0.130) -> np.ndarray:
    """Positions above and in a plane at ``top_m``, for depths in tissue units."""
    positions = np.zeros((len(depth_mm), 3))
    positions[:, 2] = top_m - depth_mm * motion * 1e-3
    return positions


def bundle_of(tissue: Tissue, *, draws: np.ndarray | None = None, **changes: Any) -> Bundle:
    base = bundle_from_fit(specimen_fit(), provenance=identification([specimen_fit()]).provenance)
    model = tissue.model
    held = replace(
        base,
        specimen=tissue.name,
        model=replace(base.model, branches=model.branches, stiffness_degree=model.stiffness_degree),
        theta_names=tuple(model.parameter_names),
        theta=tissue.theta,
        covariance=np.diag((0.01 * tissue.theta) ** 2),
        depth_mm=model.depth_mm,
        speeds_mm_s=tissue.speeds_mm_s,
        tip_radius_mm=tissue.tip_radius_mm,
        draws=draws,
    )
    return replace(held, **changes)


def write_bundles(folder: Path, ending: str = "") -> None:
    """``a.h5`` and ``b.h5``: paper A's tissue under two names, with draws of 1 %."""
    chance = np.random.default_rng(5)
    for name in ("a", "b"):
        draws = PAPER_A.theta * np.exp(0.01 * chance.standard_normal((200, PAPER_A.theta.size)))
        write_bundle(bundle_of(replace(PAPER_A, name=name + ending), draws=draws), folder / f"{name}.h5")
