"""Uncertainty in words: intervals, sampler, noise, priors, sources, other models, checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tissueid.digits import NOT_IDENTIFIED, number, together, with_error
from tissueid.documents.identification import BudgetRow, Estimate, Specimen
from tissueid.quantities import EFFECTIVE_SD, EFFECTIVE_SLOPE
from tissueid.report import wording

#: Kinds of parameters in the order of the publication, and what they are called beside a symbol.
_KINDS = {
    "relaxation_time": "Relaxation time",
    "static": "Static",
    "stiffness": "Dynamic",
    "viscosity": "Viscosity",
    "relaxation": "Relaxation",
    "damping": "Damping",
}
_INTERVALS = {"ci95": "95 % statistical", "ci95_total": "95 % total"}
_FOLD = ("b_0", "b_0 + b_1 x", "b_0 + b_1 x + b_2 x²")
_POOLING: Mapping[str, str] = {
    "partial": "static curve shared, with a gain and contact offset a log",
    "shared": "one static curve",
    "scaled": "a curve of depth a log, static force and K in proportion, and a factor of its times",
}
#: Below this the data said little.
LITTLE_SHRINKAGE = 0.1
#: Sources in the order of the stacked bar: of the recordings first, then of the machine.
SOURCES = (
    *("noise", "scatter between logs", "contact points"),
    *("force gain", "displacement gain", "time skew", "force filter", "frame"),
)


@dataclass(frozen=True, slots=True)
class IntervalRow:
    """One parameter, or those of one kind that are not identified, with its intervals."""

    words: str
    symbols: tuple[str, ...]
    unit: str
    value: str  # as printed
    intervals: tuple[str, ...]  # one a column; empty where there is none


def reported_order(parameters: Sequence[Estimate]) -> list[Estimate]:
    """Parameters in the order of the publication: relaxation time, static, stiffness, viscosity, damping."""

    def place(entry: Estimate) -> int:
        return next(i for i, start in enumerate(_KINDS) if entry.name.startswith(start))

    return sorted(parameters, key=place)


def _rows(specimen: Specimen, columns: Sequence[str], *, bare: bool = False) -> list[IntervalRow]:
    """Parameters with these intervals, ``bare`` without any error; what is not identified shares a row."""
    rows: dict[str, IntervalRow] = {}
    for entry in reported_order(specimen.parameters):
        kind = next(words for start, words in _KINDS.items() if entry.name.startswith(start))
        if entry.identified:
            rows[entry.name] = _row(entry, kind, columns, bare=bare)
        else:
            symbols = (*(rows[kind].symbols if kind in rows else ()), entry.symbol)
            rows[kind] = IntervalRow(kind, symbols, "", NOT_IDENTIFIED, ())
    return list(rows.values())


def _row(entry: Estimate, words: str, columns: Sequence[str], *, bare: bool) -> IntervalRow:
    intervals = [""] * len(columns)
    if "withheld" in entry.detail:
        value = f"{number(entry.value)}, no interval"
    elif entry.ci95 is None or not columns:
        value = number(entry.value) if bare else with_error(entry.value, entry.stderr)
    else:
        known: list[tuple[float, ...]] = [getattr(entry, key) or () for key in columns]
        value, *ends = together([entry.value or 0.0, *(end for pair in known for end in pair)], entry.sd)
        left = iter(ends)
        intervals = [f"{next(left)} to {next(left)}" if pair else "" for pair in known]
    return IntervalRow(words, (entry.symbol,), wording.unit_words(entry.unit), value, tuple(intervals))


def _columns(specimen: Specimen) -> list[str]:
    return [
        key for key in _INTERVALS if any(getattr(entry, key) is not None for entry in specimen.parameters)
    ]


def paper_view(specimen: Specimen) -> dict[str, Any]:
    """The contact model's numbers: words of the ``model``, ``rows``, names of ``intervals``, ``said``."""
    raised = wording.misfit_raised(specimen)
    columns = [] if raised else _columns(specimen)
    window = window_words(specimen)
    one_time = f" One relaxation time: {window}." if window else ""
    return {
        "model": "modified Kelvin-Voigt" if specimen.model.key == "kelvin-voigt" else specimen.model.key,
        "rows": _rows(specimen, columns, bare=raised),
        "intervals": [_INTERVALS[key] for key in columns],
        "said": f"{_fit_sentence(specimen)} {_range_sentence(specimen)}{one_time}",
    }


