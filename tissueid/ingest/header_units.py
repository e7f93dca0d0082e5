"""Units that lines of a header state: of one column by its name or kind, or of all by their kind."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tissueid.ingest.columns import channel_columns
from tissueid.ingest.numbers import Row
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.vocabulary import UNIT_WORD, Channel, plain_words, rank_of, split_name
from tissueid.units import quantity_of

#: A name and its unit: ``Force unit: mN``, ``force_unit=mN``, ``Units (force): mN``, ``Force in mN``.
_OF_ONE = (
    re.compile(rf"(.{{1,40}}?\S)[ _]?{UNIT_WORD}\s?[:=,]?\s?(\S{{1,12}})", re.IGNORECASE),
    re.compile(
        rf"{UNIT_WORD}\s?(?:of |de |der |des |du |del |di |do |\()(.{{1,40}}?)\)?\s?[:=,]?\s(\S{{1,12}})",
        re.IGNORECASE,
    ),
    re.compile(r"(.{1,40}\S) in (\S{1,12})"),
)
_QUOTED = re.compile(rf'"(\w{{1,40}}?)_?{UNIT_WORD}"\s*:\s*"([^"]{{1,12}})"', re.IGNORECASE)
#: Units of several columns: ``Units: s, um, gf``, ``Unit system: SI (s, mm, N)``.
_OF_ALL = re.compile(
    rf"(?:display |data )?{UNIT_WORD}(?:(?:\s?[:=,]\s?|\s)([^()]{{1,80}})|[^()]{{1,60}}\(([^()]{{3,80}})\))",
    re.IGNORECASE,
)
#: Words by which a header calls the displacement where it states a unit, accents stripped.
_LENGTHS = frozenset({"length", "lange", "longueur", "longitud", "comprimento", "lunghezza", "distance"})


def stated_units(header: Sequence[Row], names: Row, options: ReadOptions) -> Row:
    """Units above columns of these names; empty texts where none is stated, no texts where none is at all.

    One that is stated of a column that has another in its name stands beside it.
    """
    stated, kinds = {}, dict[str, set[str]]()
    for filled in ([cell.strip() for cell in row if cell.strip()] for row in header):
        line = " ".join(filled)
        of_one = [one.groups() for key in _OF_ONE if (one := key.fullmatch(line))]
        for name, unit in (*of_one, *_QUOTED.findall(line)):
            if isinstance(quantity_of(unit), str):
                stated[plain_words(name)] = unit
        # those in cells of their own stand over columns, be they these or not
        for unit in _listed(line) if len(filled) == 1 else ():
            kinds.setdefault(str(quantity_of(unit)), set()).add(unit)
    units = [stated.get(plain_words(name), "") for name in names]
    for channel, at in (channel_columns(names, options) if stated or kinds else {}).items():
        named = (unit for key, unit in stated.items() if _calls(key, channel))
        own = split_name(names[at])[1]
        alike = kinds.get(options.quantity(channel), set()) if own is None else set()
        units[at] = units[at] or next(named, "") or (next(iter(alike)) if len(alike) == 1 else "")
    return tuple(units) if any(units) else ()


def between_names(names: Row, units: Row, width: int) -> tuple[Row, Row]:
    """Names and units over ``width`` columns, units that stand in cells between the names taken from there.

    The mark that parts columns also parts a name from its unit, ``Time,s,Force,N``: over as many columns as
    there are names, or with an empty one behind each.
    """
    own, between = names[::2], [unit.strip() for unit in names[1::2]]
    alone = 2 * len(between) == len(names) and all(quantity_of(unit) for unit in between)
    if any(units) or not alone or any(quantity_of(name.strip()) for name in own):
        return names, units
    if len(own) == width:
        return own, tuple(between)
    if len(names) == width:
        return tuple(cell for name in own for cell in (name, "")), tuple(c for u in between for c in (u, ""))
    return names, units


def _calls(key: str, channel: Channel) -> bool:
    """True where the header calls a channel so."""
    return rank_of(key, channel, loose=False) is not None or (channel == "displacement" and key in _LENGTHS)


def _listed(line: str) -> list[str]:
    """Units of a line that lists those of several columns, or of the force alone; none of another line."""
    match = _OF_ALL.fullmatch(line)
    parts = re.split(r"[\s,;|]+", (match[1] or match[2]).strip()) if match else []
    if len(parts) == 1 and parts[0].count("/") > 1:
        parts = parts[0].split("/")
    kinds = [quantity_of(one) for one in parts]
    # a length alone may be that of a specimen
    return parts if (len(parts) > 1 or kinds == ["force"]) and all(kinds) else []
