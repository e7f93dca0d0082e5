"""The page of ``tissueid design``: the recommended protocol, precision against machine time, what limits it.

Self-contained like the report.  The figure's points are the rows of the tables beside it.
"""

from __future__ import annotations

from typing import Any

from tissueid.digits import number
from tissueid.documents.design import Design, Front, Protocol
from tissueid.report.page import asset, page_environment, plotly_script
from tissueid.report.wording import Verdict, parameter_words

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
    plural = "es" if tissue.branches != 1 else ""
    law = f"{tissue.branches} branch{plural}, K of degree {tissue.stiffness_degree}"
    draws = f"{tissue.draws} draw{'s' * (tissue.draws > 1)}"
    rest, mounting = number(asked.recovery_s, 3), number(asked.setup_s, 3)
    scatter, contact = number(100.0 * asked.gain_sd, 2), number(machine.contact_sd_mm, 2)
    repeats = f"{asked.repeats} repeats at the least, {asked.max_logs} logs at the most"
    return [
        ("Tissue", f"{tissue.name}: {tissue.words}, {draws}"),
        ("Model", law if tissue.law == "kelvin-voigt" else tissue.law),
        ("Machine", f"{machine.name}{': ' * bool(machine.notes)}{machine.notes}"),
        ("Precision", f"{asked.interval}, for {_percent(asked.assurance)} of the tissues"),
        ("Allowed", f"{number(asked.max_depth_mm, 3)} mm, {number(asked.max_force_N, 4)} N; {repeats}"),
        ("Rest and mounting", f"{rest} s between logs, {mounting} s a specimen"),
        ("Scatter of logs", f"{scatter} % of the force, contact to {contact} mm"),
    ]


def _point(name: str, protocol: Front | Protocol, want: int) -> dict[str, Any]:
    return {
        "name": name,
        "minutes": protocol.seconds / MINUTE,
        "percent": 100.0 * protocol.precision[want].assured,
        "words": _indentations(protocol).replace("; ", "<br>"),
    }


def _payload(document: Design) -> dict[str, Any]:
    """Points of every wanted number's figure."""
    given = document.against
    figures = []
    for k, want in enumerate(document.asked.wants):
        front = sorted(document.front, key=lambda one: one.seconds)
        figures.append(
            {
                "words": parameter_words(want.name),
                "wanted": 100.0 * want.share,
                "front": [_point("least time", one, k) for one in front],
                "protocols": [
                    _point(str(rank), one, k) for rank, one in enumerate(document.protocols, start=1)
                ],
                "against": None
                if given is None or given.protocol is None
                else _point(given.name, given.protocol, k),
            }
        )
    return {"figures": figures}


def render_design(document: Design, *, created: str | None = None) -> str:
    """Write the page.

    ``document``: the document of ``schemas/design.schema.json``; ``created``: time stamp to print; without it
    equal input gives an equal page.  Returns HTML, UTF-8.
    """
    template = page_environment().get_template("design.html.j2")
    return template.render(
        title=f"Protocol for {document.tissue.name}",
        run=document,
        best=document.protocols[0],
        verdict=_verdict(document),
        facts=_facts(document),
        time=_time,
        percent=_percent,
        payload=_payload(document),
        created=created,
        style=asset("page.css") + asset("selfcheck.css"),
        scripts=[asset("boxes.js"), asset("design.js")],
        plotly=plotly_script(),
    )
