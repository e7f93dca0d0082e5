"""What the report says in words: the tissue in one sentence, the verdict, numbers with their errors.

A number that the data do not determine is never printed as a value: it is "not identified".
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from tissueid.report.remarks import remarks
from tissueid.trial import Axes

__all__ = [
    "NOT_IDENTIFIED",
    "PARAMETER_WORDS",
    "Verdict",
    "in_units",
    "misfit_raised",
    "number",
    "overview_sentence",
    "parameter_words",
    "tissue_sentence",
    "unit_words",
    "verdict",
    "with_error",
]

NOT_IDENTIFIED = "not identified"

PARAMETER_WORDS: Mapping[str, str] = {
    "static_1_N_per_mm": "Static force, linear term",
    "static_2_N_per_mm2": "Static force, square term",
    "static_3_N_per_mm3": "Static force, cubic term",
    "stiffness_0_N_per_mm": "Dynamic stiffness at contact",
    "stiffness_1_N_per_mm2": "Dynamic stiffness, growth with depth",
    "stiffness_2_N_per_mm3": "Dynamic stiffness, curvature with depth",
    "relaxation_time_s": "Relaxation time",
    "viscosity_N_s_per_mm": "Viscosity (stiffness times relaxation time)",
}

_S_PER_MIN = 60.0
#: Numbers below this are printed with a power of ten.
_SMALL = 1e-3


def number(value: float | None, digits: int = 4) -> str:
    """A number to so many significant digits, in the way a person writes it."""
    if value is None:
        return "–"
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 6:
        places = max(digits - 1 - exponent, 0)
        text = f"{value:.{places}f}"
    else:
        mantissa, power = f"{value:.{digits - 1}e}".split("e")
        text = f"{mantissa}×10^{int(power)}"
    return text.replace("-", "−")


def with_error(value: float | None, stderr: float | None) -> str:
    """``63.62 ± 0.89``: the error to two digits, the value to the same place."""
    if value is None:
        return NOT_IDENTIFIED
    if stderr is None or stderr <= 0 or not math.isfinite(stderr):
        return number(value)
    largest = max(abs(value), stderr)
    if largest < _SMALL:
        power = math.floor(math.log10(largest))
        return f"({with_error(value / 10.0**power, stderr / 10.0**power)})×10^{power}".replace("^-", "^−")
    places = 1 - math.floor(math.log10(stderr))
    if places < 0 or places > 9:
        return f"{number(value)} ± {number(stderr, 2)}"
    return f"{value:.{places}f} ± {stderr:.{places}f}".replace("-", "−")


def rounded_to(value: float | None, stderr: float | None) -> str:
    """The value as :func:`with_error` prints it, for a column of its own."""
    first, _, rest = with_error(value, stderr).partition(" ± ")
    return first if not first.startswith("(") else f"{first[1:]}{rest[rest.index(')') + 1 :]}"


def parameter_words(name: str) -> str:
    """Name of a parameter in plain words, with its branch."""
    for branch in (2, 3):
        suffix = f"_b{branch}"
        if name.endswith(suffix):
            return f"{PARAMETER_WORDS.get(name.removesuffix(suffix), name)}, branch {branch}"
    return PARAMETER_WORDS.get(name, name)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What to think of a result at first sight.

    Attributes
    ----------
    level : str
        ``ok``, ``note``, ``caution`` or ``serious``; chooses colour and icon.
    title : str
    text : str
    """

    level: str
    title: str
    text: str


def verdict(specimen: Mapping[str, Any]) -> Verdict:
    """Sum up a specimen: what is identified, how well it fits, and whether something is in the way."""
    unknown = [entry for entry in specimen["parameters"] if not entry["identified"]]
    found = remarks(specimen)
    level = found[0].level if found else "ok"
    if any(entry["name"].startswith(("viscosity", "static_1")) for entry in unknown):
        level = "serious"
    elif unknown and level in {"ok", "note"}:
        level = "caution"
    if misfit_raised(specimen):
        level = "serious"
    total = len(specimen["parameters"])
    fit = f"The model follows the force to {100 * specimen['nrmsd']['range']:.2f} % of its range"
    share = (
        "every parameter is identified"
        if not unknown
        else f"{total - len(unknown)} of {total} parameters are"
    )
    text = f"{fit}; {share}." if not unknown else f"{fit}; {share} identified."
    titles = {
        "ok": "Identified, nothing stands out",
        "note": "Identified, with assumptions to know of",
        "caution": "Usable with care",
        "serious": "Not to be relied on as it stands",
    }
    return Verdict(level, titles[level], text)


def misfit_raised(specimen: Mapping[str, Any]) -> bool:
    """Whether the residuals contradict the model or its noise: no error then stands beside a value."""
    return specimen["misfit"] is not None and bool(specimen["misfit"]["raised"])


