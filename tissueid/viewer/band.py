"""Expected force of the fitted tissue: its curve and the 95 % band of its draws, at two speeds."""

from __future__ import annotations

from typing import Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.channels import loading_force
from tissueid.rendering.tissue_block import Tissue

#: Depths of a curve.
POINTS = 41
LOW, HIGH = 0.025, 0.975
#: Draws the band is made of: the 2.5 % quantile of 400 has a standard error of 0.8 % of them.
MOST_DRAWS = 400


def band_of(tissue: Tissue, draws: FloatArray | None) -> dict[str, Any]:
    """Force over depth at the slowest and the fastest identified speed.

    ``tissue``: as it is felt; ``draws`` (m, p): posterior draws; without them there are curves alone.
    Returns ``draws`` (their number), ``curves``: ``speed_mm_s``, ``depth_mm``, ``force_N`` and, with draws,
    ``low_N`` and ``high_N``: pointwise 2.5 and 97.5 % quantiles of the force reached from rest at that speed
    (:func:`~tissueid.model.channels.loading_force`).
    """
    depth = np.linspace(0.0, tissue.model.depth_mm, POINTS)
    used = np.zeros((0, tissue.theta.size)) if draws is None else draws[:: max(1, len(draws) // MOST_DRAWS)]
    curves = []
    for speed in sorted(set(tissue.speeds_mm_s)):
        curve = {
            "speed_mm_s": float(speed),
            "depth_mm": depth.tolist(),
            "force_N": loading_force(tissue.model, tissue.theta, depth, speed_mm_s=speed).tolist(),
        }
        if len(used):
            forces = [loading_force(tissue.model, draw, depth, speed_mm_s=speed) for draw in used]
            low, high = np.quantile(forces, [LOW, HIGH], axis=0)
            curve |= {"low_N": low.tolist(), "high_N": high.tolist()}
        curves.append(curve)
    return {"draws": len(used), "curves": curves}
