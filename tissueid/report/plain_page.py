"""Pages that need no layout of their own: sections of tables and figures; the index of a large cohort."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tissueid.documents.identification import Specimen
from tissueid.report.page import render_page
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
        payload=[
            {"x": one.x, "y": one.y, "traces": list(one.traces), "layout": dict(one.layout)}
            for one in figures
        ],
        data="figures",
        created=created,
        scripts=["plain.js"],
    )


#: Parameters of the table.
_SHOWN = ("static_1_N_per_mm", "relaxation_time_s", "viscosity_N_s_per_mm")
#: Refused inputs that are listed; identification.json has them all.
_LISTED = 500


def index_row(specimen: Specimen, page: str) -> dict[str, Any]:
    """A specimen as a row of the table; ``page``: address of its own page, from the table's."""
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
    rows: Sequence[Mapping[str, Any]], refused: Sequence[str], *, created: str | None = None
) -> str:
    """Write the report of a large cohort, with links to those of specimens."""
    tally = Counter((row["level"], row["verdict"]) for row in rows)
    return render_page(
        "index",
        title=f"Contact mechanics of {len(rows):,} specimens",
        count=len(rows),
        counts=[(level, title, count) for (level, title), count in tally.most_common()],
        refused=refused[:_LISTED],
        more=max(len(refused) - _LISTED, 0),
        payload={"rows": rows},
        created=created,
        scripts=["index.js"],
    )
