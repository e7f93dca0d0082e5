"""The page of ``tissueid rupture``: what broke the tissue, what speed has to do with it, what may be said."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tissueid.digits import number
from tissueid.documents.rupture import Rupture
from tissueid.report.page import render_page
from tissueid.report.parts import LOG_BOTH, LOG_X, Figure, trace
from tissueid.report.wording import S_PER_MIN, Verdict, flag_remarks

CRITERION_WORDS: Mapping[str, str] = {
    "work": "Total work",
    "weighted-force": "Weighted force",
    "stored-energy": "Stored energy",
    "depth": "Depth",
    "none": "None",
}
_INKS = {"work": "data", "weighted-force": "model", "stored-energy": "aside", "depth": "serious"}
_AT = "%{x:.4g} mm/min<extra></extra>"


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


def _against_speed(document: Rupture, key: str, title: str, unit: str) -> Figure:
    """Force or work at rupture: tests of each specimen joined, and the mean at each speed."""
    line = {"color": {"ink": "data", "faint": 0.35}, "width": 1}
    look = {"line": line, "marker": {"ink": "data", "size": 6}, "showlegend": False}
    lines = []
    for name in dict.fromkeys(one.specimen for one in document.tests):
        own = [one for one in document.tests if one.specimen == name and one.ruptured]
        own.sort(key=lambda one: one.speed_mm_s)
        speeds, values = [S_PER_MIN * one.speed_mm_s for one in own], [getattr(one, key) for one in own]
        said = {"text": [name] * len(own), "hovertemplate": f"%{{text}}: %{{y:.4g}} {unit} at {_AT}"}
        lines.append(trace(speeds, values, "lines+markers", **look, **said))
    known = [row for row in document.speeds if getattr(row.mean, key) is not None]
    speeds, means = [S_PER_MIN * row.speed_mm_s for row in known], [getattr(row.mean, key) for row in known]
    bars: dict[str, Any] = {"type": "data", "array": [getattr(row.sd, key) or 0 for row in known]}
    bars |= {"ink": "model", "thickness": 2, "width": 6}
    look = {"marker": {"ink": "model", "size": 10, "symbol": "diamond"}, "error_y": bars}
    said = {"name": "mean ± SD", "hovertemplate": f"mean %{{y:.4g}} {unit} at {_AT}"}
    mean = trace(speeds, means, "markers", **look, **said)
    layout = {**LOG_X, "yaxis": {"rangemode": "tozero"}}
    return Figure(title, "Speed [mm/min]", f"{title} [{unit}]", [*lines, mean], layout)


def _reached(document: Rupture) -> Figure:
    """Each test's measure over the median of every criterion."""
    tests, likeliest = document.tests, max(document.criteria, key=lambda row: row.ln_evidence).criterion
    symbols = ["circle" if one.ruptured else "circle-open" for one in tests]
    traces = []
    for k, row in enumerate(document.criteria):
        words, of = CRITERION_WORDS[row.criterion], f"{number(row.median)} {row.unit}"
        key = row.criterion.replace("-", "_")
        # side by side, so that marks of one speed do not hide each other
        speeds = [S_PER_MIN * one.speed_mm_s * 1.06 ** (k - 1.5) for one in tests]
        shares = [getattr(one.measures, key).value / row.median for one in tests]
        look = {
            "visible": True if row.criterion in (likeliest, "depth", "work") else "legendonly",
            "marker": {"ink": _INKS[row.criterion], "size": 8, "symbol": symbols},
            "text": [one.specimen for one in tests],
            "hovertemplate": f"%{{text}}: %{{y:.3f}} of {of}<extra>{words}</extra>",
        }
        traces.append(trace(speeds, shares, "markers", name=words, **look))
    level = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 1, "y1": 1}
    layout = {**LOG_BOTH, "shapes": [{**level, "line": {"ink": "soft", "width": 1}}]}
    return Figure("Criteria", "Speed [mm/min]", "Reached over median", traces, layout)


def render_rupture(document: Rupture, *, created: str | None = None) -> str:
    """Write the page."""
    return render_page(
        "rupture",
        title=f"Rupture in {sum(one.ruptured for one in document.tests)} of {len(document.tests)} tests",
        run=document,
        verdict=_verdict(document),
        remarks=flag_remarks(document.flags),
        words=CRITERION_WORDS,
        per_minute=S_PER_MIN,
        figures=[
            _against_speed(document, "force_N", "Force at rupture", "N"),
            _against_speed(document, "work_N_mm", "Work to rupture", "N mm"),
            _reached(document),
        ],
        created=created,
    )