def _fit_sentence(specimen: Specimen) -> str:
    """Sentence on the fit, its method, and what it leaves."""
    model, sampler = specimen.model, specimen.sampler
    branches = wording.counted(model.branches, "branch", "es")
    rmse = f"{number(specimen.nrmsd.rmse_N, 3)} {specimen.units.force}"
    drawn = f"; {sampler.name}, {sampler.draws:,} draws" if sampler else "; nothing sampled"
    law = f"Static force a_1 x + a_2 x² + a_3 x³, {branches} with K(x) = {_FOLD[model.stiffness_degree]}"
    if model.key != "kelvin-voigt":
        law = f"Model {model.key}"
    return (
        f"NRMSD {100 * specimen.nrmsd.range:.2f} % of the range, {rmse}. {law}, "
        f"{_POOLING[model.static_pooling]}. "
        f"{specimen.optimisers.method}{drawn}."
    )


def _range_sentence(specimen: Specimen) -> str:
    """Depths, speeds and holds that the numbers are of."""
    valid, length = specimen.validity, specimen.units.length
    windows = [row.window_s[1] - row.window_s[0] for row in specimen.relaxation]
    held = f", holds of up to {number(max(windows), 3)} s" if windows else ""
    deep = wording.depth_words(valid.depth_mm, specimen.units)
    return f"Valid to {deep} at {wording.reach(valid.speeds_mm_s)} {length}/s{held}."


def window_words(specimen: Specimen) -> str:
    """The one-branch relaxation time with its window, of holds cut to T, T/2 and T/4; empty without one."""
    window = specimen.relaxation_window
    if window is None:
        return ""
    slope, error = window.slope, window.slope_stderr
    values = [
        f"{number(tau, 2)}{' s' if not i else ''} over {number(cut, 2)}{' s of hold' if not i else ''}"
        for i, (tau, cut) in enumerate(zip(window.tau_s, window.cut_s, strict=True))
    ]
    said = f"{values[0]} ({', '.join(values[1:])}; d ln tau/d ln T {with_error(slope, error)})"
    if window.effective:
        return f"effective, it follows the window: {said}"
    if slope + EFFECTIVE_SD * error <= EFFECTIVE_SLOPE:
        return f"{said}: not the window's"
    return said


def _sampler_sentence(specimen: Specimen) -> str:
    sampler = specimen.sampler
    if sampler is None:
        return ""
    detail, known = sampler.detail, [one for one in specimen.parameters if one.ess_bulk is not None]
    least = wording.least_effective(specimen)
    r_hats = [entry.r_hat for entry in known if entry.r_hat is not None]
    sizes = ("walkers", "steps") if sampler.name == "emcee" else ()
    parts = [
        *(f"{detail[key]:,} {key}" for key in sizes if isinstance(detail.get(key), int)),
        f"{sampler.draws:,} draws kept",
        *([] if least is None else [f"at least {least:,} effective draws of every parameter"]),
        *(f"R-hat at most {one:.3f}" for one in sorted(r_hats)[-1:]),
        f"{100 * sampler.acceptance:.0f} % of the proposals accepted",
    ]
    why = f": {detail['reason']}" if detail.get("reason") else ""
    end = "converged" if sampler.converged else f"not converged{why}"
    return f"Sampled by {sampler.name}: {', '.join(parts)}; {end}."


