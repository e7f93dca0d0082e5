"""A methods paragraph for a manuscript, and how to cite: every statement is of this run."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from markupsafe import Markup, escape

from tissueid.digits import number
from tissueid.documents.identification import Identification, Provenance, Specimen
from tissueid.report.wording import counted, depth_words, least_effective, reach, tissue_sentence

#: As in CITATION.cff.
AUTHORS = "The tissueid developers"
TITLE = "tissueid: identification of soft-tissue contact models from test-machine recordings"
_POOLING: Mapping[str, str] = {
    "partial": "shared by all trials of a specimen, each with a gain and a contact offset of its own whose "
    "spread was estimated from the data (partial pooling)",
    "shared": "the same for all trials",
    "scaled": "one, each trial deviating from it by its gain, contact, relaxation and shape",
}
_NOISE: Mapping[str, str] = {
    "white": "white noise",
    "ar1": "first-order autoregressive noise",
    "white+ar1": "white and first-order autoregressive noise together",
}
_NUMBERS = ("no", "one", "two", "three")
_FOLD = ("constant", "linear in depth", "quadratic in depth")
#: Libraries whose authors ask to be cited.
_LIBRARIES: Mapping[str, str] = {
    "emcee": "Foreman-Mackey et al. 2013, doi 10.1086/670067",
    "numpy": "Harris et al. 2020, doi 10.1038/s41586-020-2649-2",
    "scipy": "Virtanen et al. 2020, doi 10.1038/s41592-019-0686-2",
}


def subscripted(text: str) -> Markup:
    """Symbols with their index below them: ``F_s``, ``η_j``; everything else is escaped."""
    return Markup(re.sub(r"\b([FKsbaητ])_([sj]\d?|\d)\b", r"\1<sub>\2</sub>", str(escape(text))))  # noqa: S704


def citation(version: str) -> dict[str, str]:
    """Citation of the program, as a reference and for BibTeX."""
    return {
        "text": f"{AUTHORS}. {TITLE}. Version {version}.",
        "bibtex": (
            f"@software{{tissueid,\n  author  = {{{{{AUTHORS}}}}},\n  title   = {{{TITLE}}},\n"
            f"  version = {{{version}}}\n}}"
        ),
    }


def _recordings(specimen: Specimen, run: Identification) -> str:
    trials, units = specimen.trials, specimen.units
    deep = depth_words(specimen.validity.depth_mm, units)
    held = len({(row.path, row.sheet) for row in specimen.relaxation})
    holds = f", {held} of them with a hold," if held else ""
    return (
        f"{counted(len(trials), 'indentation trial')} of specimen {specimen.specimen}{holds} loaded at "
        f"{reach(specimen.validity.speeds_mm_s)} {units.length}/s to {deep} "
        f"({specimen.n_samples:,} samples) were analysed with {_programs(run)}."
    )


def _programs(run: Identification) -> str:
    """The program and the libraries behind it, with their versions and papers."""
    known = run.provenance.versions or {}
    cited = {name: f" [{paper}]" for name, paper in _LIBRARIES.items()}
    names = [f"{name} {version}{cited.get(name, '')}" for name, version in sorted(known.items())]
    return f"tissueid {run.provenance.tissueid}" + (f" ({', '.join(names)})" if names else "")


def _model_words(specimen: Specimen) -> str:
    model = specimen.model
    count = model.branches
    return (
        f"with a static force of degree {model.static_degree} and {_NUMBERS[count]} relaxing "
        f"branch{'es' if count != 1 else ''} whose stiffness is {_FOLD[model.stiffness_degree]} "
        f"(degree {model.stiffness_degree})"
    )


def _choice_words(specimen: Specimen, run: Provenance) -> str:
    """Words on the choice of branches and of the degree of K."""
    if specimen.model.key != "kelvin-voigt":
        return "The contact model was set in advance."
    wanted = {"branches": "the number of branches", "stiffness_degree": "the degree of K"}
    free = [words for key, words in wanted.items() if run.options.get(key, "auto") == "auto"]
    if not free or not specimen.selection:
        return "The number of branches and the degree of K were set in advance."
    words = " and ".join(free)
    told = f"{words[0].upper()}{words[1:]} {'were' if len(free) > 1 else 'was'} chosen by predicting data"
    given = [words for words in wanted.values() if words not in free]
    return f"{told} that were held out" + "".join(f"; {one} was set in advance" for one in given) + "."


def _missed_words(specimen: Specimen) -> str:
    """Words on the misfit beside the noise, and its effect on the intervals."""
    noise = specimen.noise
    if noise is None or not noise.discrepant:
        return ""
    unit = specimen.units.force
    return (
        f" The residual, {number(noise.sigma_N, 2)} {unit}, is no noise of these recordings: where "
        f"nothing happens they show {number(noise.measured_N, 2)} {unit}. Intervals count "
        f"{number(noise.samples_per_independent, 2)} samples as an independent one."
    )


def _decided_words(run: Provenance) -> str:
    """Words on settings of the user that change the numbers."""
    told = []
    if run.options.get("contact_displacement_mm") is not None:
        told.append(f"Contact was set at {run.options['contact_displacement_mm']:g} mm.")
    if run.options.get("compression_sign") is not None:
        sign = "positive" if run.options["compression_sign"] > 0 else "negative"
        told.append(f"Compression was set as {sign} displacement.")
    if run.options.get("unloading"):
        told.append("Retracts and cycles were fitted as well.")
    return "".join(f" {one}" for one in told)


def _fit_words(specimen: Specimen, run: Provenance) -> str:
    model, noise = specimen.model, specimen.noise
    assumed = _NOISE["white" if noise is None else noise.model]
    found = " (found from the residuals)" if run.options.get("noise") == "auto" else ""
    return (
        f"The static force was {_POOLING[model.static_pooling]}. {_choice_words(specimen, run)} The "
        f"model was fitted to the recorded displacement through its whole history by "
        f"{specimen.optimisers.method}, under {assumed} of the force{found}, within the set of passive "
        "tissues (F_s and K nowhere negative on the fitted depth). A relaxation time is reported where its "
        "95 % profile-likelihood interval is closed and narrower than a factor e."
        f"{_missed_words(specimen)}{_decided_words(run)}"
    )


def _sampling_words(specimen: Specimen, run: Provenance) -> str:
    sampler = specimen.sampler
    if sampler is None:
        return "Errors are standard errors at the optimum; no posterior was sampled."
    known = [entry for entry in specimen.parameters if entry.r_hat is not None]
    worst = max((entry.r_hat for entry in known if entry.r_hat is not None), default=None)
    least = least_effective(specimen)
    told = [f"{sampler.draws:,} draws"]
    if run.options.get("draws") is not None:
        told[0] += f", for {run.options['draws']:,} effective ones"
    seed = sampler.detail.get("seed", run.options.get("seed"))
    if seed is not None:
        told.append(f"seed {seed}")
    if worst is not None:
        told.append(f"R-hat at most {worst:.3f}")
    if least is not None:
        told.append(f"at least {least:,} effective draws")
    return (
        f"The posterior, with the linear parameters integrated, was sampled by {sampler.name} "
        f"({'; '.join(told)}). {_interval_words(specimen)}"
    )


def _interval_words(specimen: Specimen) -> str:
    """Words on the intervals, and on numbers without one."""
    total = any(entry.ci95_total is not None for entry in specimen.parameters)
    both = "statistical (noise, scatter between trials, contact points)"
    if total:
        both += (
            " and total, which adds what is not known of the machine (gains of force and displacement, time "
            "skew, force filter, frame compliance)"
        )
    end = "" if specimen.sampler is None or specimen.sampler.converged else " The sampler did not converge."
    withheld = [one.symbol for one in specimen.parameters if "withheld" in one.detail]
    if withheld:
        end += f" No interval is given for {', '.join(withheld)}, whose values and draws do not agree."
    if any("optimum" in one.detail for one in specimen.parameters):
        end += " Values are those of the tissue nearest to the optimum that lies inside every interval."
    return f"Intervals are 95 % credible intervals: {both}.{end}"


def _result_words(specimen: Specimen) -> str:
    sentence = tissue_sentence(specimen)
    left = f"{100 * specimen.nrmsd.range:.2f} % of the force range"
    rmse = f"{number(specimen.nrmsd.rmse_N, 3)} {specimen.units.force}"
    name = specimen.specimen
    return f"Of specimen {name}, {sentence[0].lower()}{sentence[1:]} The model left {left} ({rmse})."


def methods_view(specimen: Specimen, run: Identification) -> dict[str, Any]:
    """Methods paragraph ``before`` and ``after`` the equations, their ``degree``, and all as ``plain``."""
    made, key = run.provenance, specimen.model.key
    recordings = f"{_recordings(specimen, run)} Contact force was described by"
    ended = [_sampling_words(specimen, made), _result_words(specimen)]
    if key != "kelvin-voigt":
        # a law that is not the paper's stands without its equations
        degree, terms = None, []
        listed = "(static law, stiffness and relaxation as tissueid models lists them)"
        before = f"{recordings} the contact model {key} {listed}."
        after = [_fit_words(specimen, made), *ended]
    else:
        degree = specimen.model.stiffness_degree
        before = f"{recordings} a modified Kelvin-Voigt model {_model_words(specimen)}:"
        where = (
            "where x is the depth of the tool below the contact point, F_s the static force and s_j the "
            "stretch of the spring of branch j, zero at rest; the viscosity of a branch is η_j = τ_j K_j"
        )
        half = ", at half the fitted depth" if degree else ""
        after = [f"{where}{half}. {_fit_words(specimen, made)}", *ended]
        powers = "".join(f" + b_j{n} {x}" for n, x in ((1, "x"), (2, "x²")) if degree >= n)
        terms = [
            "F(t) = F_s(x) + Σ_j K_j(x) s_j(t),   τ_j ds_j/dt + s_j = τ_j dx/dt",
            f"F_s(x) = a_1 x + a_2 x² + a_3 x³,   K_j(x) = b_j0{powers}",
        ]
    return {
        "before": before,
        "after": after,
        "degree": degree,
        "plain": "\n\n".join([before, *terms, *after]),
    }
