"""The page of ``tissueid cohort``: what specimens have in common, how they differ, and what may be said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tissueid.arrays import evenly
from tissueid.documents import plain
from tissueid.documents.population import CohortSize, HeldOut, Population, Populations, Specimen
from tissueid.model.channels import loading_force
from tissueid.report.page import render_page
from tissueid.report.parts import Table
from tissueid.report.wording import Verdict, flag_remarks, percent, span
from tissueid.store.bundle import Bundle

#: Specimens drawn one by one; of more, outliers and an even choice of the others.
MOST_DRAWN = 200
#: Depths of the bands, and specimens they are taken from.
BAND_DEPTHS = 41
BAND_DRAWS = 500
QUANTILES = (0.025, 0.16, 0.5, 0.84, 0.975)
_DRAWN = ("separate", "separate_ci95", "pooled", "pooled_ci95")
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
    return outliers + [rest[k] for k in evenly(len(rest), MOST_DRAWN - len(outliers))]


def population_payload(document: Population, bundle: Bundle | None) -> dict[str, Any]:
    """Everything the page's script draws from."""
    found = document.population
    assert found is not None  # noqa: S101  (a page is of a population)
    shown, held = _shown(found.specimens), found.held_out
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
            {"name": row.specimen, "outlier": row.outlier is not None}
            | {key: _rounded(getattr(row, key)) for key in _DRAWN}
            for row in shown
        ],
        "correlation": _rounded(found.correlation),
        "bands": None if bundle is None else force_bands(bundle),
        "agreement": plain(document.agreement),
        "held_out": held
        and {
            "range": _rounded([100.0 * row.nrmsd_range for row in held.trials]),
            "mean": _rounded([100.0 * row.nrmsd_mean for row in held.trials]),
            "paper_a": held.paper_a_percent,
        },
    }


def _percents(low: float, high: float) -> str:
    return span((100.0 * low, 100.0 * high), 3)


def _verdict(document: Population, found: Populations) -> Verdict:
    sampler = found.sampler
    how = f"R-hat {sampler.r_hat:.3f}, {sampler.ess:.0f} effective draws or more"
    if not sampler.converged:
        return Verdict(
            "serious", "Not converged", f"The chains did not converge ({how}): intervals are rough."
        )
    return Verdict(
        "ok",
        f"Population of {len(document.specimens_used)} specimens",
        f"The chains converged ({how}). Intervals are calibrated for the stated model, and say nothing of "
        "specimens that were chosen otherwise than these.",
    )


def held_out_sentence(held: HeldOut) -> str:
    """NRMSD of the typical tissue on specimens that took no part, beside paper A."""
    low, high = held.paper_a_percent
    by_range, by_mean = held.nrmsd_range, held.nrmsd_mean
    of_range, of_mean = (_percents(one.low68, one.high68) for one in (by_range, by_mean))
    inside = any(low <= 100.0 * one.median <= high for one in (by_range, by_mean))
    said = "is consistent with" if inside else "lies outside"
    return (
        "The typical tissue of the others misses a log of a specimen that took no part by "
        f"{percent(by_range.median)} % of its range of force (68 % of logs: {of_range} %), or "
        f"{percent(by_mean.median)} % of its mean ({of_mean} %). "
        f"Paper A states {low:g} to {high:g} % without saying of what; "
        f"the result {said} that, which proves nothing: any scatter of its size gives such numbers."
    )


def _sizes(found: Populations, words: Mapping[str, str]) -> Table:
    """A row a quantity: specimens for each precision, of the median and of the spread."""
    rows: dict[str, list[CohortSize]] = {}
    for row in found.cohort_size:
        rows.setdefault(row.name, []).append(row)
    precisions = [f"{100 * row.precision:g} %" for row in next(iter(rows.values()))]
    return Table(
        ["Quantity", *(f"{of} to {precision}" for of in ("Median", "Spread") for precision in precisions)],
        [
            [
                words[name],
                *(f"{row.mean:,} ({row.mean_range[0]:,} to {row.mean_range[1]:,})" for row in cells),
                *(f"{row.sd:,} ({row.sd_range[0]:,} to {row.sd_range[1]:,})" for row in cells),
            ]
            for name, cells in rows.items()
        ],
    )


def render_population(document: Population, bundle: Bundle | None, *, created: str | None = None) -> str:
    """Write the page of a document with a population; ``bundle``: population.h5, for the bands of force."""
    found = document.population
    assert found is not None  # noqa: S101  (a page is of a population)
    words = {row.name: row.words for row in found.quantities}
    return render_page(
        "population",
        title=f"Population of {len(document.specimens_used)} specimens",
        run=document,
        found=found,
        verdict=_verdict(document, found),
        remarks=flag_remarks(document.flags),
        percents=_percents,
        words=words,
        outliers=sorted((row for row in found.specimens if row.outlier), key=lambda row: -row.far),
        sizes=_sizes(found, words),
        held_out=None if found.held_out is None else held_out_sentence(found.held_out),
        most_drawn=MOST_DRAWN,
        payload=population_payload(document, bundle),
        created=created,
        scripts=["grids.js", "population.js"],
    )