def _no_total(specimen: Specimen) -> str:
    """Why there is no total interval though the machine was asked about; empty where there is one."""
    told = None if specimen.sampler is None else specimen.sampler.detail.get("total")
    if not isinstance(told, Mapping) or told.get("converged", True):
        return ""
    worth = told.get("worth")
    share = "" if worth is None else f": the draws are worth {number(worth, 2)} independent ones"
    return (
        f"what is not known of the machine bends the model too far from the recordings to be sampled{share}"
    )


def _noise_sentence(specimen: Specimen) -> str:
    noise, force = specimen.noise, specimen.units.force
    if noise is None:
        return ""
    size = f"{number(noise.sigma_N, 3)} {force}"
    if noise.model == "white" or not noise.phi:
        return f"Noise of the force: white, {size}: each sample errs on its own."
    kind = "correlated (AR(1))" if noise.model == "ar1" else "white and correlated (AR(1)) together"
    return (
        f"Noise of the force: {kind}, {size} in all; the correlated part keeps {noise.phi:.3g} of itself "
        f"over {number(noise.reference_step_s, 3)} s."
    )


def _prior_rows(specimen: Specimen) -> list[dict[str, Any]]:
    rows = []
    for row in specimen.priors:
        shrinkage, mean, sd = row.shrinkage, row.posterior_mean, row.posterior_sd
        after, error = ("–", "–") if mean is None or sd is None else together([mean, sd], sd)
        rows.append(
            {
                "of": row,
                "words": wording.nuisance_words(row.name),
                "posterior": f"{after} ± {error}",
                "width": 100 * min(max(shrinkage or 0.0, 0.0), 1.0),
                "shrinkage": "–" if shrinkage is None else f"{100 * shrinkage:.0f} %".replace("-", "−"),
                "little": shrinkage is not None and shrinkage < LITTLE_SHRINKAGE,
            }
        )
    return rows


def _budget(specimen: Specimen) -> dict[str, Any] | None:
    """Sources by parameter: shares for the stacked bars, standard deviations for the table."""
    found: dict[str, dict[str, BudgetRow]] = {}
    for row in specimen.budget:
        found.setdefault(row.parameter, {})[row.source] = row
    present = {row.source for row in specimen.budget}
    sources = [(source, place) for place, source in enumerate(SOURCES) if source in present]
    beside = [source for source in ("total", "cluster bootstrap") if source in present]
    rows = []
    for entry in reported_order(specimen.parameters):
        if own := found.get(entry.name):
            shares = [
                {"source": source, "place": place, "percent": 100 * share}
                for source, place in sources
                if source in own and (share := own[source].share)
            ]
            largest = max(shares, key=lambda share: share["percent"], default=None)
            every = [*(source for source, _ in sources), *beside]
            sd = [number(own[source].sd, 2) if source in own else "–" for source in every]
            rows.append({"of": entry, "shares": shares, "largest": largest, "sd": sd})
    return {"sources": sources, "beside": beside, "rows": rows} if rows else None


def uncertainty_view(specimen: Specimen) -> dict[str, Any] | None:
    """View of a specimen's uncertainty for the template; ``None`` where nothing was sampled."""
    if specimen.sampler is None:
        return None
    columns, raised = _columns(specimen), wording.misfit_raised(specimen)
    checks = () if specimen.misfit is None else specimen.misfit.checks
    return {
        "alarm": [check.message.rstrip(".") for check in checks if check.raised] if raised else [],
        "raised": raised,
        "rows": _rows(specimen, columns),
        "intervals": [_INTERVALS[key] for key in columns],
        "total": "ci95_total" in columns,
        "no_total": _no_total(specimen),
        "normalised": (specimen.units.length, specimen.units.force) != ("mm", "N"),
        "converged": specimen.sampler.converged,
        "sampler": _sampler_sentence(specimen),
        "noise": _noise_sentence(specimen),
        "convergence": [one for one in reported_order(specimen.parameters) if one.ess_bulk is not None],
        "priors": _prior_rows(specimen),
        "budget": _budget(specimen),
        "checks": checks,
    }
