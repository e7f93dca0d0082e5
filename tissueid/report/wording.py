"""Words of the report: remarks, verdicts, sentences on tissues, events, numbers with errors and units."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median

from markupsafe import Markup, escape
from msgspec.structs import replace

from tissueid.digits import number, together, typeset, with_error
from tissueid.documents.base import Placed
from tissueid.documents.identification import Estimate, Relaxation, Specimen, Trial, Validity
from tissueid.documents.inspect import Units
from tissueid.flags import FLAGS, Flag, flag_level, harm_rank
from tissueid.quantity_words import QUANTITIES
from tissueid.trial import Axes

MINUTE, HOUR = 60.0, 3600.0
#: From harmless to grave.
LEVELS = ("ok", "note", "caution", "serious")


def least_effective(specimen: Specimen) -> int | None:
    """Effective draws that every parameter has at least, in the bulk and in the tails."""
    sizes = [size for one in specimen.parameters for size in (one.ess_bulk, one.ess_tail)]
    return min((int(size) for size in sizes if size is not None), default=None)


@dataclass(frozen=True, slots=True)
class Remark:
    """One flag for a reader, gathered over a specimen's trials."""

    code: str
    level: str  # ``note``, ``caution`` or ``serious``
    title: str  # what it is about
    messages: tuple[str, ...]  # its sentences, with numbers; none twice
    where: tuple[str, ...]  # trials that carry it; empty for the specimen as a whole
    numbers: Mapping[str, str] = field(default_factory=dict)  # one click away

    @property
    def message(self) -> str:
        """All sentences in one, each closed once, powers of ten raised."""
        return typeset("; ".join(part.rstrip(".") for part in self.messages))


def flag_remarks(flags: Sequence[Flag]) -> list[Remark]:
    """Flags of a whole document as remarks, one each."""
    return [
        Remark(one.code, flag_level(one.code), remark_title(one.code), (one.message,), ()) for one in flags
    ]


def remark_title(code: str) -> str:
    """Title of a flag; a code of a later version is spelt out."""
    return FLAGS[code].title if code in FLAGS else code.replace("_", " ").capitalize()


def trial_label(trial: Placed) -> str:
    """Short name of a trial: its file, and its sheet where there is one."""
    name = trial.path.replace("\\", "/").rsplit("/", 1)[-1]
    return name if trial.sheet is None else f"{name} [{trial.sheet}]"


def whole_label(trial: Placed, folder: str = "") -> str:
    """Path of a trial, without a folder in front, and its sheet where there is one."""
    path = trial.path.removeprefix(folder)
    return path if trial.sheet is None else f"{path} [{trial.sheet}]"


def counted(count: int, noun: str, ending: str = "s") -> str:
    """``1 log`` or ``3 logs``."""
    return f"{count} {noun}{'' if count == 1 else ending}"


def span(ends: Sequence[float] | None, digits: int = 4) -> str:
    """Ends of an interval, ``1.200 to 3.400``; a dash where there is none."""
    return "–" if ends is None else " to ".join(number(end, digits) for end in ends)


def reach(ends: Iterable[float], digits: int = 3) -> str:
    """Slowest and fastest of some numbers: once where both look alike."""
    return " to ".join(dict.fromkeys(number(end, digits) for end in ends))


def percent(share: float, digits: int = 3) -> str:
    """A share in percent, without the sign."""
    return number(100.0 * share, digits)


def time_words(seconds: float) -> str:
    """``35.0 min`` or ``2.40 h``."""
    if seconds < 2.0 * MINUTE:
        return f"{number(seconds, 2)} s"
    return f"{number(seconds / MINUTE, 3)} min" if seconds < 2.0 * HOUR else f"{number(seconds / HOUR, 3)} h"


def depth_words(depth_mm: float, units: Units) -> str:
    """Depth with its unit, or as a strain."""
    return f"{number(depth_mm, 3)} mm" if units.length == "mm" else f"a strain of {number(depth_mm, 3)}"


