"""Pages that are tables: of sections with figures whose numbers stand in the page; of a large cohort.

For small documents that need no layout of their own.  Self-contained like the report.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tissueid.documents.identification import Specimen
from tissueid.report.page import asset, page_environment, plotly_script
from tissueid.report.wording import misfit_raised, verdict


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
    #: As plotly takes them; a ``line`` or ``marker`` may name a colour of the page by ``"ink": "data"``.
    traces: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Section:
    """A heading, a few sentences, tables and figures."""

    title: str
    text: str = ""
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()


def render_plain(title: str, sections: Sequence[Section], *, created: str | None = None) -> str:
    """Write a page.

    ``created``: time stamp to print; without it equal input gives an equal page.  Returns HTML, UTF-8.
    """
    figures = [figure for section in sections for figure in section.figures]
    payload = [
        {"x": one.x, "y": one.y, "traces": list(one.traces), "layout": dict(one.layout)} for one in figures
    ]
    return (
        page_environment()
        .get_template("plain.html.j2")
        .render(
            title=title,
            sections=sections,
            numbers={id(figure): number for number, figure in enumerate(figures)},
            identity=id,
            payload=payload,
            created=created,
            style=asset("page.css"),
            scripts=[asset("boxes.js"), asset("plain.js")],
            plotly=plotly_script() if figures else "",
        )
    )


#: Parameters of the table.
_SHOWN = ("static_1_N_per_mm", "relaxation_time_s", "viscosity_N_s_per_mm")
#: Refused inputs that are listed; identification.json has them all.
_LISTED = 500


def index_row(specimen: Specimen, page: str) -> dict[str, Any]:
    """A specimen of identification.json as a row of the table.

    ``page``: address of its own page, from the table's.
    """
    values = {one.name: one for one in specimen.parameters}
    found = verdict(specimen)
    sure = not misfit_raised(specimen)
    return {
        "name": specimen.specimen,
        "page": page,
        "level": found.level,
        "verdict": found.title,
        "values": [values[name].value if name in values else None for name in _SHOWN],
        "errors": [values[name].stderr if sure and name in values else None for name in _SHOWN],
        "nrmsd": 100.0 * specimen.nrmsd.range,
        "trials": len(specimen.trials),
        "depth": specimen.validity.depth_mm,
    }


def render_index(
    rows: Sequence[Mapping[str, Any]],
    refused: Sequence[str],
    *,
    created: str | None = None,
) -> str:
    """Write the report of a large cohort as one self-contained HTML page with links to those of specimens.

    ``rows``: from :func:`index_row`; ``refused``: what was left out, and why; ``created``: time stamp to
    print.  Returns HTML, UTF-8.
    """
    tally = Counter((row["level"], row["verdict"]) for row in rows)
    return (
        page_environment()
        .get_template("index.html.j2")
        .render(
            title=f"Contact mechanics of {len(rows):,} specimens",
            count=len(rows),
            counts=[(level, title, count) for (level, title), count in tally.most_common()],
            refused=refused[:_LISTED],
            more=max(len(refused) - _LISTED, 0),
            payload={"rows": rows},
            created=created,
            style=asset("page.css"),
            script=asset("index.js"),
            plotly=plotly_script(),
        )
    )
