"""Every decision on a recording, and the whole entry of study.toml that would change it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from tissueid.digits import number, with_error
from tissueid.documents.inspect import Trial

BECAUSE = "say why"
#: Decimals of a displacement without a standard deviation in an entry: 0.1 um.
_PLACES_MM = 4
_SIGN = {1: "positive", -1: "negative"}
_CHANNELS = ("time", "displacement", "force")
#: Stands for a unit that the user must write; study.toml is refused as long as it stands there.
UNIT_TO_WRITE = "unit?"
#: A minimum this much longer than the shortest hold leaves that one out.
_JUST_LONGER = 1.05
#: Key of an override -> the decision it takes.
_DECIDES = {
    "columns": "columns",
    "units": "units",
    "axes": "units",
    "compression": "compression",
    "force": "force",
    "contact_mm": "contact",
    "contact_sd_mm": "contact",
    "minimum_hold_s": "hold",
    "hold_from_s": "hold_from",
    "start_s": "cut",
    "end_s": "cut",
    "rupture": "rupture",
}
#: Shortest hold that is asked for where none was found [s].
_ANY_HOLD_S = 0.2


@dataclass(frozen=True, slots=True)
class Decision:
    """One decision."""

    key: str  # stable name for the page
    title: str
    taken: str  # what was decided, and from what
    toml: str  # the entry that would decide otherwise
    adjust: str | None = None  # key in the entry whose number a click into the picture sets


#: Function of key, title, words, the key that a click sets, and the values of the entry.
_Decide = Callable[..., Decision]


def toml_value(value: Any) -> str:
    """A number, boolean, string or flat map as TOML writes it."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {toml_value(one)}" for key, one in value.items()) + " }"
    from tomlkit import item

    return str(item(value).as_string())


def _entry(
    table: str, file: str, sheet: str | None, values: Mapping[str, Any], *, because: bool = True
) -> str:
    where: dict[str, Any] = {"file": file} | ({} if sheet is None else {"sheet": sheet})
    reason = {"because": BECAUSE} if because else {}
    lines = [f"{key} = {toml_value(value)}" for key, value in (where | dict(values) | reason).items()]
    return "\n".join([f"[[{table}]]", *lines])


def decisions(recording: Trial, *, file: str) -> tuple[Decision, ...]:
    """The decisions on a recording, in their order; ``file``: its path from the folder of study.toml."""
    sheet = recording.sheet

    def decide(key: str, title: str, taken: str, adjust: str | None = None, **values: Any) -> Decision:
        return Decision(key, title, taken, _entry("override", file, sheet, values), adjust)

    found = [
        _columns(recording, decide),
        _units(recording, decide),
        *_signs(recording, decide),
        _contact(recording, decide),
        *_hold(recording, decide),
        _cut(recording, decide),
        *_rupture(recording, decide),
        Decision(
            "specimen",
            "Specimen",
            f"{recording.specimen}; trials of one specimen are fitted together",
            _entry("trial", file, sheet, {"specimen": recording.specimen}, because=False),
        ),
        _exclusion(recording, _entry("exclude", file, sheet, {})),
    ]
    stated = _stated(recording)
    return tuple(
        replace(one, taken=f"as study.toml says, because: {stated[one.key]}; {one.taken}")
        if one.key in stated
        else one
        for one in found
    )


def _stated(recording: Trial) -> dict[str, str]:
    """Decisions that the user took, each with the reason."""
    said = next((flag.values for flag in recording.flags if flag.code == "decision_overridden"), None)
    return {} if said is None else {_DECIDES[key]: said["because"] for key in said["keys"] if key in _DECIDES}


def _columns(recording: Trial, decide: _Decide) -> Decision:
    named = {key: getattr(recording.columns, key) for key in _CHANNELS}
    columns = {key: name for key, name in named.items() if name is not None}
    taken = ", ".join(f"{key} = {name}" for key, name in columns.items())
    for flag in (flag for flag in recording.flags if flag.code == "column_choice"):
        others = flag.values.get("alternatives") or []
        quantity = flag.values.get("quantity")
        if others and quantity in columns:
            columns[quantity] = others[0]
            taken += f"; {quantity} could also be {', '.join(others)}"
    return decide("columns", "Columns", taken, columns=columns)


