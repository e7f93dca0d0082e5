"""Pages that need no layout of their own: sections of tables and figures; the index of a large cohort."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tissueid.digits import number, with_error
from tissueid.documents.identification import Specimen
from tissueid.report.page import render_page, verdict_counts
from tissueid.report.parts import Section
from tissueid.report.wording import FEW, misfit_raised, verdict


def render_plain(title: str, sections: Sequence[Section], *, created: str | None = None) -> str:
    """Write a page."""
    figures = [figure for section in sections for figure in section.figures]
    return render_page(
        "plain",
        title=title,
        sections=sections,
        numbers={id(figure): number for number, figure in enumerate(figures)},
        identity=id,
        payload=[one.payload() for one in figures],
        data="figures",
        created=created,
    )


#: Refused inputs that are listed; identification.json has them all.
_LISTED = 500


def index_row(specimen: Specimen, page: str) -> dict[str, Any]:
    """A specimen as a row of the table; ``page``: address of its own page, from the table's."""
    named = {one.name: one for one in specimen.parameters}
    found, sure = verdict(specimen), not misfit_raised(specimen)
    values = [named[name].value if name in named else None for name in FEW]
    errors = [named[name].stderr if sure and name in named else None for name in FEW]
    said = map(with_error, values, errors)
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
        refused=refused[:_LISTED],
        more=max(len(refused) - _LISTED, 0),
        payload={"rows": rows},
        created=created,
        scripts=["grids.js", "tables.js", "index.js"],
    )
