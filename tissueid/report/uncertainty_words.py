"""How sure a result is, in words: intervals, sampler, noise, priors, sources, other models, checks.

Every interval is said to be calibrated for the stated model and noise; where the residuals contradict them
(:func:`misfit_alarm`) no interval stands on the first screen.  What is not identified has no interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tissueid.digits import NOT_IDENTIFIED, number, together
from tissueid.report.interval_words import Bar, bar_of, bar_scale
from tissueid.report.wording import misfit_raised, parameter_words, unit_words

__all__ = ["HEADLINE", "IntervalRow", "misfit_alarm", "reported_order", "uncertainty_view"]

#: What a reader looks for first; the common scale of the bars is theirs.
HEADLINE = ("viscosity", "relaxation_time", "static_1", "stiffness_0")
_ORDER = ("viscosity", "relaxation_time", "stiffness", "static")
#: Below this the data said little.
LITTLE_SHRINKAGE = 0.1
#: Sources in the order of the stacked bar: of the recordings first, then of the machine.
SOURCES = (
    *("noise", "scatter between logs", "contact points"),
    *("force gain", "displacement gain", "time skew", "force filter", "frame"),
)
_NUISANCE_WORDS: Mapping[str, str] = {
    "force_gain": "Gain of the force",
    "displacement_gain": "Gain of the displacement",
    "skew_s": "Time skew of the force [s]",
    "force_filter_s": "Filter of the force [s]",
    "frame_compliance_mm_per_N": "Compliance of the frame [mm/N]",
    "sigma_N": "Standard deviation of the noise [N]",
    "ln_sigma": "Noise, ln of its standard deviation [N]",
    "phi": "Correlation of the noise",
    "gain_sd": "Scatter of the gain between logs",
    "ln_gain_sd": "Scatter of the gain between logs, ln",
    **{f"ln_relaxation_time_{k}": f"Relaxation time of branch {k}, ln [s]" for k in (1, 2, 3)},
}
_VERDICTS: Mapping[str, tuple[str, str]] = {
    "chosen": ("ok", "chosen"),
    "undecided": ("note", "as good, undecided"),
    "worse": ("caution", "worse"),
    "beside": ("note", "beside: compared only"),
}


@dataclass(frozen=True, slots=True)
class IntervalRow:
    """One parameter with its intervals.

    Attributes
    ----------
    name, words, symbol, unit : str
    value, statistical, total : str
        As printed; empty where there is none.
    bar : Bar or None
        Where dot and bars stand; ``None`` where nothing is identified.
    """

    name: str
    words: str
    symbol: str
    unit: str
    value: str
    statistical: str
    total: str
    bar: Bar | None


def reported_order(parameters: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Parameters in the order in which data determine them: viscosity, time, stiffness, static force."""

    def place(entry: Mapping[str, Any]) -> int:
        return next(i for i, start in enumerate(_ORDER) if entry["name"].startswith(start))

    return sorted(parameters, key=place)


def misfit_alarm(specimen: Mapping[str, Any]) -> list[str]:
    """What the residuals show that model and noise can't make; empty without an alarm."""
    if not misfit_raised(specimen):
        return []
    return [check["message"].rstrip(".") for check in specimen["misfit"]["checks"] if check["raised"]]


def _rows(specimen: Mapping[str, Any]) -> tuple[list[IntervalRow], float]:
    entries = reported_order(specimen["parameters"])
    known = [entry for entry in entries if entry["ci95"] is not None]
    scale = bar_scale([entry for entry in known if entry["name"].startswith(HEADLINE)] or known)
    return [_row(entry, scale) for entry in entries], scale


def _row(entry: Mapping[str, Any], scale: float) -> IntervalRow:
    value = number(entry["value"]) if entry["identified"] else NOT_IDENTIFIED
    if "withheld" in entry["detail"]:
        value = f"{number(entry['value'])}, no interval"
    statistical, total, bar = "", "", None
    if entry["ci95"] is not None:
        bar = bar_of(entry, scale)
        ends = [*entry["ci95"], *(entry["ci95_total"] or [])]
        value, *texts = together([entry["value"], *ends], entry["sd"])
        statistical, total = f"{texts[0]} to {texts[1]}", " to ".join(texts[2:])
    return IntervalRow(
        name=entry["name"],
        words=parameter_words(entry["name"]),
        symbol=entry["symbol"],
        unit=unit_words(entry["unit"]),
        value=value,
        statistical=statistical,
        total=total,
        bar=bar,
    )


def _sampler_sentence(specimen: Mapping[str, Any]) -> str:
    sampler = specimen["sampler"]
    detail = sampler["detail"]
    size = [
        f"{detail[key]:,} {key}"
        for key in ("walkers", "steps")
        if isinstance(detail.get(key), int) and sampler["name"] == "emcee"
    ]
    known = [entry for entry in specimen["parameters"] if entry["ess_bulk"] is not None]
    effective = [entry[key] for entry in known for key in ("ess_bulk", "ess_tail") if entry[key] is not None]
    worst = max((entry["r_hat"] for entry in known if entry["r_hat"] is not None), default=None)
    parts = [*size, f"{sampler['draws']:,} draws kept"]
    if effective:
        parts.append(f"at least {int(min(effective)):,} effective draws of every parameter")
    if worst is not None:
        parts.append(f"R-hat at most {worst:.3f}")
    parts.append(f"{100 * sampler['acceptance']:.0f} % of the proposals accepted")
    end = "converged" if sampler["converged"] else "not converged"
    reason = detail.get("reason")
    why = f": {reason}" if reason and not sampler["converged"] else ""
    return f"Sampled by {sampler['name']}: {', '.join(parts)}; {end}{why}."