def remarks(specimen: Specimen, *, holds: bool = True) -> tuple[Remark, ...]:
    """Every flag of a specimen, its trials and perhaps its holds, once a code, the one of most harm first."""
    # sentences and places of each code, none twice: several parameters may carry one code
    messages: dict[str, dict[str, None]] = {}
    where: dict[str, dict[str, None]] = {}
    for flag in specimen.flags:
        messages.setdefault(flag.code, {})[flag.message] = None
    parts: list[Trial | Relaxation] = [*specimen.trials, *(specimen.relaxation if holds else ())]
    for part in parts:
        for flag in part.flags:
            messages.setdefault(flag.code, {flag.message: None})
            where.setdefault(flag.code, {})[trial_label(part)] = None
    found = [
        Remark(code, flag_level(code), remark_title(code), tuple(said), tuple(where.get(code, ())))
        for code, said in messages.items()
    ]
    return tuple(sorted(found, key=lambda remark: harm_rank(remark.code)))


_GREEK: Mapping[str, str] = {"tau": "τ", "eta": "η"}


def symbol_words(symbol: str) -> Markup:
    """A symbol as it is typeset: ``tau2`` is a Greek letter with a 2 below it."""
    name, index = re.fullmatch(r"(\D*)(.*)", symbol, re.DOTALL).groups()  # type: ignore[union-attr]
    return escape(_GREEK.get(name, name)) + (Markup("<sub>{}</sub>").format(index) if index else "")


def parameter_words(name: str) -> str:
    """Name of a parameter in plain words, with its branch."""
    plain, _, branch = name.partition("_b")
    if not branch.isdigit():
        plain, branch = name, ""
    words = QUANTITIES[plain].title if plain in QUANTITIES else plain
    return f"{words}, branch {branch}" if branch else words


_NUISANCE_WORDS: Mapping[str, str] = {
    "force_gain": "Gain of the force",
    "displacement_gain": "Gain of the displacement",
    "skew_s": "Force later than displacement [s]",
    "force_filter_s": "Time constant of the force filter [s]",
    "frame_compliance_mm_per_N": "Compliance of the frame [mm/N]",
    "sigma_N": "Standard deviation of the noise [N]",
    "ln_sigma": "Noise, ln of its standard deviation [N]",
    "phi": "Correlation of the noise over one step",
    "gain_sd": "Scatter of the gain between logs",
    "ln_gain_sd": "Scatter of the gain between logs, ln",
    **{f"ln_relaxation_time_{k}": f"Relaxation time of branch {k}, ln [s]" for k in (1, 2, 3)},
}


def nuisance_words(name: str) -> str:
    """Name of a parameter, be it of the tissue, the noise or the machine, in plain words."""
    return _NUISANCE_WORDS.get(name) or parameter_words(name)


