"""Pages that need no layout of their own: sections of tables and figures; the index of a large cohort."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tissueid.digits import number, with_error
from tissueid.documents.identification import Specimen
from tissueid.report.page import render_page, verdict_counts
from tissueid.report.wording import FEW, misfit_raised, verdict


@dataclass(frozen=True, slots=True)
class Table:
    """Words and numbers in rows, as they are printed."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True)
class Figure:
    """A plotly figure."""

    caption: str  # says what is seen, for whoever does not see it too
    #: Titles of the axes, with units.
    x: str
    y: str
    #: As plotly takes them; what has a colour, such as a line, may name one of the page by ``"ink": "data"``.
    traces: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any] = field(default_factory=dict)

    def payload(self) -> dict[str, Any]:
        """Parts that the page's script draws."""
        return {"x": self.x, "y": self.y, "traces": list(self.traces), "layout": dict(self.layout)}


@dataclass(frozen=True, slots=True)
class Section:
    """A heading, a few sentences, tables and figures."""

    title: str
    text: str = ""
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()


def band(
    x: Sequence[float],
    low: Sequence[float],
    high: Sequence[float],
    faint: float,
    *,
    ink: str = "data",
    **more: Any,
) -> list[dict[str, Any]]:
    """Traces of the ends of a band, the upper one filled down to the lower in a faint colour of the page."""
    hidden = {"x": x, "mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False, **more}
    return [
        {**hidden, "y": low},
        {**hidden, "y": high, "fill": "tonexty", "fillcolor": {"ink": ink, "faint": faint}},
    ]


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
