"""The tissue in one sentence, and several specimens in one: numbers with the widest interval they have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

from msgspec.structs import replace

from tissueid.digits import number, together, with_error
from tissueid.documents.identification import Estimate, Specimen, Validity
from tissueid.report.wording import misfit_raised, unit_words

_S_PER_MIN = 60.0
_WIDEST = (("ci95_total", "95 % total intervals"), ("ci95", "95 % statistical intervals"))


def _by_name(parameters: Sequence[Estimate]) -> dict[str, Estimate]:
    return {entry.name: entry for entry in parameters}


def _estimate_words(entry: Estimate, interval: str | None) -> str:
    """A value with its unit and its interval in brackets, or its standard error where nothing was sampled."""
    unit = unit_words(entry.unit)
    ends: tuple[float, float] | None = None if interval is None else getattr(entry, interval)
    if ends is None or entry.value is None:
        return f"{with_error(entry.value, entry.stderr)} {unit}"
    value, low, high = together([entry.value, *ends], entry.sd)
    return f"{value} {unit} [{low} to {high}]"


def _static_words(known: Mapping[str, Estimate], depth_mm: float, length: str, interval: str | None) -> str:
    names = ("static_1_N_per_mm", "static_2_N_per_mm2", "static_3_N_per_mm3")
    values = [known[name].value for name in names if name in known]
    if not values or values[0] is None:
        return "its static stiffness is not identified"
    first = known[names[0]]
    words = f"its static stiffness is {_estimate_words(first, interval)} at contact"
    terms = [value * depth_mm**power for power, value in enumerate(values) if value is not None]
    if len(terms) == len(values) and depth_mm > 0:
        secant = sum(terms)
        unit = unit_words(first.unit)
        words += f" ({number(secant, 3)} {unit} on average over {number(depth_mm, 3)}{length})"
    return words


def _listed(parts: Sequence[str], *, last: str = " and ") -> str:
    return f"{', '.join(parts[:-1])}{last}{parts[-1]}" if len(parts) > 1 else parts[0]


def _dynamic_words(known: Mapping[str, Estimate], branches: Sequence[str], interval: str | None) -> list[str]:
    parts = []
    for name, words, lost in (
        ("relaxation_time_s", "it relaxes in", "its relaxation time"),
        ("viscosity_N_s_per_mm", "its viscosity is", "its viscosity"),
    ):
        entries = [known[f"{name}{suffix}"] for suffix in branches if f"{name}{suffix}" in known]
        said = [_estimate_words(entry, interval) for entry in entries if entry.value is not None]
        missing = "" if len(said) == len(entries) else f" ({len(entries) - len(said)} more not identified)"
        if said:
            parts.append(f"{words} {_listed(said)}{missing}")
        elif entries:
            parts.append(f"{lost} is not identified")
    return parts


def _valid_words(validity: Validity, *, normalised: bool) -> str:
    slow, fast = validity.speeds_mm_s

    def span(factor: float) -> str:
        ends = [number(factor * value, 3) for value in (slow, fast)]
        return ends[0] if ends[0] == ends[1] else " to ".join(ends)

    deep = number(validity.depth_mm, 3)
    if normalised:
        return f"valid to a strain of {deep} and for loading at {span(1.0)} 1/s"
    tip = validity.tip_radius_mm
    tool = "a tool tip of unstated radius" if tip is None else f"a tool tip of radius {number(tip, 3)} mm"
    return (
        f"found with {tool}, valid to {deep} mm deep and for loading at {span(1.0)} mm/s "
        f"({span(_S_PER_MIN)} mm/min)"
    )


def tissue_sentence(specimen: Specimen) -> str:
    """The tissue in one sentence: stiffness, relaxation, viscosity, tip, and where it is valid.

    Numbers carry their total 95 % interval, else the statistical one, else their standard error; none of
    these where the residuals contradict the model.
    """
    known = _by_name(specimen.parameters)
    interval, told = None, ""
    if misfit_raised(specimen):
        known = {name: replace(entry, stderr=None) for name, entry in known.items()}
    else:
        for key, words in _WIDEST:
            if interval is None and any(getattr(entry, key) is not None for entry in known.values()):
                interval, told = key, f" (brackets: {words})"
    normalised = specimen.units.length != "mm"
    branches = [suffix for suffix in ("", "_b2", "_b3") if f"relaxation_time_s{suffix}" in known]
    parts = [
        _static_words(known, specimen.validity.depth_mm, "" if normalised else " mm", interval),
        *_dynamic_words(known, branches, interval),
    ]
    listed = _listed(parts, last=", and " if branches[1:] or interval else " and ")
    valid = _valid_words(specimen.validity, normalised=normalised)
    return f"{listed[0].upper()}{listed[1:]}{told}; {valid}."


def overview_sentence(specimens: Sequence[Specimen]) -> str:
    """Several specimens in one sentence: medians and ranges of what is identified."""
    parts = []
    for name, words in (
        ("static_1_N_per_mm", "static stiffness at contact"),
        ("relaxation_time_s", "relaxation time"),
        ("viscosity_N_s_per_mm", "viscosity"),
    ):
        entries = [_by_name(specimen.parameters).get(name) for specimen in specimens]
        found = [entry for entry in entries if entry is not None and entry.value is not None]
        values = [entry.value for entry in found if entry.value is not None]
        units = {unit_words(entry.unit) for entry in found}
        if len(units) > 1:
            parts.append(f"{words} in different units ({', '.join(sorted(units))}), not compared")
        elif values:
            unit = units.pop()
            low, middle, high = (number(value, 3) for value in (min(values), median(values), max(values)))
            known = "" if len(values) == len(specimens) else f", identified in {len(values)}"
            parts.append(f"{words} {middle} {unit} ({low} to {high}{known})")
        else:
            parts.append(f"{words} not identified in any")
    return f"{len(specimens)} specimens; median and range of each quantity: {'; '.join(parts)}."
