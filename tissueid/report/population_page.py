"""The page of ``tissueid cohort``: what specimens have in common, how they differ, and what may be said.

Self-contained like the report.  Every figure has its numbers in the tables beside it.
"""

from __future__ import annotations

from typing import Any

from tissueid.digits import number
from tissueid.documents.population import HeldOut, Population, Populations
from tissueid.flags import flag_level
from tissueid.report.page import asset, page_environment, plotly_script
from tissueid.report.population_payload import MOST_DRAWN, population_payload
from tissueid.report.remarks import Remark, remark_title
from tissueid.report.wording import Verdict
from tissueid.store.bundle import Bundle


def _percent(value: float, digits: int = 3) -> str:
    return number(100.0 * value, digits)


def _interval(ends: tuple[float, float] | None, digits: int = 4) -> str:
    return "–" if ends is None else f"{number(ends[0], digits)} to {number(ends[1], digits)}"


def _percents(ends: tuple[float, float]) -> str:
    return f"{_percent(ends[0])} to {_percent(ends[1])}"


def _verdict(document: Population) -> Verdict:
    found = document.population
    assert found is not None  # noqa: S101  (a page is of a population)
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


def _remarks(document: Population) -> list[Remark]:
    return [
        Remark(
            level=flag_level(flag.code),
            code=flag.code,
            title=remark_title(flag.code),
            messages=(flag.message,),
            where=(),
        )
        for flag in document.flags
    ]


def held_out_sentence(held: HeldOut) -> str:
    """NRMSD of the typical tissue on specimens that took no part, beside paper A."""
    low, high = held.paper_a_percent
    by_range, by_mean = held.nrmsd_range, held.nrmsd_mean
    inside = any(low <= 100.0 * one.median <= high for one in (by_range, by_mean))
    said = "is consistent with" if inside else "lies outside"
    return (
        "The typical tissue of the others misses a log of a specimen that took no part by "
        f"{_percent(by_range.median)} % of its range of force (68 % of logs: "
        f"{_percent(by_range.low68)} to {_percent(by_range.high68)} %), or "
        f"{_percent(by_mean.median)} % of its mean ({_percent(by_mean.low68)} to "
        f"{_percent(by_mean.high68)} %). Paper A states {low:g} to {high:g} % without saying of what; "
        f"the result {said} that, which proves nothing: any scatter of its size gives such numbers."
    )


def _effects(found: Populations) -> list[dict[str, Any]]:
    words = {row.name: row.words for row in found.quantities}
    return [
        {
            "quantity": words[row.name],
            "what": (
                f"{row.covariate}: {row.of} against {row.against}"
                if row.of is not None
                else f"{row.covariate}, {number(row.per, 3)} more"
            ),
            "ratio": number(row.ratio, 4),
            "ci95": _interval(row.ci95),
            "probability": f"{row.probability:.3f}",
        }
        for row in found.effects
    ]


def _outliers(found: Populations) -> list[dict[str, str]]:
    words = {row.name: row.words for row in found.quantities}
    return [
        {
            "specimen": row.specimen,
            "probability": f"{row.far:.2f}",
            "quantity": words[row.outlier or ""],
            "deviation": f"{row.deviation:+.1f}".replace("-", "−"),
        }
        for row in sorted(found.specimens, key=lambda row: -row.far)
        if row.outlier is not None
    ]


def _sizes(found: Populations) -> list[dict[str, Any]]:
    """A row a quantity: specimens for each precision."""
    rows: dict[str, dict[str, Any]] = {}
    words = {row.name: row.words for row in found.quantities}
    for row in found.cohort_size:
        one = rows.setdefault(row.name, {"quantity": words[row.name], "cells": []})
        one["cells"].append(
            {
                "precision": row.precision,
                "mean": f"{row.mean:,} ({row.mean_range[0]:,} to {row.mean_range[1]:,})",
                "sd": f"{row.sd:,} ({row.sd_range[0]:,} to {row.sd_range[1]:,})",
            }
        )
    return list(rows.values())


def render_population(document: Population, bundle: Bundle | None, *, created: str | None = None) -> str:
    """Write the page.

    ``document``: the document of ``schemas/population.schema.json``, with a population; ``bundle``:
    population.h5, for the bands of force; ``created``: time stamp to print; without it equal input gives an
    equal page.  Returns HTML, UTF-8.
    """
    found = document.population
    assert found is not None  # noqa: S101  (a page is of a population)
    return (
        page_environment()
        .get_template("population.html.j2")
        .render(
            title=f"Population of {len(document.specimens_used)} specimens",
            run=document,
            found=found,
            verdict=_verdict(document),
            remarks=_remarks(document),
            interval=_interval,
            percent=_percent,
            percents=_percents,
            effects=_effects(found),
            outliers=_outliers(found),
            sizes=_sizes(found),
            held_out=None if found.held_out is None else held_out_sentence(found.held_out),
            most_drawn=MOST_DRAWN,
            payload=population_payload(document, bundle),
            created=created,
            style=asset("page.css") + asset("selfcheck.css"),
            plotly=plotly_script(),
            scripts=[asset("boxes.js"), asset("population.js")],
        )
    )
