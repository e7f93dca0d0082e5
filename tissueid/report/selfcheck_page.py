"""The page of ``tissueid calibrate``: rank histograms, ECDFs within their bands, coverage, verdict.

Self-contained like the report.  Every figure has its numbers in the tables beside it.
"""

from __future__ import annotations

from tissueid.digits import number
from tissueid.documents.selfcheck import SelfCheck
from tissueid.report.page import asset, page_environment, plotly_script
from tissueid.report.wording import Verdict, parameter_words

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
    plural = "es" if model.branches != 1 else ""
    law = (
        f"{model.branches} branch{plural}, K of degree {model.stiffness_degree}, "
        f"{model.static_pooling} static, to {number(model.depth_mm, 3)} mm"
    )
    program = (
        f"{protocol.words}; {protocol.logs} log{'s' * (protocol.logs > 1)}, "
        f"{protocol.samples:,} samples, "
        f"step {number(protocol.step_s, 3)} s, longest {number(protocol.duration_s, 3)} s, "
        f"contact known to {number(protocol.contact_sd_mm, 2)} mm"
    )
    runs = (
        f"{simulations.done}, {len(simulations.failed)} without a posterior; sampler "
        f"{simulations.sampler}, seed {simulations.seed}, "
        f"{number(simulations.median_seconds, 2)} s each"
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


def render_selfcheck(document: SelfCheck, *, created: str | None = None) -> str:
    """Write the page.

    ``document``: the document of ``schemas/selfcheck.schema.json``; ``created``: time stamp to print; without
    it equal input gives an equal page.  Returns HTML, UTF-8.
    """
    views = [
        {"id": f"parameter-{k + 1}", "words": _words(one.name), "data": one}
        for k, one in enumerate(document.parameters)
    ]
    simulations = document.simulations
    payload = {
        "simulations": simulations.done - len(simulations.failed),
        "bands": document.bands,
        "parameters": [
            {"words": view["words"], "ecdf": one.ecdf, "histogram": one.histogram}
            for view, one in zip(views, document.parameters, strict=True)
        ],
    }
    return (
        page_environment()
        .get_template("selfcheck.html.j2")
        .render(
            title=f"Calibration of {document.source.specimen}",
            run=document,
            verdict=_verdict(document),
            facts=_facts(document),
            views=views,
            levels=[row.level for row in document.parameters[0].coverage],
            prior_words=_words,
            payload=payload,
            created=created,
            style=asset("page.css") + asset("selfcheck.css"),
            scripts=[asset("boxes.js"), asset("selfcheck.js")],
            plotly=plotly_script(),
        )
    )
