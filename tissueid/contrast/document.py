"""All pairs of tissues, as one document."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from itertools import combinations
from typing import Any

import numpy as np

from tissueid import __version__
from tissueid.contrast.curves import force_curves
from tissueid.contrast.decision import LEVEL, difference, rows
from tissueid.contrast.noticeable import noticed
from tissueid.contrast.numbers import Compared, common_range, draws_of_numbers
from tissueid.model.scaling import scaling_for


def contrast_document(
    tissues: Sequence[Compared],
    *,
    clamp_N: float,
    progress: Callable[[str, int, int], None] = lambda _message, _done, _total: None,
) -> dict[str, Any]:
    """Compare tissues pair by pair over what all of them have in common.

    ``tissues``: two or more; ``clamp_N``: force clamp of the device [N]; the stiffest tissue sets the scale
    of all; ``progress``: ``progress(message, done, total)``, a tissue at a time.  Returns the document of
    ``schemas/contrast.schema.json``.
    """
    common = common_range(tissues)
    draws = []
    for done, tissue in enumerate(tissues):
        progress(tissue.name, done, len(tissues))
        draws.append(draws_of_numbers(tissue, common))
    progress("comparing", len(tissues), len(tissues))
    scales = [
        scaling_for(
            tissue.model,
            np.median(tissue.draws, axis=0),
            clamp_N=clamp_N,
            fastest_mm_s=tissue.speeds_mm_s[1],
        ).force
        for tissue in tissues
    ]
    scale = min(scales)
    pairs = []
    for i, j in combinations(range(len(tissues)), 2):
        pairs.append(
            {
                "one": tissues[i].name,
                "other": tissues[j].name,
                "difference": asdict(difference(draws[i], draws[j])),
                "numbers": [asdict(row) for row in rows(draws[i], draws[j])],
                "noticed": [asdict(one) for one in noticed(draws[i], draws[j], force_scale=scale)],
            }
        )
    return {
        "schema": "tissueid/contrast/1",
        "tissueid": __version__,
        "level": LEVEL,
        "common": {"depth_mm": common.depth_mm, "speeds_mm_s": list(common.speeds_mm_s)},
        "device": {"clamp_N": clamp_N, "force_scale": scale},
        "tissues": [
            {
                "name": tissue.name,
                "branches": tissue.model.branches,
                "stiffness_degree": tissue.model.stiffness_degree,
                "draws": len(tissue.draws),
                "interval": "total" if tissue.total else "statistical",
            }
            for tissue in tissues
        ],
        "curves": force_curves(list(tissues), common),
        "pairs": pairs,
    }
