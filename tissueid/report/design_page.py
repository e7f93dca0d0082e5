"""The page of ``tissueid design``: the recommended protocol, precision against machine time, its limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from tissueid.digits import number
from tissueid.documents.design import Asked, Design, Front, Protocol
from tissueid.report.page import render_page
from tissueid.report.parts import Figure
from tissueid.report.wording import Verdict, counted, parameter_words

MINUTE, HOUR = 60.0, 3600.0


def _time(seconds: float) -> str:
    """``35 min`` or ``2.4 h``."""
    if seconds < 2.0 * MINUTE:
        return f"{number(seconds, 2)} s"
    return f"{number(seconds / MINUTE, 3)} min" if seconds < 2.0 * HOUR else f"{number(seconds / HOUR, 3)} h"


def _percent(share: float) -> str:
    return f"{number(100.0 * share, 3)} %"


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
            f"{best.logs} logs in {_time(best.seconds)} of machine time a specimen give {wanted}: "
            f"{_indentations(best)}, at {best.setting.words}."
        )
        given = document.against
        if given is not None and given.protocol is not None:
            other = given.protocol
            met = "reaches" if other.reached else "does not reach"
            said += f" {given.name} takes {_time(other.seconds)} and {met} that."
        return Verdict("ok", "Within reach", said)
    return Verdict(
        "serious",
        "None on this machine",
        f"No protocol that {machine} can run within {_time(document.asked.budget_s)} gives {wanted}. "
        f"The nearest gives {_reached(best, 'assured')}.",
    )


def _indentations(protocol: Front | Protocol) -> str:
    return "; ".join(f"{one.repeats} × {one.words}" for one in protocol.indentations)


def _facts(document: Design) -> list[tuple[str, str]]:
    asked, tissue, machine = document.asked, document.tissue, document.machine
    law = f"{counted(tissue.branches, 'branch', 'es')}, K of degree {tissue.stiffness_degree}"
    rest, mounting = number(asked.recovery_s, 3), number(asked.setup_s, 3)
    scatter, contact = number(100.0 * asked.gain_sd, 2), number(machine.contact_sd_mm, 2)
    repeats = f"{asked.repeats} repeats at the least, {asked.max_logs} logs at the most"
    return [
        ("Tissue", f"{tissue.name}: {tissue.words}, {counted(tissue.draws, 'draw')}"),
        ("Model", law if tissue.law == "kelvin-voigt" else tissue.law),
        ("Machine", f"{machine.name}{': ' * bool(machine.notes)}{machine.notes}"),
        ("Precision", f"{asked.interval}, for {_percent(asked.assurance)} of the tissues"),
        ("Allowed", f"{number(asked.max_depth_mm, 3)} mm, {number(asked.max_force_N, 4)} N; {repeats}"),
        ("Rest and mounting", f"{rest} s between logs, {mounting} s a specimen"),
        ("Scatter of logs", f"{scatter} % of the force, contact to {contact} mm"),
    ]


def _trace(
    name: str, points: Sequence[tuple[str, Front | Protocol]], want: int, **look: Any
) -> dict[str, Any]:
    return {
        "x": [one.seconds / MINUTE for _, one in points],
        "y": [100.0 * one.precision[want].assured for _, one in points],
        "text": [words for words, _ in points],
        "customdata": [_indentations(one).replace("; ", "<br>") for _, one in points],
        "name": name,
        "hovertemplate": "%{text}: %{y:.3g} % in %{x:.4g} min<br>%{customdata}<extra></extra>",
        **look,
    }


def _figure(document: Design, want: int) -> Figure:
    """Precision of one wanted number against machine time."""
    given, asked = document.against, document.asked.wants[want]
    front = [("least time", one) for one in sorted(document.front, key=lambda one: one.seconds)]
    ranked = [(str(rank), one) for rank, one in enumerate(document.protocols, 1)]
    # the first of the table stands out; numbers would lie on each other
    sizes = [14, *[8] * (len(ranked) - 1)]
    line = {"mode": "lines+markers", "line": {"ink": "data", "width": 2}, "marker": {"size": 6}}
    traces = [
        _trace("least time", front, want, **line),
        _trace("protocols", ranked, want, mode="markers", marker={"ink": "model", "size": sizes}),
    ]
    if given is not None and given.protocol is not None:
        star = {"ink": "ink", "size": 12, "symbol": "star"}
        traces.append(_trace(given.name, [(given.name, given.protocol)], want, mode="markers", marker=star))
    minutes = [x for one in traces for x in one["x"]]
    wanted = {
        "x": [0.9 * min(minutes), 1.1 * max(minutes)],
        "y": [100.0 * asked.share] * 2,
        "mode": "lines",
        "line": {"ink": "soft", "width": 1, "dash": "dash"},
        "name": "wanted",
        "hoverinfo": "skip",
    }
    best = document.protocols[0]
    caption = (
        f"Standard deviation of {parameter_words(asked.name)} against machine time: protocol 1 has "
        f"{_percent(best.precision[want].assured)} after {number(best.seconds / MINUTE, 3)} minutes, wanted "
        f"are {_percent(asked.share)}. The table of protocols has the numbers."
    )
    axes = ("Machine time a specimen [min]", "Standard deviation [%]")
    return Figure(caption, *axes, [wanted, *traces], {"xaxis": {"type": "log"}, "yaxis": {"type": "log"}})


def _heads(asked: Asked) -> list[str]:
    every = [f"{asked.specimens} specimens"] if asked.specimens > 1 else []
    wanted = Markup("{}<br>wanted {}")
    wants = [wanted.format(parameter_words(one.name), _percent(one.share)) for one in asked.wants]
    return [*("Protocol", "Wants", "Time a specimen"), *every, "Logs", *wants, "Load channel", "Indentations"]


def render_design(document: Design, *, created: str | None = None) -> str:
    """Write the page."""
    figures = [_figure(document, want) for want in range(len(document.asked.wants))]
    given = document.against
    named = [(given.name, given.protocol)] if given is not None and given.protocol is not None else []
    return render_page(
        "design",
        title=f"Protocol for {document.tissue.name}",
        run=document,
        best=document.protocols[0],
        verdict=_verdict(document),
        facts=_facts(document),
        heads=_heads(document.asked),
        protocols=[*enumerate(document.protocols, 1), *named],
        time=_time,
        percent=_percent,
        figures=figures,
        payload=[one.payload() for one in figures],
        created=created,
    )
