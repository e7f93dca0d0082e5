"""The page of ``tissueid reproduce``: published beside recomputed, and what stands behind each number."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from tissueid.documents import reproduction as document
from tissueid.documents.reproduction import Item, Paper, Reproduction
from tissueid.report.page import render_page
from tissueid.report.parts import LOG_X, Figure, band, trace
from tissueid.report.wording import Verdict

#: Kind -> class of its look, mark, and what it means: told apart by more than colour.
KINDS: Mapping[str, tuple[str, str, str]] = {
    "reproduced": ("reproduced", "✓", "printed, and computed without the number itself"),
    "recomputed": ("recomputed", "=", "computed from what the paper states, which prints no number for it"),
    "given": ("given", "→", "printed as an input: put in, not computed"),
    "round trip": (
        "round-trip",
        "↻",
        "the published number is among the inputs: it comes back because it was put in",
    ),
    "assumed": ("assumed", "~", "an input is printed by no paper; change it and the number changes"),
    "not reproducible": ("lost", "✕", "its inputs are lost or were never printed"),
}
_Placed = TypeVar("_Placed", Item, document.Figure)
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a8f96", "#5a4fa2")


def _verdict(items: Sequence[Item]) -> Verdict:
    compared = [item for item in items if item.published is not None and item.agrees is not None]
    agreeing: Counter[str] = Counter(item.kind for item in compared if item.agrees)
    differing = [item.words for item in compared if not item.agrees]
    claims = [item for item in items if item.published is None and item.agrees is not None]
    unborne = [item for item in claims if not item.agrees]
    told = ", ".join(f"{agreeing[kind]} {kind}" for kind in KINDS if agreeing[kind]) or "none"
    text = (
        f"{len(compared)} printed numbers have a recomputed one beside them; {sum(agreeing.values())} agree "
        f"({told}). A round trip shows that the method returns what was put in, nothing about the tissue. "
        f"Of {len(claims)} sentences without a number, {len(unborne)} are not borne out as they stand."
    )
    if differing:
        return Verdict("caution", "Not everything agrees", f"{text} Differing: {'; '.join(differing)}.")
    return Verdict("note", "Consistent, mostly by construction", text)


def _at(paper: Paper, where: str, found: Sequence[_Placed]) -> list[tuple[int, _Placed]]:
    """Rows or figures that stand beside a table or figure of a paper, with their places in the document."""
    return [(at, one) for at, one in enumerate(found) if (one.paper, one.where) == (paper.name, where)]


def _drawn(figure: document.Figure) -> Figure:
    """A figure as the page's script takes it; lines can be told apart without their colour too."""
    traces: list[dict[str, Any]] = []
    for place, one in enumerate(figure.traces):
        shade = COLOURS[place % len(COLOURS)]
        mode, look = "markers", {"marker": {"color": shade, "size": 4}}
        if one.style != "points":
            dash = "dash" if one.style == "dash" else "solid"
            mode, look = "lines", {"line": {"color": shade, "width": 2, "dash": dash}}
        traces += band(one.x, (one.band.low, one.band.high), 0.25) if one.band else []
        traces.append(trace(one.x, one.y, mode, name=one.name, hovertemplate="%{x:.4g}: %{y:.4g}", **look))
    return Figure(figure.title, figure.x_title, figure.y_title, traces, LOG_X if figure.x_log else {})


def render_reproduction(found: Reproduction, *, created: str | None = None) -> str:
    """Write the page."""
    papers = found.papers
    alone = f"{papers[0].name.title()} et al., recomputed"
    return render_page(
        "reproduction",
        title="Two papers, recomputed" if len(papers) > 1 else alone,
        run=found,
        verdict=_verdict(found.items),
        kinds=KINDS,
        counts=Counter(item.kind for item in found.items),
        at=_at,
        figures=[_drawn(figure) for figure in found.figures],
        created=created,
        style="reproduction.css",
    )
