"""Self-contained pages from templates: of plain sections, the index of a cohort, the report of a fit."""

from __future__ import annotations

import base64
import json
import os
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined
from markupsafe import Markup
from msgspec import structs

from tissueid.digits import NOT_IDENTIFIED, number, with_error
from tissueid.documents import plain
from tissueid.documents.identification import Estimate, Identification, Specimen
from tissueid.documents.inspect import Units
from tissueid.documents.study import StudyCheck
from tissueid.errors import refuse
from tissueid.report import wording
from tissueid.report.figures import curve_payload, curves_by_trial, posterior_payload
from tissueid.report.law_payload import curve_groups, law_payload
from tissueid.report.measured_words import measured_view
from tissueid.report.methods_words import citation, methods_view, subscripted
from tissueid.report.parts import Figure, Section
from tissueid.report.quoted_words import cycle_table, quoted_tables
from tissueid.report.rendering_words import Rendering, rendering_view
from tissueid.report.specimen_lines import unloading_words
from tissueid.report.study_words import change_words, frame_words, key_words, stated_facts, stated_table
from tissueid.report.uncertainty_words import paper_view, uncertainty_view
from tissueid.report.workbook import report_workbook
from tissueid.store.curves import TrialCurve
from tissueid.store.posteriors import StoredPosterior

#: Reasons of a verdict that are seen at once.
MOST_REASONS = 5
#: Remarks that are said above the others, in other words.
_TOLD_APART = frozenset({"misfit", "sampler_not_converged"})
#: In the order in which they need each other.
_SCRIPTS = ("grids.js", "posterior.js", "law.js", "figures.js", "tables.js")

#: Functions that templates call by their names, of a value behind a bar as well.
_WORDS: tuple[Callable[..., Any], ...] = (
    *(number, with_error, subscripted, wording.span, wording.reach, wording.percent),
    *(wording.counted, wording.took, wording.in_units, wording.unit_words, wording.symbol_words),
    *(wording.event_words, wording.parameter_words, wording.trial_label, wording.whole_label),
    *(change_words, frame_words, key_words, stated_facts, stated_table),
)


