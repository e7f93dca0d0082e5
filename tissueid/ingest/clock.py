"""Clock of a table without a column of time: the sampling rate that the user or a header states."""

from __future__ import annotations

import re
from collections.abc import Mapping

from tissueid.ingest.header import UNIT_OF_KEY
from tissueid.ingest.numbers import CellFault, parse_number
from tissueid.ingest.vocabulary import plain_words
from tissueid.units import factor_to

#: Names of a rate or interval at which samples follow each other, accents stripped.
_SAMPLING = re.compile(
    r"sampl|abtast|mess(?:rate|freq)|acqui|daq|logging|scan|data|echantillonnage|muestreo|campionamento"
    r"|amostragem|probkowania|采样|サンプリング"
)
_OF_A_RATE = re.compile(r"rate|fre[qc]|czestotliwosc|率|レート|周波数")
_OF_A_STEP = re.compile(r"interval|period|step|spacing|schritt|间隔|間隔|周期")
_BY_ITSELF = re.compile(r"(fs)|dt|delta ?[xt]")
_STATED = re.compile(r"([\d.]+(?:[eE][+-]?\d+)?)\s*([^\W\d_]+)")
#: Units of a rate, in samples a second.
_RATES = {
    "hz": 1.0, "khz": 1e3, "1/s": 1.0, "/s": 1.0, "s/s": 1.0, "sps": 1.0,
    "samples/s": 1.0, "samples/sec": 1.0, "points/s": 1.0, "pts/s": 1.0, "scans/s": 1.0,
}  # fmt: skip
#: Intervals [s] that a recording of a contact may have.
_SHORTEST, _LONGEST = 1e-7, 1e3


def _interval_s(value: float, unit: str, *, of_a_rate: bool | None) -> float | None:
    """Interval of a rate or an interval by its unit, else by its name; ``None`` where it is neither."""
    if unit.casefold() in _RATES:
        found = 1.0 / (value * _RATES[unit.casefold()]) if value > 0.0 else 0.0
    elif unit:
        try:
            found = value * factor_to(unit, "time")
        except ValueError:
            return None
    elif of_a_rate is None:
        return None
    else:
        found = value if not of_a_rate else 1.0 / value if value > 0.0 else 0.0
    return found if _SHORTEST < found < _LONGEST else None


def asked_interval(text: str) -> float | None:
    """Interval that the user states in place of a column, as ``100Hz`` or ``10 ms``."""
    match = _STATED.fullmatch(text.strip())
    value = None if match is None else parse_number(match[1], ".")
    if match is None or not isinstance(value, float):
        return None
    return _interval_s(value, match[2], of_a_rate=None)


def stated_interval(metadata: Mapping[str, str], decimal: str) -> float | None:
    """Interval [s] of the samples that a header states; ``None`` where it states none, or several."""
    found: list[float] = []
    for key, text in metadata.items():
        if not text:  # of a line that is one cell
            key, _, text = re.sub("[:=]", "\0", key, count=1).partition("\0")
        words = plain_words(key)
        alone = _BY_ITSELF.fullmatch(words)
        if alone is None and not (
            _SAMPLING.search(words) and (_OF_A_RATE.search(words) or _OF_A_STEP.search(words))
        ):
            continue
        of_a_rate = bool(alone[1]) if alone else _OF_A_STEP.search(words) is None
        in_key = UNIT_OF_KEY.fullmatch(key.rstrip(": "))
        number, _, unit = text.strip().partition(" ")
        if not isinstance(parse_number(unit, decimal), CellFault):
            unit = ""  # the interval of each channel in a cell of its own
        value = parse_number(number, decimal)
        unit = unit.strip() or ("" if in_key is None else in_key[1] or in_key[2])
        interval = None if isinstance(value, CellFault) else _interval_s(value, unit, of_a_rate=of_a_rate)
        if interval is not None:
            found.append(interval)
    return found[0] if found and max(found) < min(found) * (1.0 + 1e-6) else None
