"""Parts of every page: tables, figures, bands in them, and sections that hold both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Table:
    """Words and numbers in rows, as they are printed."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]  # the first cell of each is its name
    title: str = ""
    sentence: str = ""  # before it
    left_out: int = 0  # rows that are not printed
    reasons: Sequence[str] = ()  # why numbers are missing, each once


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