@cache
def page_environment() -> Environment:
    """The template environment that every page shares; compiled templates stand beside compiled modules."""
    compiled = str(Path(__file__).with_name("__pycache__"))
    environment = Environment(
        loader=PackageLoader("tissueid.report", "templates"),
        bytecode_cache=FileSystemBytecodeCache(compiled) if os.access(compiled, os.W_OK) else None,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_function"] = partial(json.dumps, default=plain)
    words = {one.__name__: one for one in _WORDS}
    environment.filters |= words
    environment.globals |= {**words, "NOT_IDENTIFIED": NOT_IDENTIFIED}
    environment.globals["MM_N"] = Units(length="mm", force="N", time="s")
    environment.globals["part"] = environment.get_template("macros.html.j2").module
    return environment


def render_page(
    template: str,
    *,
    scripts: Sequence[str] = ("plain.js",),
    style: str = "",
    figures: Sequence[Figure] = (),
    payload: Any = None,
    data: str = "payload",
    script_file: str | None = None,
    **words: Any,
) -> str:
    """HTML, self-contained; without a time stamp ``created`` equal input gives an equal page.

    ``scripts``: behind the drawing library, which a page without a ``payload`` does without; ``style``: a
    sheet beside the common one; ``payload``: numbers for the scripts, where they are not ``figures``;
    ``data``: its id in the page; ``script_file``: where the drawing library stands, from the page; without it
    the page holds it.
    """
    carried = [figure.payload() for figure in figures] if payload is None else payload
    holds = bool(carried) and script_file is None
    return (
        page_environment()
        .get_template(f"{template}.html.j2")
        .render(
            **words,
            figures=figures,
            payload=carried,
            data=data,
            style=asset("page.css") + (asset(style) if style else ""),
            script_file=script_file,
            library=base64.b64encode(_library()).decode("ascii") if holds else None,
            scripts=[asset(name) for name in (*["library.js"] * holds, "boxes.js", *scripts)],
        )
    )


def asset(name: str) -> Markup:
    """A style or script of this package, as it stands in the page."""
    # files of this package, written by us: nothing in them comes from a recording
    text = (resources.files("tissueid.report") / "templates" / name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704


@cache
def _library() -> bytes:
    """The drawing library as an installation brings it, a raw deflate stream (RFC 1951)."""
    place = resources.files("tissueid.report") / "static" / "plotly.min.js.deflated"
    try:
        return place.read_bytes()
    except FileNotFoundError as error:
        refuse(f"{error.filename}: reports need plotly.js, which an installation brings: pip install .")


def plotly_script() -> Markup:
    """The drawing library, whole; UsageError where tissueid runs from a folder that was never installed."""
    # the library's own file
    return Markup(zlib.decompress(_library(), -zlib.MAX_WBITS).decode("utf-8"))  # noqa: S704


def render_plain(title: str, sections: Sequence[Section]) -> str:
    """Write a page."""
    figures = [figure for section in sections for figure in section.figures]
    return render_page("plain", title=title, sections=sections, figures=figures, data="figures", created=None)


def few_values(specimen: Specimen) -> list[Estimate | None]:
    """Parameters that stand for a specimen; no error where the residuals contradict the model."""
    known = {
        one.name: structs.replace(one, stderr=None) if wording.misfit_raised(specimen) else one
        for one in specimen.parameters
    }
    return [known.get(name) for name in wording.FEW]


def index_row(specimen: Specimen, page: str) -> dict[str, Any]:
    """A specimen as a row of the table; ``page``: address of its own page, from the table's."""
    found, few = wording.verdict(specimen), few_values(specimen)
    values = [None if one is None else one.value for one in few]
    said = [with_error(None, None) if one is None else with_error(one.value, one.stderr) for one in few]
    nrmsd, trials, depth = 100.0 * specimen.nrmsd.range, len(specimen.trials), specimen.validity.depth_mm
    return {
        "name": specimen.specimen,
        "page": page,
        "level": found.level,
        "verdict": found.title,
        "keys": [specimen.specimen, found.title, *values, nrmsd, trials, depth],
        "cells": [*said, f"{nrmsd:.2f}", str(trials), number(depth, 3)],
    }


def render_index(
    rows: Sequence[Mapping[str, Any]], refused: Sequence[str], *, created: str | None = None
) -> str:
    """Write the report of a large cohort, with links to those of specimens."""
    return render_page(
        "index",
        title=f"Contact mechanics of {len(rows):,} specimens",
        count=len(rows),
        counts=verdict_counts((row["level"], row["verdict"]) for row in rows),
        refused=refused,
        payload={"rows": rows},
        created=created,
        scripts=["grids.js", "tables.js", "index.js"],
    )


def _view(
    position: int, specimen: Specimen, run: Identification, rendering: Rendering | str | None
) -> dict[str, Any]:
    sure = uncertainty_view(specimen)
    alarms = _alarms(sure)
    told = [one for one in wording.remarks(specimen) if sure is None or one.code not in _TOLD_APART]
    if len(specimen.trials) == 1:
        told = [replace(one, where=()) for one in told]
    shown = MOST_REASONS - len(alarms)
    return {
        "id": f"specimen-{position + 1}",
        "position": position,
        "data": specimen,
        "sure": sure,
        "paper": paper_view(specimen),
        "measured": measured_view(specimen),
        "verdict": wording.verdict(specimen),
        "alarms": alarms,
        "reasons": told[:shown],
        "more": told[shown:],
        "summary": few_values(specimen),
        "quoted": quoted_tables(specimen.quoted),
        "cycles": cycle_table(specimen.cycles),
        "unloading": unloading_words(specimen.unloading_predicted),
        "methods": methods_view(specimen, run),
        "rendering": rendering_view(rendering, specimen),
    }


def _alarms(sure: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Alarms above every other reason: level and sentence."""
    if sure is None:
        return []
    contradicted = f"The recordings contradict this model or its noise: {'; '.join(sure['alarm'])}."
    rough = "The sampler did not converge: its numbers are rough."
    return [("serious", contradicted)] * sure["raised"] + [("caution", rough)] * (not sure["converged"])


def _overview(specimens: Sequence[Specimen]) -> list[dict[str, Any]]:
    """Points of the overview figure: one a specimen whose viscosity is identified."""
    return [
        {"name": specimen.specimen, "value": entry.value, **_ends(specimen, entry)}
        for specimen in specimens
        for entry in specimen.parameters
        if entry.name == "viscosity_N_s_per_mm" and entry.value is not None
    ]


def _ends(specimen: Specimen, entry: Estimate) -> dict[str, float]:
    """Reach of an error bar up and down: 95 %, or one standard error where nothing was sampled."""
    if wording.misfit_raised(specimen):
        return {"up": 0.0, "down": 0.0}
    if entry.ci95 is None:
        return {"up": entry.stderr or 0.0, "down": entry.stderr or 0.0}
    (low, high), value = entry.ci95, entry.value or 0.0
    return {"up": max(high - value, 0.0), "down": max(value - low, 0.0)}


def verdict_counts(verdicts: Iterable[tuple[str, str]]) -> list[tuple[str, str, int]]:
    """Count of specimens by level and title of their verdicts, the commonest first."""
    return [(level, title, count) for (level, title), count in Counter(verdicts).most_common()]


def render_report(
    identification: Identification,
    curves: Sequence[TrialCurve],
    posteriors: Sequence[StoredPosterior] = (),
    *,
    renderings: Sequence[Rendering | str | None] = (),
    metadata: StudyCheck | None = None,
    twin: Sequence[Section] = (),
    created: str | None = None,
    script_file: str | None = None,
    digest: str | None = None,
) -> str:
    """Write the report of one run as one self-contained HTML page.

    ``curves``: trials without a curve are listed but not drawn; ``posteriors``: draws, chains and predictive
    bands; ``renderings``: one a specimen, from :func:`tissueid.study.pages.rendering_of`; ``metadata``: how
    complete the study's description is; ``twin``: of :func:`tissueid.report.twin_page.twin_sections`;
    ``created``: time stamp to print; ``script_file``: of :func:`render_page`; ``digest``: SHA-256 of
    identification.json.
    """
    specimens = identification.specimens
    units = specimens[0].units if specimens else None
    if any(specimen.units != units for specimen in specimens):
        units = None
    shown = [*renderings, *[None] * (len(specimens) - len(renderings))]
    views = [
        _view(position, specimen, identification, rendering)
        for position, (specimen, rendering) in enumerate(zip(specimens, shown, strict=True))
    ]
    return render_page(
        "report",
        title=_title(specimens),
        run=identification,
        unfitted=cycle_table(identification.unfitted_cycles),
        views=views,
        workbook=base64.b64encode(report_workbook(identification, digest)).decode("ascii"),
        payload=_payload(specimens, curves, posteriors, units if len(specimens) > 1 else None),
        common_units=units,
        overview_sentence=wording.overview_sentence(specimens),
        counts=verdict_counts((one["verdict"].level, one["verdict"].title) for one in views),
        study=identification.study,
        metadata=metadata,
        twin=twin,
        cite=citation(identification.provenance.tissueid),
        created=created,
        data="curves",
        scripts=_SCRIPTS,
        script_file=script_file,
    )


def _payload(
    specimens: Sequence[Specimen],
    curves: Sequence[TrialCurve],
    posteriors: Sequence[StoredPosterior],
    shared: Units | None,
) -> dict[str, Any]:
    """Numbers behind all figures; curves of several specimens stand together in units that they share."""
    return {
        "specimens": curve_payload(specimens, curves, posteriors),
        "posteriors": posterior_payload(specimens, posteriors),
        "laws": law_payload(specimens, curves, posteriors),
        "groups": curve_groups(curves_by_trial(specimens, curves), shared) if shared else [],
        "units": [plain(specimen.units) for specimen in specimens],
        "overview": _overview(specimens),
    }


def _title(specimens: Sequence[Specimen]) -> str:
    if len(specimens) == 1:
        return f"Contact mechanics of {specimens[0].specimen}"
    return f"Contact mechanics of {len(specimens)} specimens" if specimens else "No specimen was fitted"
