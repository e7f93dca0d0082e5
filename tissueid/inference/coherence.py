"""Values and their intervals: what is not coherent is withheld."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from tissueid.flags import Flag
from tissueid.result import Estimate, SpecimenFit
from tissueid.uncertainty import ParameterUncertainty

#: Symbols named in one sentence.
LONGEST_LIST = 4


def _inside(value: float, interval: tuple[float, float] | None, margin: float) -> bool:
    if interval is None:
        return False
    spare = margin * (interval[1] - interval[0])
    return interval[0] + spare <= value <= interval[1] - spare


def outside(
    parameters: tuple[Estimate, ...], found: Mapping[str, ParameterUncertainty], *, margin: float = 0.0
) -> tuple[str, ...]:
    """Identified parameters whose value lies outside an interval of theirs, or whose intervals part.

    ``found``: name -> intervals; a total interval that is missing where others have one counts as outside;
    ``margin``: share of an interval's width that the value must keep from its ends.
    """
    totals = any(one.ci95_total is not None for one in found.values())
    out = []
    for one in parameters:
        if one.value is None or one.name not in found:
            continue
        own = found[one.name]
        good = _inside(one.value, own.ci95, margin)
        if totals or own.ci95_total is not None:
            good &= _inside(one.value, own.ci95_total, margin)
        if not good:
            out.append(one.name)
    return tuple(out)


def withheld(
    parameters: tuple[Estimate, ...], names: tuple[str, ...], why: str
) -> tuple[tuple[Estimate, ...], tuple[Flag, ...]]:
    """Parameters without the intervals that can't be believed, which are then not identified.

    ``names``: of those without; ``why``: ends the sentence.
    """
    if not names:
        return parameters, ()
    held = [one.symbol for one in parameters if one.name in names]
    symbols = ", ".join(held) if len(held) <= LONGEST_LIST else f"{held[0]} and {len(held) - 1} more"
    kept = tuple(
        replace(one, identified=False, detail={**one.detail, "withheld": why}) if one.name in names else one
        for one in parameters
    )
    flag = Flag(
        "interval_withheld",
        f"no interval for {symbols} ({len(held)} of {len(parameters)}): {why}",
        {"names": list(names)},
    )
    return kept, (flag,)


def unsampled(fit: SpecimenFit, why: str, flags: tuple[Flag, ...]) -> SpecimenFit:
    """A fit without a posterior: its values stand without intervals, and none is called identified.

    ``why``: ends the sentence "no interval is given"; ``flags``: what is said of it.
    """
    names = tuple(one.name for one in fit.parameters if one.value is not None)
    parameters, _ = withheld(fit.parameters, names, why)
    return replace(fit, parameters=parameters, flags=(*fit.flags, *flags))
