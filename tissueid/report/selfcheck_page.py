"""The page of ``tissueid calibrate``: rank histograms, ECDFs within their bands, coverage, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from tissueid.digits import number
from tissueid.documents.selfcheck import Parameter, SelfCheck
from tissueid.report.page import render_page
from tissueid.report.parts import Figure, band
from tissueid.report.wording import Verdict, counted, parameter_words

_KINDS = {"recipe": "Recipe", "study": "Study", "bundle": "Bundle"}
_NOISE = {"white": "white noise", "ar1": "AR(1) noise", "white+ar1": "white and AR(1) noise"}
_OWN_WORDS = {
    "sigma_N": "Noise, standard deviation",
    "phi": "Noise, correlation over one step",
    "gain_sd": "Spread of the logs' ln gains",
    "force_gain": "Gain of the force channel",
    "displacement_gain": "Gain of the displacement channel",
    "skew_s": "Force later than displacement [s]",
    "force_filter_s": "Time constant of the force filter [s]",
    "frame_compliance_mm_per_N": "Compliance of the frame [mm/N]",
}


def _words(name: str) -> str:
    """A checked number in plain words."""
    if name.startswith("force_N at "):
        return f"Force {name.removeprefix('force_N ')}"
    return _OWN_WORDS.get(name) or parameter_words(name)


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


def _facts(document: SelfCheck) -> list[tuple[str, str]]:
    model, protocol, simulations = document.model, document.protocol, document.simulations
    law = (
        f"{counted(model.branches, 'branch', 'es')}, K of degree {model.stiffness_degree}, "
        f"{model.static_pooling} static, to {number(model.depth_mm, 3)} mm"
    )
    program = (
        f"{protocol.words}; {counted(protocol.logs, 'log')}, {protocol.samples:,} samples, "
        f"step {number(protocol.step_s, 3)} s, longest {number(protocol.duration_s, 3)} s, "
        f"contact known to {number(protocol.contact_sd_mm, 2)} mm"
    )
    runs = (
        f"{simulations.done}, {len(simulations.failed)} without a posterior; sampler {simulations.sampler}, "
        f"seed {simulations.seed}, {number(simulations.median_seconds, 2)} s each"
    )
    return [
        (_KINDS[document.source.kind], document.source.path),
        ("Specimen", document.source.specimen),
        ("Model", law),
        ("Noise", _NOISE[document.noise.model]),
        ("Interval", document.interval),
        ("Protocol", program),
        ("Simulations", runs),
    ]


def _figures(document: SelfCheck, one: Parameter) -> list[Figure]:
    """ECDF difference of the ranks of a number, and their histogram."""
    bands, total = document.bands, document.simulations.done - len(document.simulations.failed)
    x = [0, *bands.points, 1]

    def difference(counts: Sequence[int]) -> list[float]:
        return [0, *(count / total - z for count, z in zip(counts, bands.points, strict=True)), 0]

    traces: list[dict[str, Any]] = []
    for found, words, faint in ((bands.percent_99, "99 %", 0.25), (bands.percent_95, "95 %", 0.35)):
        lower, upper = band(x, difference(found.low), difference(found.high), faint, name=words)
        traces += [lower, {**upper, "showlegend": True}]
    edge: dict[str, Any] = {
        "mode": "lines",
        "name": "99 % over all",
        "legendgroup": "family",
        "hoverinfo": "skip",
    }
    edge |= {"line": {"ink": "soft", "width": 1, "dash": "dash"}}
    for ends, shown in ((bands.family.low, False), (bands.family.high, True)):
        traces.append({**edge, "x": x, "y": difference(ends), "showlegend": shown})
    said: dict[str, Any] = {"name": "ranks", "hovertemplate": "z %{x:.2f}: %{y:.4f}<extra></extra>"}
    stepped = {"ink": "model", "width": 2, "shape": "hv"}
    traces.append({**said, "x": x, "y": difference(one.ecdf), "mode": "lines", "line": stepped})
    bins = len(one.histogram)
    bars: dict[str, Any] = {
        "x": [(i + 0.5) / bins for i in range(bins)],
        "y": one.histogram,
        "width": 0.9 / bins,
    }
    bars |= {"type": "bar", "marker": {"ink": "data"}, "name": "simulations", "showlegend": False}
    level: dict[str, Any] = {
        "x": [0, 1],
        "y": [total / bins] * 2,
        "mode": "lines",
        "line": {"ink": "model", "width": 1.6},
    }
    level |= {"showlegend": False, "hoverinfo": "skip"}
    layout = {"xaxis": {"range": [0, 1]}}
    return [
        Figure("ECDF difference", "z", "ECDF − z", traces, layout),
        Figure(
            "Ranks",
            "Rank, as a share of the draws",
            "Simulations",
            [{**bars, "hovertemplate": "%{y} ranks<extra></extra>"}, level],
            layout,
        ),
    ]


def render_selfcheck(document: SelfCheck, *, created: str | None = None) -> str:
    """Write the page."""
    views = [
        {"id": f"parameter-{k + 1}", "words": _words(one.name), "data": one}
        for k, one in enumerate(document.parameters)
    ]
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
        facts=_facts(document),
        heads=["Number", "Verdict", *levels, "Mean z", "Spread", "Contraction"],
        views=views,
        prior_words=_words,
        payload=[one.payload() for checked in document.parameters for one in _figures(document, checked)],
        created=created,
    )