def _convergence_rows(specimen: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Effective draws and R-hat of every parameter that has them."""
    return [
        {
            "words": parameter_words(entry["name"]),
            "symbol": entry["symbol"],
            "bulk": entry["ess_bulk"],
            "tail": entry["ess_tail"],
            "r_hat": entry["r_hat"],
        }
        for entry in reported_order(specimen["parameters"])
        if entry["ess_bulk"] is not None
    ]


def _no_total(specimen: Mapping[str, Any]) -> str:
    """Why there is no total interval though the machine was asked about; empty where there is one."""
    told = specimen["sampler"]["detail"].get("total")
    if not isinstance(told, Mapping) or told.get("converged", True):
        return ""
    worth = told.get("worth")
    share = "" if worth is None else f": the draws are worth {number(worth, 2)} independent ones"
    return (
        f"what is not known of the machine bends the model too far from the recordings to be sampled{share}"
    )


def _noise_sentence(specimen: Mapping[str, Any]) -> str:
    noise, force = specimen["noise"], specimen["units"]["force"]
    size = f"{number(noise['sigma_N'], 3)} {force}"
    if noise["model"] == "white" or not noise["phi"]:
        return f"Noise of the force: white, {size}: each sample errs on its own."
    kind = "correlated (AR(1))" if noise["model"] == "ar1" else "white and correlated (AR(1)) together"
    step = number(noise["reference_step_s"], 3)
    return (
        f"Noise of the force: {kind}, {size} in all; the correlated part keeps {noise['phi']:.3g} of itself "
        f"over {step} s."
    )


def _prior_rows(specimen: Mapping[str, Any]) -> list[dict[str, Any]]:
    rows = []
    for row in specimen["priors"]:
        shrinkage = row["shrinkage"]
        after, error = (
            together([row["posterior_mean"], row["posterior_sd"]], row["posterior_sd"])
            if row["posterior_mean"] is not None and row["posterior_sd"] is not None
            else ("–", "–")
        )
        rows.append(
            {
                "name": row["name"],
                "words": _NUISANCE_WORDS.get(row["name"]) or parameter_words(row["name"]),
                "prior": row["prior"],
                "stated": row["stated"],
                "posterior": f"{after} ± {error}",
                "width": 100 * min(max(shrinkage or 0.0, 0.0), 1.0),
                "shrinkage": "–" if shrinkage is None else f"{100 * shrinkage:.0f} %".replace("-", "−"),
                "little": shrinkage is not None and shrinkage < LITTLE_SHRINKAGE,
            }
        )
    return rows


def _budget(specimen: Mapping[str, Any]) -> dict[str, Any] | None:
    """Sources by parameter: shares for the stacked bars, standard deviations for the table."""
    found: dict[str, dict[str, Mapping[str, Any]]] = {}
    for row in specimen["budget"]:
        found.setdefault(row["parameter"], {})[row["source"]] = row
    every = [entry for entry in reported_order(specimen["parameters"]) if entry["name"] in found]
    present = {row["source"] for row in specimen["budget"]}
    sources = [source for source in SOURCES if source in present]
    beside = [source for source in ("total", "cluster bootstrap") if source in present]
    rows = []
    for entry in every:
        own = found[entry["name"]]
        shares = [
            {"source": source, "place": SOURCES.index(source), "percent": 100 * own[source]["share"]}
            for source in sources
            if source in own and own[source]["share"]
        ]
        rows.append(
            {
                "words": parameter_words(entry["name"]),
                "symbol": entry["symbol"],
                "unit": unit_words(entry["unit"]),
                "identified": entry["identified"],
                "shares": shares,
                "largest": max(shares, key=lambda share: share["percent"], default=None),
                "sd": [
                    number(own[source]["sd"], 2) if source in own else "–" for source in (*sources, *beside)
                ],
            }
        )
    places = [(source, SOURCES.index(source)) for source in sources]
    return {"sources": places, "beside": beside, "rows": rows} if rows else None


def _difference(value: float | None, error: float | None) -> str:
    if value is None:
        return "–"
    if value == 0.0:
        return "0"
    if not error:
        return number(value, 3)
    value_text, error_text = together([value, error], error)
    return f"{value_text} ± {error_text}"


def _comparison(specimen: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [
        {
            "model": row["model"],
            "cells": [
                _difference(row[key], row[f"{key}_se"]) for key in ("log_evidence", "elpd_log", "elpd_speed")
            ],
            "level": _VERDICTS[row["verdict"]][0],
            "verdict": _VERDICTS[row["verdict"]][1],
            "chosen": row["verdict"] == "chosen",
        }
        for row in specimen["model_comparison"]
    ]


def uncertainty_view(specimen: Mapping[str, Any]) -> dict[str, Any] | None:
    """What the template shows of a specimen's uncertainty; ``None`` where nothing was sampled.

    Parameters
    ----------
    specimen : mapping
        One of ``specimens`` of identification.json.
    """
    if specimen["sampler"] is None:
        return None
    rows, scale = _rows(specimen)
    return {
        "alarm": misfit_alarm(specimen),
        "raised": misfit_raised(specimen),
        "rows": rows,
        "scale": f"{100 * scale:g}",
        "total": any(row.total for row in rows),
        "no_total": _no_total(specimen),
        "normalised": (specimen["units"]["length"], specimen["units"]["force"]) != ("mm", "N"),
        "converged": specimen["sampler"]["converged"],
        "sampler": _sampler_sentence(specimen),
        "noise": _noise_sentence(specimen),
        "convergence": _convergence_rows(specimen),
        "priors": _prior_rows(specimen),
        "budget": _budget(specimen),
        "comparison": _comparison(specimen),
        "checks": [] if specimen["misfit"] is None else specimen["misfit"]["checks"],
    }
