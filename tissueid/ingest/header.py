"""What a header says: entries, the specimen's name, the protocol."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from tissueid.ingest.layout import Row
from tissueid.ingest.numbers import CellFault, parse_number
from tissueid.ingest.vocabulary import plain_words, specimen_key_rank
from tissueid.trial import Protocol
from tissueid.units import Quantity, factor_to

__all__ = ["header_entries", "protocol_of", "specimen_in", "stated"]

_NOTHING = re.compile(r"<.*>|-+|n/?a|none", re.IGNORECASE)
_RATE = re.compile(
    r"(?:test |crosshead |ramp |loading )?(?:rate|speed|velocity)(?: 1)?|v1|vitesse(?: d essai)?(?: 1)?"
    r"|(?:pruf)?geschwindigkeit(?: 1)?|velocidad(?: de ensayo)?(?: 1)?|velocidade(?: 1)?|velocita(?: 1)?"
    r"|predkosc(?: 1)?|速度|速率|试验速度"
)
_TIP_RADIUS = re.compile(r"(?:tip|tool|indenter|probe|sphere) radius")
_TIP_DIAMETER = re.compile(r"(?:tip|tool|indenter|probe|sphere) diameter")
_DEPTH = re.compile(r"(?:indentation|target|maximum|max) (?:depth|displacement|indentation|extension)|depth")
_HOLD = re.compile(r"(?:hold|dwell|relaxation)(?: time| duration)?(?: 1)?")
_FOLDER_KIND = re.compile(r"\.is_([a-z]+)(?:_RawData|_Exports)?(?:[/\\.]|$)", re.IGNORECASE)


def header_entries(header: Sequence[Row]) -> dict[str, str]:
    """Header lines as ``key -> text``; a value keeps its unit, a repeated key gets a number.

    >>> header_entries([("Test : Rate 1", "10.00000", "mm/min")])
    {'Test : Rate 1': '10.00000 mm/min'}
    """
    entries: dict[str, str] = {}
    for row in header:
        key = row[0].strip()
        value = " ".join(cell.strip() for cell in row[1:] if cell.strip())
        if not key:
            continue
        name, count = key, 1
        while name in entries:
            count += 1
            name = f"{key} ({count})"
        entries[name] = value
    return entries


def _last_part(key: str) -> str:
    """A key without its group: ``"Test : Rate 1"`` gives ``"rate 1"``."""
    return plain_words(key.rsplit(" : ", 1)[-1])


def specimen_in(metadata: Mapping[str, str]) -> str | None:
    """The specimen's label, ID or name, in this order, where one is filled in."""
    found = []
    for position, (key, value) in enumerate(metadata.items()):
        rank = specimen_key_rank(key)
        if rank is not None and value and not _NOTHING.fullmatch(value):
            found.append((rank, position, value))
    return min(found)[2] if found else None


def protocol_of(metadata: Mapping[str, str], path: str, *, decimal: str | None) -> Protocol:
    """What the header and the folder's name state about the test.

    Parameters
    ----------
    metadata : mapping
        Entries of the header.
    path : str
        As the user named it; Bluehill names folders ``X.is_comp_RawData``.
    decimal : str or None
        Decimal mark of the file.
    """
    mark = decimal or "."
    diameter = stated(metadata, _TIP_DIAMETER, "displacement", mark)
    radius = stated(metadata, _TIP_RADIUS, "displacement", mark)
    kind = _FOLDER_KIND.search(path)
    return Protocol(
        kind=kind[1].lower() if kind else None,
        speed_mm_s=stated(metadata, _RATE, "speed", mark),
        depth_mm=stated(metadata, _DEPTH, "displacement", mark),
        hold_s=stated(metadata, _HOLD, "time", mark),
        tip_radius_mm=radius if radius is not None or diameter is None else diameter / 2,
    )


def stated(
    metadata: Mapping[str, str], keys: re.Pattern[str], quantity: Quantity, decimal: str
) -> float | None:
    """The first value above zero under such a key that has a unit of this quantity.

    Parameters
    ----------
    metadata : mapping
        Entries of the header.
    keys : pattern
        Matches the whole last part of a key, in plain words.
    quantity : str
    decimal : str
        Decimal mark of the file.
    """
    for key, text in metadata.items():
        if not keys.fullmatch(re.sub(r" (?:mm|s|n|mm s|mm min)$", "", _last_part(key))):
            continue
        number, _, unit = text.rpartition(" ")
        value = parse_number(number, decimal)
        if isinstance(value, CellFault) or value <= 0.0:
            continue
        try:
            return value * factor_to(unit, quantity)
        except ValueError:
            continue
    return None
