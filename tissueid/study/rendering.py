"""Rendering of a specimen's tissue: scales, stability, and what lies outside its validity.

The same check that ``tissueid render`` makes before any force, on the presets of the devices that are known;
nothing is opened and nothing moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tissueid.errors import TissueidError
from tissueid.haptics.registry import reported_devices
from tissueid.rendering.precheck import Demands, Precheck, check_before_force, demands_of
from tissueid.rendering.tissue_block import WORKSPACE_CENTRE_M
from tissueid.rendering.tissue_block import Tissue as RenderedTissue
from tissueid.report.tissue import tissue_of
from tissueid.store.posteriors import StoredPosterior

#: A hand that explores moves a grip at some 0.1 m/s.
EXPLORING_MM_S = 100.0
MM_PER_M = 1000.0


def _devices() -> dict[str, Demands]:
    """Demands of the devices that a report speaks of, behind a surface in the middle of each."""
    return {
        words: replace(demands_of(able), travel_m=WORKSPACE_CENTRE_M[2] - able.workspace_m[2][0])
        for words, able in reported_devices().items()
    }


def _row(check: Precheck, speeds_mm_s: tuple[float, float]) -> dict[str, Any]:
    room_mm = MM_PER_M * check.demands.travel_m
    inside_mm = check.depth_mm * check.scaling.motion
    fastest_mm_s = speeds_mm_s[1] * check.scaling.motion
    return {
        "refused": None,
        **check.as_json(),
        "travel_mm": inside_mm,
        "room_mm": room_mm,
        "outside_share": max(1.0 - inside_mm / room_mm, 0.0),
        "fastest_hand_mm_s": fastest_mm_s,
        "faster_than_identified": fastest_mm_s < EXPLORING_MM_S,
    }


def rendering_of(specimen: Mapping[str, Any], stored: StoredPosterior | None) -> dict[str, Any] | None:
    """Words of the report on rendering one specimen; ``None`` where its model is not all there.

    ``specimen``: one of ``specimens`` of identification.json.  Returns ``normalised`` (then nothing else),
    ``passive``, ``draws`` and ``draws_passive``, ``unique``, and ``devices`` with the numbers of each check,
    or why it is ``refused``.
    """
    if (specimen["units"]["length"], specimen["units"]["force"]) != ("mm", "N"):
        return {"normalised": True}
    tissue = tissue_of(specimen, stored)
    if tissue is None:
        return None
    model, theta = tissue.model, tissue.theta
    slow, fast = (float(value) for value in specimen["validity"]["speeds_mm_s"])
    rendered = RenderedTissue(
        model=model,
        theta=theta,
        speeds_mm_s=(slow, fast),
        tip_radius_mm=specimen["validity"]["tip_radius_mm"],
    )
    rows = []
    for name, demands in _devices().items():
        try:
            row = _row(check_before_force(rendered, demands), (slow, fast))
        except (TissueidError, ValueError) as error:
            row = {"refused": str(error)}
        rows.append({"device": name, **row})
    draws = np.zeros((0, theta.size)) if stored is None else _as_rendered(stored, model.parameter_names)
    return {
        "normalised": False,
        "passive": model.is_passive(theta),
        "draws": len(draws),
        "draws_passive": sum(model.is_passive(one) for one in draws),
        "unique": model.contact_loss_is_unique(theta),
        "devices": rows,
    }


def _as_rendered(stored: StoredPosterior, names: tuple[str, ...]) -> Any:
    """Some of the draws that a bundle carries, in the order of the model."""
    some = stored.draws
    kept = np.linspace(0, len(some) - 1, min(len(some), 500)).astype(int)
    return some[kept][:, [stored.theta_names.index(name) for name in names]]
