"""A page of sections: a sentence, tables, figures whose numbers stand in the page.

For small documents that need no layout of their own.  Self-contained like the report.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tissueid.report.page import asset, page_environment, plotly_script


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
