"""The page of ``tissueid calibrate``: rank histograms, ECDFs within their bands, coverage, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from tissueid.documents.selfcheck import Parameter, SelfCheck
from tissueid.report.page import render_page
from tissueid.report.parts import DASHED, Figure, band, trace
from tissueid.report.wording import Verdict, nuisance_words


def _words(name: str) -> str:
    """A checked number in plain words."""
    if name.startswith("force_N at "):
        return f"Force {name.removeprefix('force_N ')}"
    return nuisance_words(name)


def _verdict(document: SelfCheck) -> Verdict:
    simulations = document.simulations
    done = simulations.done - len(simulations.failed)
    family = f"over {len(document.parameters)} numbers and {done} simulations"
    if document.verdict.calibrated:
        return Verdict(
            "ok",
            "Calibrated",
            f"Ranks and coverage keep their family-wise 99 % bands {family}: for this protocol, model and "
            "noise the intervals hold what they claim. They say nothing of a tissue that the model does not "
            "describe.",
        )
    return Verdict(
        "serious",
        "Not calibrated",
        f"Ranks or coverage leave their family-wise 99 % bands {family}: do not believe these intervals for "
        "this protocol.",
    )


def _figures(document: SelfCheck, one: Parameter) -> list[Figure]:
    """ECDF difference of the ranks of a number, and their histogram."""
    bands, total = document.bands, document.simulations.done - len(document.simulations.failed)
    x = [0, *bands.points, 1]

    def difference(counts: Sequence[int]) -> list[float]:
        return [0, *(count / total - z for count, z in zip(counts, bands.points, strict=True)), 0]

    traces = []
    for found, words, faint in ((bands.percent_99, "99 %", 0.25), (bands.percent_95, "95 %", 0.35)):
        lower, upper = band(x, (difference(found.low), difference(found.high)), faint, name=words)
        traces += [lower, {**upper, "showlegend": True}]
    edge = {"name": "99 % over all", "legendgroup": "family", "hoverinfo": "skip", "line": DASHED}
    for ends, shown in ((bands.family.low, False), (bands.family.high, True)):
        traces.append(trace(x, difference(ends), "lines", showlegend=shown, **edge))
    stepped = {"ink": "model", "width": 2, "shape": "hv"}
    said = {"name": "ranks", "hovertemplate": "z %{x:.2f}: %{y:.4f}<extra></extra>"}
    traces.append(trace(x, difference(one.ecdf), "lines", line=stepped, **said))
    bins = len(one.histogram)
    look: dict[str, Any] = {
        "type": "bar",
        "width": 0.9 / bins,
        "marker": {"ink": "data"},
        "showlegend": False,
    }
    said = {"name": "simulations", "hovertemplate": "%{y} ranks<extra></extra>"}
    bars = trace([(i + 0.5) / bins for i in range(bins)], one.histogram, **look, **said)
    line = {"ink": "model", "width": 1.6}
    level = trace([0, 1], [total / bins] * 2, "lines", line=line, showlegend=False, hoverinfo="skip")
    layout = {"xaxis": {"range": [0, 1]}}
    return [
        Figure("ECDF difference", "z", "ECDF − z", traces, layout),
        Figure("Ranks", "Rank, as a share of the draws", "Simulations", [bars, level], layout),
    ]


def render_selfcheck(document: SelfCheck, *, created: str | None = None) -> str:
    """Write the page."""
    level = Markup("{:g} % interval<br>{:.1f} to {:.1f}")
    levels = [
        level.format(100 * row.level, 100 * row.low, 100 * row.high)
        for row in document.parameters[0].coverage
    ]
    return render_page(
        "selfcheck",
        title=f"Calibration of {document.source.specimen}",
        run=document,
        verdict=_verdict(document),
        heads=["Number", "Verdict", *levels, "Mean z", "Spread", "Contraction"],
        words=_words,
        figures=[one for checked in document.parameters for one in _figures(document, checked)],
        created=created,
    )
