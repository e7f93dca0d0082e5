"""Parts of every page: tables, figures, traces and bands in them, and sections that hold both."""

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
        return {"x": self.x, "y": self.y, "traces": self.traces, "layout": self.layout}


@dataclass(frozen=True, slots=True)
class Section:
    """A heading, a few sentences, tables and figures."""

    title: str
    text: str = ""
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()


#: Look of a line that others are held against, and layouts of logarithmic axes.
DASHED = {"ink": "soft", "width": 1, "dash": "dash"}
LOG_X: Mapping[str, Any] = {"xaxis": {"type": "log"}}
LOG_BOTH: Mapping[str, Any] = {**LOG_X, "yaxis": {"type": "log"}}


def trace(x: Sequence[Any], y: Sequence[Any], mode: str = "", **look: Any) -> dict[str, Any]:
    """A trace of plotly, ``mode``: of its points."""
    return {"x": x, "y": y, **({"mode": mode} if mode else {}), **look}


def band(
    x: Sequence[float], ends: Sequence[Sequence[float]], faint: float, ink: str = "data", **more: Any
) -> list[dict[str, Any]]:
    """Traces of the ends of a band, the upper one filled down to the lower in a faint colour of the page."""
    hidden: dict[str, Any] = {"line": {"width": 0}, "hoverinfo": "skip", "showlegend": False, **more}
    filled = {"fill": "tonexty", "fillcolor": {"ink": ink, "faint": faint}}
    return [trace(x, y, "lines", **hidden, **look) for y, look in zip(ends, ({}, filled), strict=True)]
