"""Words of the report: the verdict, events, numbers with their errors and units.

A number that the data do not determine is never printed as a value: it is "not identified".
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from markupsafe import Markup, escape

from tissueid.digits import number
from tissueid.documents.identification import Specimen
from tissueid.documents.inspect import Units
from tissueid.quantity_words import QUANTITIES
from tissueid.report.remarks import LEVELS, remarks
from tissueid.trial import Axes

_GREEK: Mapping[str, str] = {"tau": "τ", "eta": "η"}


def symbol_words(symbol: str) -> Markup:
    """A symbol as it is typeset: ``tau2`` is a Greek letter with a 2 below it."""
    name, index = re.fullmatch(r"(\D*)(.*)", symbol, re.DOTALL).groups()  # type: ignore[union-attr]
    letter = _GREEK.get(name, name)
    return escape(letter) + (Markup("<sub>{}</sub>").format(index) if index else "")


def parameter_words(name: str) -> str:
    """Name of a parameter in plain words, with its branch."""
    plain, _, branch = name.partition("_b")
    if not branch.isdigit():
        plain, branch = name, ""
    words = QUANTITIES[plain].title if plain in QUANTITIES else plain
    return f"{words}, branch {branch}" if branch else words


#: Residual as a share of the force range from which a verdict is no better than this.
_LEFT = ((0.0, "ok"), (0.02, "caution"), (0.05, "serious"))


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on a result at first sight."""

    level: str  # ``ok``, ``note``, ``caution`` or ``serious``; chooses colour and icon
    title: str
    text: str


def verdict(specimen: Specimen) -> Verdict:
    """Sum up a specimen: what is identified, how well it fits, and whether something is in the way."""
    unknown = [entry for entry in specimen.parameters if not entry.identified]
    found = remarks(specimen)
    level = found[0].level if found else "ok"
    for family in ("viscosity", "static_1"):
        asked = [entry for entry in specimen.parameters if entry.name.startswith(family)]
        if asked and not any(entry.identified for entry in asked):
            level = "serious"
    if unknown and level in {"ok", "note"}:
        level = "caution"
    if misfit_raised(specimen):
        level = "serious"
    # a fit that leaves more reads no better than one that leaves less
    left = specimen.nrmsd.range
    level = max(level, *(grade for limit, grade in _LEFT if left >= limit), key=LEVELS.index)
    total = len(specimen.parameters)
    fit = f"The model follows the force to {100 * left:.2f} % of its range{_beside_noise(specimen)}"
    share = (
        "a mark of what a law can reach, with nothing to quote"
        if not total
        else "every parameter is identified"
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


def _beside_noise(specimen: Specimen) -> str:
    """Misfit against the measured noise, where it is more."""
    noise = specimen.noise
    if noise is None or noise.samples_per_independent <= 1.0:
        return ""
    unit = specimen.units.force
    beside = "" if noise.measured_N is None else f" where the noise is {noise.measured_N:.2g} {unit}"
    return f" and misses {noise.sigma_N:.2g} {unit}{beside}"


def misfit_raised(specimen: Specimen) -> bool:
    """True where the residuals contradict the model or its noise: no error then stands beside a value."""
    return specimen.misfit is not None and bool(specimen.misfit.raised)


def unit_words(unit: str) -> str:
    """``N s/mm^2`` as it is printed: ``N·s/mm²``."""
    return (
        unit.replace("^2", "²")
        .replace("^3", "³")
        .replace("N s", "N·s")
        .replace("MPa s", "MPa·s")
        .replace("N*s", "N·s")
    )


def in_units(heading: str, units: Units | None) -> str:
    """A heading written in mm and N, in the units of the specimen; without any where specimens differ.

    >>> in_units("Speed [mm/s]", Units(length="1", force="MPa", time="s"))
    'Speed [1/s]'
    """
    if units is None:
        return heading.split(" [")[0]
    axes = Axes(units.length, units.force)
    return re.sub(r"\[([^\]]*)\]", lambda found: f"[{unit_words(axes.unit(found[1]))}]", heading)


#: Key -> words and unit; what is not listed is not shown.
_WORDS: Mapping[str, tuple[str, str]] = {
    "force_before_N": ("force before", "N"),
    "drop_N": ("falls by", "N"),
    "settles_mm": ("travels on by", "mm"),
    "depth_mm": ("depth", "mm"),
    "work_N_mm": ("work from contact", "N mm"),
    "force_N": ("force", "N"),
    "limit_N": ("stated limit", "N"),
    "creep_mm": ("sinks on by", "mm"),
    "reached_mm": ("depth reached", "mm"),
    "stated_mm": ("depth stated", "mm"),
    "stated_hold_s": ("hold stated", "s"),
    "earlier_mm": ("the least before it", "mm"),
    "turns": ("turns", ""),
}


def event_words(values: Mapping[str, float], units: Units) -> str:
    """The numbers of an event as a list in words.

    ``values``: of an event of ``schemas/inspect.schema.json``; ``units``: ``units`` of its recording.

    Examples
    --------
    >>> event_words({"drop_N": 12.5, "depth_mm": 3.0}, Units(length='mm', force='N', time='s'))
    'falls by 12.50 N, depth 3.000 mm'
    """
    axes = Axes(units.length, units.force)
    said = []
    for key, value in values.items():
        if key in _WORDS:
            words, unit = _WORDS[key]
            printed = unit_words(axes.unit(unit)) if unit else "1"
            said.append(f"{words} {value:g}" if printed == "1" else f"{words} {number(value)} {printed}")
    return ", ".join(said)


def took(duration_s: float) -> str:
    """Duration of a stop: none is shorter than sampling shows."""
    return "too short to see" if duration_s == 0.0 else f"took {number(duration_s, 2)} s"
