"""The page of ``tissueid design``: the recommended protocol, precision against machine time, its limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tissueid.digits import number
from tissueid.documents.design import Design, Front, Protocol
from tissueid.report.page import render_page
from tissueid.report.parts import DASHED, LOG_BOTH, Figure, trace
from tissueid.report.wording import MINUTE, Verdict, parameter_words, percent, time_words


def _percent(share: float) -> str:
    return f"{percent(share)} %"


def _reached(protocol: Protocol, key: str) -> str:
    """Every wanted number with its precision, in words."""
    return ", ".join(
        f"{parameter_words(one.name).lower()} to {_percent(getattr(one, key))}" for one in protocol.precision
    )


def _verdict(document: Design) -> Verdict:
    best, machine = document.protocols[0], document.machine.name
    wanted = _reached(best, "wanted")
    if document.verdict.reached:
        said = (
            f"{best.logs} logs in {time_words(best.seconds)} of machine time a specimen give {wanted}: "
            f"{_indentations(best)}, at {best.setting.words}."
        )
        given = document.against
        if given is not None and given.protocol is not None:
            other = given.protocol
            met = "reaches" if other.reached else "does not reach"
            said += f" {given.name} takes {time_words(other.seconds)} and {met} that."
        return Verdict("ok", "Within reach", said)
    return Verdict(
        "serious",
        "None on this machine",
        f"No protocol that {machine} can run within {time_words(document.asked.budget_s)} gives {wanted}. "
        f"The nearest gives {_reached(best, 'assured')}.",
    )


def _indentations(protocol: Front | Protocol) -> str:
    return "; ".join(f"{one.repeats} × {one.words}" for one in protocol.indentations)


def _trace(
    name: str, points: Sequence[tuple[str, Front | Protocol]], want: int, mode: str = "markers", **look: Any
) -> dict[str, Any]:
    minutes = [one.seconds / MINUTE for _, one in points]
    assured = [100.0 * one.precision[want].assured for _, one in points]
    moves = [_indentations(one).replace("; ", "<br>") for _, one in points]
    form = "%{text}: %{y:.3g} % in %{x:.4g} min<br>%{customdata}<extra></extra>"
    told = {"text": [said for said, _ in points], "customdata": moves, "hovertemplate": form}
    return trace(minutes, assured, mode, name=name, **told, **look)


def _figure(document: Design, want: int) -> Figure:
    """Precision of one wanted number against machine time."""
    given, asked = document.against, document.asked.wants[want]
    front = [("least time", one) for one in sorted(document.front, key=lambda one: one.seconds)]
    ranked = [(str(rank), one) for rank, one in enumerate(document.protocols, 1)]
    # the first of the table stands out; numbers would lie on each other
    sizes = [14, *[8] * (len(ranked) - 1)]
    line = {"line": {"ink": "data", "width": 2}, "marker": {"size": 6}}
    traces = [
        _trace("least time", front, want, "lines+markers", **line),
        _trace("protocols", ranked, want, marker={"ink": "model", "size": sizes}),
    ]
    if given is not None and given.protocol is not None:
        star = {"ink": "ink", "size": 12, "symbol": "star"}
        traces.append(_trace(given.name, [(given.name, given.protocol)], want, marker=star))
    minutes = [x for one in traces for x in one["x"]]
    ends, level = [0.9 * min(minutes), 1.1 * max(minutes)], [100.0 * asked.share] * 2
    wanted = trace(ends, level, "lines", line=DASHED, name="wanted", hoverinfo="skip")
    best = document.protocols[0]
    caption = (
        f"Standard deviation of {parameter_words(asked.name)} against machine time: protocol 1 has "
        f"{_percent(best.precision[want].assured)} after {number(best.seconds / MINUTE, 3)} minutes, wanted "
        f"are {_percent(asked.share)}. The table of protocols has the numbers."
    )
    axes = ("Machine time a specimen [min]", "Standard deviation [%]")
    return Figure(caption, *axes, [wanted, *traces], LOG_BOTH)


def render_design(document: Design, *, created: str | None = None) -> str:
    """Write the page."""
    given = document.against
    named = [(given.name, given.protocol)] if given is not None and given.protocol is not None else []
    return render_page(
        "design",
        title=f"Protocol for {document.tissue.name}",
        run=document,
        best=document.protocols[0],
        verdict=_verdict(document),
        protocols=[*enumerate(document.protocols, 1), *named],
        time=time_words,
        share=_percent,
        figures=[_figure(document, want) for want in range(len(document.asked.wants))],
        created=created,
    )