#: Residual as a share of the force range from which a verdict is no better than this.
_LEFT = ((0.0, "ok"), (0.02, "caution"), (0.05, "serious"))
_TITLES: Mapping[str, str] = {
    "ok": "Identified, nothing stands out",
    "note": "Identified, with assumptions to know of",
    "caution": "Usable with care",
    "serious": "Not to be relied on as it stands",
}


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on a result at first sight."""

    level: str  # ``ok``, ``note``, ``caution`` or ``serious``; chooses colour and icon
    title: str
    text: str


def verdict(specimen: Specimen) -> Verdict:
    """Sum up a specimen: what is identified, how well it fits, and whether something is in the way."""
    every, left = specimen.parameters, specimen.nrmsd.range
    known = [entry for entry in every if entry.identified]
    # a fit that leaves more reads no better than one that leaves less
    levels = [grade for limit, grade in _LEFT if left >= limit]
    told = remarks(specimen)
    levels += [remark.level for remark in told[:1]]
    levels += ["caution"] * (len(known) < len(every))
    for family in ("viscosity", "static_1"):
        asked = [entry.identified for entry in every if entry.name.startswith(family)]
        levels += ["serious"] * (bool(asked) and not any(asked))
    levels += ["serious"] * misfit_raised(specimen)
    level = max(levels, key=LEVELS.index)
    share = "every parameter is identified"
    if not every:
        share = "a mark of what a law can reach, with nothing to quote"
    elif len(known) < len(every):
        share = f"{len(known)} of {len(every)} parameters are identified"
    share += ", if K is constant" * ("split_assumed" in {remark.code for remark in told})
    fit = f"The model follows the force to {100 * left:.2f} % of its range{_beside_noise(specimen)}"
    return Verdict(level, _TITLES[level], f"{fit}; {share}.")


def _beside_noise(specimen: Specimen) -> str:
    """Misfit against the measured noise, where it is more."""
    noise = specimen.noise
    if noise is None or not noise.discrepant:
        return ""
    unit = specimen.units.force
    beside = "" if noise.measured_N is None else f" where the noise is {noise.measured_N:.2g} {unit}"
    return f" and misses {noise.sigma_N:.2g} {unit}{beside}"


def misfit_raised(specimen: Specimen) -> bool:
    """True where the residuals contradict the model or its noise: no error then stands beside a value."""
    return specimen.misfit is not None and bool(specimen.misfit.raised)


def unit_words(unit: str) -> str:
    """``N s/mm^2`` as it is printed: ``N·s/mm²``."""
    for plain, printed in (("^2", "²"), ("^3", "³"), ("N s", "N·s"), ("MPa s", "MPa·s"), ("N*s", "N·s")):
        unit = unit.replace(plain, printed)
    return unit


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
    "travel_mm": ("its way", "mm"),
    "earlier_mm": ("the least before it", "mm"),
    "turns": ("turns", ""),
}


def event_words(values: Mapping[str, float], units: Units) -> str:
    """The numbers of an event as a list in words.

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


S_PER_MIN = 60.0
#: Parameters that stand for a specimen where there is room for few.
FEW = ("static_1_N_per_mm", "relaxation_time_s", "viscosity_N_s_per_mm")
_WIDEST = (("ci95_total", "95 % total intervals"), ("ci95", "95 % statistical intervals"))


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
        unit = unit_words(first.unit)
        words += f" ({number(sum(terms), 3)} {unit} on average over {number(depth_mm, 3)}{length})"
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
    deep, speeds = number(validity.depth_mm, 3), reach(validity.speeds_mm_s)
    if normalised:
        return f"valid to a strain of {deep} and for loading at {speeds} 1/s"
    tip = validity.tip_radius_mm
    tool = "a tool tip of unstated radius" if tip is None else f"a tool tip of radius {number(tip, 3)} mm"
    return (
        f"found with {tool}, valid to {deep} mm deep and for loading at {speeds} mm/s "
        f"({reach(S_PER_MIN * speed for speed in validity.speeds_mm_s)} mm/min)"
    )


def tissue_sentence(specimen: Specimen) -> str:
    """The tissue in one sentence: stiffness, relaxation, viscosity, tip, and where it is valid.

    Numbers carry their total 95 % interval, else the statistical one, else their standard error; none of
    these where the residuals contradict the model.
    """
    known = {entry.name: entry for entry in specimen.parameters}
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
    return f"{listed[0].upper()}{listed[1:]}{told}; {_valid_words(specimen.validity, normalised=normalised)}."


def overview_sentence(specimens: Sequence[Specimen]) -> str:
    """Several specimens in one sentence: medians and ranges of what is identified."""
    parts = []
    for name, words in zip(FEW, ("static stiffness at contact", "relaxation time", "viscosity"), strict=True):
        entries = [entry for specimen in specimens for entry in specimen.parameters if entry.name == name]
        found = [entry for entry in entries if entry.value is not None]
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


def speed_unit(units: Units) -> str:
    """``mm/s``, or ``1/s`` where depth is a strain."""
    return f"{units.length}/s"


def program_words(speed_mm_s: float, depth_mm: float, units: Units) -> str:
    """Speed and depth of a program: ``4.15 mm/s to 8.01 mm``."""
    length = f" {units.length}" if units.length == "mm" else ""
    return f"{number(speed_mm_s, 3)} {speed_unit(units)} to {number(depth_mm, 3)}{length}"
