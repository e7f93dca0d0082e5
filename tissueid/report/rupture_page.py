"""The page of ``tissueid rupture``: what broke the tissue, what speed has to do with it, what may be said.

Self-contained like the report.  Every figure has its numbers in the tables beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tissueid.digits import number
from tissueid.documents import plain
from tissueid.documents.rupture import Rupture, Speed
from tissueid.report.page import asset, page_environment, plotly_script
from tissueid.report.wording import Verdict, flag_remarks

S_PER_MIN = 60.0
CRITERION_WORDS: Mapping[str, str] = {
    "work": "Total work",
    "weighted-force": "Weighted force",
    "stored-energy": "Stored energy",
    "depth": "Depth",
    "none": "None",
}


def _verdict(document: Rupture) -> Verdict:
    decision, taken = document.decision, document.taken
    if taken == "none":
        said = "No rupture is written into the bundles."
    else:
        named = "" if document.asked == "auto" else ", as asked for"
        said = f"The bundles rupture by {CRITERION_WORDS[taken].lower()}{named}."
    reason = decision.reason[0].upper() + decision.reason[1:]
    if decision.answer == "decided":
        return Verdict("ok", f"Criterion: {decision.kind}", f"{reason}. {said}")
    title = "Undecided" if decision.answer == "undecided" else "None of the criteria"
    return Verdict("caution", title, f"{reason}. {said}")


def _with_sd(row: Speed, name: str) -> str:
    mean, sd = getattr(row.mean, name), getattr(row.sd, name)
    return number(mean) if sd is None else f"{number(mean)} ± {number(sd, 2)}"


def _payload(document: Rupture) -> dict[str, Any]:
    """The numbers behind the figures."""
    return {
        "tests": [
            {
                "specimen": one.specimen,
                "speed": S_PER_MIN * one.speed_mm_s,
                "ruptured": one.ruptured,
                "force": one.force_N,
                "work": one.work_N_mm,
                "measures": {name: measure["value"] for name, measure in plain(one.measures).items()},
            }
            for one in document.tests
        ],
        "speeds": [
            {
                "speed": S_PER_MIN * row.speed_mm_s,
                "force": [row.mean.force_N, row.sd.force_N],
                "work": [row.mean.work_N_mm, row.sd.work_N_mm],
            }
            for row in document.speeds
        ],
        "criteria": [
            {
                "name": row.criterion,
                "words": CRITERION_WORDS[row.criterion],
                "unit": row.unit,
                "median": row.median,
                "ci95": row.ci95,
            }
            for row in document.criteria
        ],
        "likeliest": max(document.criteria, key=lambda row: row.ln_evidence).criterion,
    }


def render_rupture(document: Rupture, *, created: str | None = None) -> str:
    """Write the page.

    ``document``: the document of ``schemas/rupture.schema.json``; ``created``: time stamp to print; without
    it equal input gives an equal page.  Returns HTML, UTF-8.
    """
    ruptured = sum(one.ruptured for one in document.tests)
    return (
        page_environment()
        .get_template("rupture.html.j2")
        .render(
            title=f"Rupture in {ruptured} of {len(document.tests)} tests",
            run=document,
            verdict=_verdict(document),
            remarks=flag_remarks(document.flags),
            words=CRITERION_WORDS,
            with_sd=_with_sd,
            per_minute=S_PER_MIN,
            interval=lambda ends: f"{number(ends[0])} to {number(ends[1])}",
            payload=_payload(document),
            created=created,
            style=asset("page.css") + asset("selfcheck.css"),
            plotly=plotly_script(),
            scripts=[asset("boxes.js"), asset("rupture.js")],
        )
    )
