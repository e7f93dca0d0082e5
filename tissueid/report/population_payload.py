"""The numbers behind the figures of a population's page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tissueid.documents import plain
from tissueid.documents.population import Population, Specimen
from tissueid.model.channels import loading_force
from tissueid.store.bundle import Bundle

#: Specimens drawn one by one; of more, outliers and an even choice of the others.
MOST_DRAWN = 200
#: Depths of the bands, and specimens they are taken from.
BAND_DEPTHS = 41
BAND_DRAWS = 500
QUANTILES = (0.025, 0.16, 0.5, 0.84, 0.975)
#: Digits that a figure shows.
DIGITS = 6


def _rounded(values: Any) -> Any:
    """Numbers to the digits that a figure shows."""
    array = np.asarray(values, dtype=np.float64)
    flat = [float(f"{value:.{DIGITS}g}") for value in array.ravel()]
    return np.array(flat).reshape(array.shape).tolist()


def force_bands(bundle: Bundle) -> dict[str, Any] | None:
    """Force against depth at one speed: quantiles over specimens drawn from the population.

    Returns ``depth_mm``, ``speed_mm_s``, ``typical`` and ``quantiles``, shape (5, n) [N]; ``None`` where no
    speed is known.
    """
    model = bundle.contact_model()
    slowest, fastest = bundle.speeds_mm_s
    if not (model.viscous and bundle.draws is not None and fastest > 0.0):
        return None
    speed = float(np.sqrt(max(slowest, 1e-3 * fastest) * fastest))
    depth = np.linspace(0.0, bundle.depth_mm, BAND_DEPTHS)
    forces = np.array(
        [loading_force(model, theta, depth, speed_mm_s=speed) for theta in bundle.draws[:BAND_DRAWS]]
    )
    return {
        "depth_mm": _rounded(depth),
        "speed_mm_s": speed,
        "typical": _rounded(loading_force(model, bundle.theta, depth, speed_mm_s=speed)),
        "quantiles": _rounded(np.quantile(forces, QUANTILES, axis=0)),
    }


def _shown(specimens: Sequence[Specimen]) -> Sequence[Specimen]:
    """Those that are drawn, outliers among them."""
    if len(specimens) <= MOST_DRAWN:
        return specimens
    outliers = [row for row in specimens if row.outlier is not None][:MOST_DRAWN]
    rest = [row for row in specimens if row.outlier is None]
    take = MOST_DRAWN - len(outliers)
    return outliers + [rest[k] for k in np.linspace(0, len(rest) - 1, take).astype(int)] if take else outliers


def population_payload(document: Population, bundle: Bundle | None) -> dict[str, Any]:
    """Everything the page's script draws from.

    ``document``: population.json; ``bundle``: population.h5.
    """
    found = document.population
    assert found is not None  # noqa: S101  (a page is of a population)
    shown = _shown(found.specimens)
    return {
        "quantities": [
            {
                "words": row.words,
                "unit": "" if row.unit == "1" else row.unit,
                "median": row.median,
                "ci95": row.ci95,
                "sd": row.sd_ln,
            }
            for row in found.quantities
        ],
        "specimens": [
            {
                "name": row.specimen,
                "outlier": row.outlier is not None,
                "separate": _rounded(row.separate),
                "separate_ci95": _rounded(row.separate_ci95),
                "pooled": _rounded(row.pooled),
                "pooled_ci95": _rounded(row.pooled_ci95),
            }
            for row in shown
        ],
        "correlation": _rounded(found.correlation),
        "bands": None if bundle is None else force_bands(bundle),
        "agreement": plain(document.agreement),
        "held_out": (
            None
            if found.held_out is None
            else {
                "range": _rounded([100.0 * row.nrmsd_range for row in found.held_out.trials]),
                "mean": _rounded([100.0 * row.nrmsd_mean for row in found.held_out.trials]),
                "paper_a": found.held_out.paper_a_percent,
            }
        ),
    }