def _by_name(parameters: Sequence[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    return {entry["name"]: entry for entry in parameters}


def _static_words(known: Mapping[str, Mapping[str, Any]], depth_mm: float, length: str) -> str:
    names = ("static_1_N_per_mm", "static_2_N_per_mm2", "static_3_N_per_mm3")
    values = [known[name]["value"] for name in names if name in known]
    if not values or values[0] is None:
        return "its static stiffness is not identified"
    first = known[names[0]]
    unit = unit_words(first["unit"])
    words = f"its static stiffness is {with_error(first['value'], first['stderr'])} {unit} at contact"
    if None not in values and depth_mm > 0:
        secant = sum(value * depth_mm**power for power, value in enumerate(values))
        words += f" ({number(secant, 3)} {unit} on average over {number(depth_mm, 3)}{length})"
    return words


def _listed(parts: Sequence[str], *, last: str = " and ") -> str:
    return f"{', '.join(parts[:-1])}{last}{parts[-1]}" if len(parts) > 1 else parts[0]


def tissue_sentence(specimen: Mapping[str, Any]) -> str:
    """The tissue in one sentence: stiffness, relaxation, viscosity, tip, and where it is valid."""
    known = _by_name(specimen["parameters"])
    if misfit_raised(specimen):
        known = {name: {**entry, "stderr": None} for name, entry in known.items()}
    validity = specimen["validity"]
    normalised = specimen["units"]["length"] != "mm"
    length = "" if normalised else " mm"
    parts = [_static_words(known, validity["depth_mm"], length)]
    branches = [suffix for suffix in ("", "_b2", "_b3") if f"relaxation_time_s{suffix}" in known]
    for name, words, lost in (
        ("relaxation_time_s", "it relaxes in", "its relaxation time"),
        ("viscosity_N_s_per_mm", "its viscosity is", "its viscosity"),
    ):
        entries = [known[f"{name}{suffix}"] for suffix in branches if f"{name}{suffix}" in known]
        said = [
            f"{with_error(entry['value'], entry['stderr'])} {unit_words(entry['unit'])}"
            for entry in entries
            if entry["value"] is not None
        ]
        missing = "" if len(said) == len(entries) else f" ({len(entries) - len(said)} more not identified)"
        if said:
            parts.append(f"{words} {_listed(said)}{missing}")
        elif entries:
            parts.append(f"{lost} is not identified")
    slow, fast = validity["speeds_mm_s"]
    per_s = "1/s" if normalised else "mm/s"
    speeds = (
        f"{number(slow, 3)} to {number(fast, 3)} {per_s}" if slow != fast else f"{number(slow, 3)} {per_s}"
    )
    minutes = (
        f"{number(slow * _S_PER_MIN, 3)} to {number(fast * _S_PER_MIN, 3)} mm/min"
        if slow != fast
        else f"{number(slow * _S_PER_MIN, 3)} mm/min"
    )
    tip = validity["tip_radius_mm"]
    tool = "a tool tip of unstated radius" if tip is None else f"a tool tip of radius {number(tip, 3)} mm"
    listed = _listed(parts, last=", and " if branches[1:] else " and ")
    deep = number(validity["depth_mm"], 3)
    if normalised:
        return (
            f"{listed[0].upper()}{listed[1:]}; valid to a strain of {number(validity['depth_mm'], 3)} "
            f"and for loading at {speeds}."
        )
    return (
        f"{listed[0].upper()}{listed[1:]}; found with {tool}, "
        f"valid to {deep} mm deep and for loading at {speeds} ({minutes})."
    )


def overview_sentence(specimens: Sequence[Mapping[str, Any]]) -> str:
    """Several specimens in one sentence: medians and ranges of what is identified."""
    parts = []
    for name, words in (
        ("static_1_N_per_mm", "static stiffness at contact"),
        ("relaxation_time_s", "relaxation time"),
        ("viscosity_N_s_per_mm", "viscosity"),
    ):
        entries = [_by_name(specimen["parameters"]).get(name) for specimen in specimens]
        found = [entry for entry in entries if entry is not None and entry["value"] is not None]
        values = [entry["value"] for entry in found]
        units = {unit_words(entry["unit"]) for entry in found}
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


def unit_words(unit: str) -> str:
    """``N s/mm^2`` as it is printed: ``N·s/mm²``."""
    return (
        unit.replace("^2", "²")
        .replace("^3", "³")
        .replace("N s", "N·s")
        .replace("MPa s", "MPa·s")
        .replace("N*s", "N·s")
    )


def in_units(heading: str, units: Mapping[str, str] | None) -> str:
    """A heading written in mm and N, in the units of the specimen; without any where specimens differ.

    >>> in_units("Speed [mm/s]", {"length": "1", "force": "MPa"})
    'Speed [1/s]'
    """
    if units is None:
        return heading.split(" [")[0]
    axes = Axes(units["length"], units["force"])
    return re.sub(r"\[([^\]]*)\]", lambda found: f"[{unit_words(axes.unit(found[1]))}]", heading)