def _units(recording: Trial, decide: _Decide) -> Decision:
    assumed = {
        flag.values["quantity"]: flag.values["unit"]
        for flag in recording.flags
        if flag.code == "units_assumed" and "quantity" in flag.values
    }
    inside = f"{recording.units.length}, {recording.units.force} and s"
    if assumed:
        taken = f"no unit in the file for {', '.join(assumed)}: taken as they stand; shown here in {inside}"
    else:
        taken = (
            f"as the file states them; shown here in {inside}; write the unit of each column in place of"
            f" {UNIT_TO_WRITE}, and leave out those that are right"
        )
    return decide("units", "Units", taken, units=assumed or dict.fromkeys(_CHANNELS, UNIT_TO_WRITE))


def _signs(recording: Trial, decide: _Decide) -> list[Decision]:
    sign, force = recording.compression_sign, recording.force_sign
    taken = f"{_SIGN[sign]} displacement goes into the tissue: force changes that way"
    found = [decide("compression", "Direction of compression", taken, compression=_SIGN[-sign])]
    if force is not None:
        taken = f"{_SIGN[force]} force is compression: it changes with the travel that way"
        found.append(decide("force", "Sign of the force", taken, force=_SIGN[-force]))
    return found


def _contact(recording: Trial, decide: _Decide) -> Decision:
    contact = recording.contact
    if contact is None:
        place = round(recording.first.displacement_mm, _PLACES_MM)
        taken = "none was found; click into the lower picture where the force begins to rise"
        return decide("contact", "Contact point", taken, "contact_mm", contact_mm=place, contact_sd_mm=0.05)
    places = _places(contact.sd_mm)
    place, sd = round(contact.displacement_mm, places), round(contact.sd_mm, places)
    how = "seen in the record" if contact.in_record else "extrapolated: the record starts in contact"
    taken = f"{with_error(place, sd)} mm as recorded, {how}; click into the lower picture to move it"
    values = {"contact_mm": place, "contact_sd_mm": max(sd, 10.0**-places)}
    return decide("contact", "Contact point", taken, "contact_mm", **values)


def _places(sd: float) -> int:
    """Decimals that show a standard deviation with two digits."""
    return 1 - math.floor(math.log10(sd)) if sd > 0.0 else _PLACES_MM


def _hold(recording: Trial, decide: _Decide) -> list[Decision]:
    """Shortest hold, and start of the longest."""
    holds = [(phase.end_s - phase.start_s, phase) for phase in recording.phases if phase.kind == "hold"]
    if not holds:
        taken = "no standstill after a ramp was long enough to be a hold"
        return [decide("hold", "Shortest hold", taken, minimum_hold_s=_ANY_HOLD_S)]
    shortest = min(length for length, _ in holds)
    places = 2 - math.floor(math.log10(shortest)) if shortest > 0.0 else 3
    longer = math.ceil(_JUST_LONGER * shortest * 10.0**places) / 10.0**places
    counted = f"{len(holds)} found, the shortest of {number(shortest, 3)} s"
    _, longest = max(holds, key=lambda hold: hold[0])
    start = longest.start_s
    lasts = f"the longest one lasts from {number(start)} to {number(longest.end_s)} s"
    left_out, nearest = "this entry would leave that one out", "write where the one nearest begins"
    return [
        decide("hold", "Shortest hold", f"{counted}; {left_out}", minimum_hold_s=longer),
        decide("hold_from", "Start of the hold", f"{lasts}; {nearest}", hold_from_s=start),
    ]


def _cut(recording: Trial, decide: _Decide) -> Decision:
    start, end = recording.first.time_s, recording.last.time_s
    said = _stated(recording).get("cut")
    part = "all of the record counts" if said is None else "a part of the record counts"
    taken = f"{part}, which lasts from {number(start)} to {number(end)} s"
    return decide("cut", "Part of the record", taken, "start_s", start_s=start, end_s=end)


def _rupture(recording: Trial, decide: _Decide) -> list[Decision]:
    times = [f"{number(event.time_s)} s" for event in recording.events if event.kind == "rupture"]
    if times:
        taken = f"the force collapses at {', '.join(times)}: what follows is not fitted"
    elif "rupture" in _stated(recording):
        taken = "no drop of the force is taken for a rupture"
    else:
        return []
    return [decide("rupture", "Rupture", taken, rupture=not times)]


def _exclusion(recording: Trial, entry: str) -> Decision:
    because = recording.excluded
    if because is None:
        return Decision(
            "exclude", "Exclusion", "it takes part in the fit; this entry would take it out", entry
        )
    taken = f"it is taken out of the fit, because: {because}; without this entry it would take part"
    return Decision("exclude", "Exclusion", taken, entry.replace(toml_value(BECAUSE), toml_value(because)))
