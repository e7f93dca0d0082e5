"""Contents of a header: keys in nine languages, entries, the specimen's name, the protocol, the clock."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache

from tissueid.ingest.numbers import CellFault, looks_numeric, parse_number
from tissueid.ingest.vocabulary import plain_words, specimen_key_rank
from tissueid.trial import Protocol
from tissueid.units import Quantity, factor_to, quantity_of

_FIRST = r"(?: 1)?"
RATE = re.compile(
    r"(?:test |crosshead |ramp |loading |indentation |piezo |displacement |machine )?(?:rate|speed|velocity)"
    rf"{_FIRST}|v1|test ?geschwindigkeit{_FIRST}|rate{_FIRST}"
    rf"|(?:pruf|eindring|verfahr|traversen)?geschwindigkeit{_FIRST}"
    rf"|vitesse(?: d essai| de (?:la )?traverse| d indentation)?{_FIRST}|taux{_FIRST}"
    rf"|velocidad(?: de(?:l)? (?:ensayo|la cruceta|indentacion))?{_FIRST}|tasa{_FIRST}"
    rf"|velocidade(?: d[eo] (?:ensaio|teste|indentacao))?{_FIRST}|taxa{_FIRST}"
    rf"|velocita(?: di prova| della traversa| di indentazione)?{_FIRST}"
    rf"|predkosc(?: (?:badania|testu|trawersy))?{_FIRST}"
    rf"|(?:试验|测试|加载|压入)?(?:速度|速率){_FIRST}|試験速度{_FIRST}"
)
DEPTH = re.compile(
    r"(?:indentation|penetration|target|maximum|max) (?:depth|displacement|indentation|extension)|depth"
    r"|ramp amplitude|eindring(?:tiefe|weg)|zieltiefe"
    r"|profondeur(?: d indentation| maximale| de penetration)?|enfoncement(?: maximal)?"
    r"|profundidad(?: de (?:indentacion|penetracion)| maxima)?"
    r"|profundidade(?: de (?:indentacao|penetracao)| maxima)?"
    r"|profondita(?: di (?:indentazione|penetrazione)| massima)?"
    r"|glebokosc(?: (?:wglebienia|indentacji|zaglebienia))?|压入深度|压痕深度|最大深度|押込み深さ"
)
HOLD = re.compile(
    rf"(?:hold|dwell|relaxation|wait)(?:ing)?(?: time| duration)?{_FIRST}|fixed relaxation time"
    rf"|(?:halte|relaxations|verweil)(?:zeit|dauer){_FIRST}"
    rf"|(?:temps|duree) (?:de )?(?:maintien|relaxation|pause){_FIRST}"
    rf"|(?:tiempo|duracion) de (?:retencion|mantenimiento|espera|relajacion){_FIRST}"
    rf"|(?:tempo|duracao) de (?:retencao|espera|manutencao|relaxamento|relaxacao){_FIRST}"
    rf"|(?:tempo|durata) di (?:mantenimento|attesa|rilassamento|tenuta){_FIRST}"
    rf"|czas (?:przetrzymania|utrzymania|relaksacji|wytrzymania){_FIRST}"
    rf"|(?:保持|保载|松弛)时间{_FIRST}|保持時間{_FIRST}"
)
LOAD_LIMIT = re.compile(
    r"(?:maximum |max |upper )?(?:load|force) (?:limit|threshold|trigger)|trigger (?:load|force)"
    r"|kraft(?:grenze|grenzwert|schwelle)|limite (?:de|di) (?:force|charge|carga|fuerza|forca|forza|carico)"
    r"|granica (?:sily|obciazenia)|(?:载荷|力)(?:上限|限值)|荷重上限"
)
TIP_RADIUS = re.compile(
    r"(?:tip|tool|indenter|probe|sphere) radius|(?:spitzen|kugel|indenter|eindringkorper)radius"
    r"|rayon (?:de (?:la )?(?:pointe|bille)|de l indenteur)|radio (?:de la (?:punta|bola)|del indentador)"
    r"|raio (?:da ponta|do indentador)|raggio (?:della punta|dell indentatore|del penetratore)"
    r"|promien (?:koncowki|wglebnika)|压头半径|探头半径"
)
TIP_DIAMETER = re.compile(
    r"(?:tip|tool|indenter|probe|sphere) diameter|(?:spitzen|kugel|indenter|stempel)durchmesser"
    r"|diametre (?:de (?:la )?(?:pointe|bille)|de l indenteur|du poincon)"
    r"|diametro (?:de la (?:punta|bola)|del indentador|da ponta|do indentador|della punta|del penetratore)"
    r"|srednica (?:koncowki|wglebnika)|压头直径|探头直径"
)
_ALL = (RATE, DEPTH, HOLD, LOAD_LIMIT, TIP_RADIUS, TIP_DIAMETER)
_UNIT_AT_END = re.compile(r" (?:(?:m|\u03bc|u|n)?m(?: (?:s|sec|min))?|s|sec|n)$")


@cache
def last_part(key: str) -> str:
    """A key without group, unit and final colon: ``"Test : Rate 1 (mm/min)"`` gives ``"rate 1"``."""
    return _UNIT_AT_END.sub("", plain_words(key.rsplit(" : ", 1)[-1]))


def is_protocol_key(key: str) -> bool:
    """True where a header key states rate, depth, hold, load limit or tip."""
    return any(pattern.fullmatch(last_part(key)) for pattern in _ALL)


_NOTHING = re.compile(r"<.*>|-+|n/?a|none", re.IGNORECASE)
#: Hours, minutes and seconds.
_CLOCK = re.compile(r"(\d+):([0-5]?\d):([0-5]?\d(?:[.,]\d+)?)")
UNIT_OF_KEY = re.compile(r".*(?:[(\[]([^()\[\]]+)[)\]]|,\s*(\S+))", re.DOTALL)
_FOLDER_KIND = re.compile(r"\.is_([a-z]+)(?:_RawData|_Exports)?(?:[/\\.]|$)", re.IGNORECASE)


def header_entries(header: Sequence[Sequence[str]]) -> dict[str, str]:
    """Header lines as ``key -> text``; a value keeps its unit, a repeated key gets a number.

    Where keys, values and units stand below each other, each on its line, they are put together.

    >>> header_entries([("Test : Rate 1", "10.00000", "mm/min")])
    {'Test : Rate 1': '10.00000 mm/min'}
    >>> header_entries([("Test : Rate 1",), ("10.00000",), ("mm/min",)])
    {'Test : Rate 1': '10.00000 mm/min'}
    """
    entries: dict[str, str] = {}
    for row in _lying(header):
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


def _lying(header: Sequence[Sequence[str]]) -> list[Sequence[str]]:
    """A header whose cells stand below each other, laid down; any other as it is."""
    lines = [row[0].strip() for row in header if row[0].strip() and not any(map(str.strip, row[1:]))]
    if len(lines) < 2 or len(lines) < len(header) or not any(map(_is_key, lines)):
        return list(header)
    rows: list[list[str]] = []
    for line in lines:
        current = rows[-1] if rows else []
        if _is_key(line) or len(current) in (0, 3):
            rows.append([line])
        elif len(current) == 1 or (looks_numeric(current[1]) and quantity_of(line) is not None):
            current.append(line)
        else:
            rows.append([line])
    return [tuple(row) for row in rows]


def _is_key(line: str) -> bool:
    return " : " in line or specimen_key_rank(line) is not None or is_protocol_key(line)


def specimen_in(metadata: Mapping[str, str]) -> str | None:
    """The specimen's label, ID or name, in this order, where one is filled in."""
    found = []
    for position, (key, value) in enumerate(metadata.items()):
        rank = specimen_key_rank(key)
        if rank is not None and value and not _NOTHING.fullmatch(value):
            found.append((rank, position, value))
    return min(found)[2] if found else None


def protocol_of(metadata: Mapping[str, str], path: str, *, decimal: str | None) -> Protocol:
    """Protocol that the header and the folder's name state."""
    mark = decimal or "."
    diameter = stated(metadata, TIP_DIAMETER, "displacement", mark)
    radius = stated(metadata, TIP_RADIUS, "displacement", mark)
    kind = _FOLDER_KIND.search(path)
    return Protocol(
        kind=kind[1].lower() if kind else None,
        speed_mm_s=stated(metadata, RATE, "speed", mark),
        depth_mm=stated(metadata, DEPTH, "displacement", mark),
        hold_s=stated(metadata, HOLD, "time", mark),
        tip_radius_mm=radius if radius is not None or diameter is None else diameter / 2,
        load_limit_N=stated(metadata, LOAD_LIMIT, "force", mark),
    )


def stated(
    metadata: Mapping[str, str], keys: re.Pattern[str], quantity: Quantity, decimal: str
) -> float | None:
    """The first value above zero under such a key that has a unit of this quantity."""
    for key, text in metadata.items():
        if not keys.fullmatch(last_part(key)):
            continue
        if quantity == "time" and (clock := _CLOCK.fullmatch(text)):
            seconds = 3600.0 * float(clock[1]) + 60.0 * float(clock[2]) + float(clock[3].replace(",", "."))
            return seconds if seconds > 0.0 else None
        number, _, unit = text.rpartition(" ")
        if not number:  # the unit stands at the end of the key: "Velocity, mm/s"
            in_key = UNIT_OF_KEY.fullmatch(key.rstrip(": "))
            number, unit = text, "" if in_key is None else in_key[1] or in_key[2]
        value = parse_number(number, decimal)
        if isinstance(value, CellFault) or value <= 0.0:
            continue
        try:
            return value * factor_to(unit, quantity)
        except ValueError:
            continue
    return None


#: Names of a rate or interval at which samples follow each other, accents stripped.
_SAMPLING = re.compile(
    r"sampl|abtast|mess(?:rate|freq)|acqui|daq|logging|scan|data|echantillonnage|muestreo|campionamento"
    r"|amostragem|probkowania|采样|サンプリング"
)
_OF_A_RATE = re.compile(r"rate|fre[qc]|czestotliwosc|率|レート|周波数")
_OF_A_STEP = re.compile(r"interval|period|step|spacing|schritt|scan time|间隔|間隔|周期")
_BY_ITSELF = re.compile(r"(fs)|dt|delta ?[xt]")
#: Names of what was kept of the samples; it is a rate where its unit or name says so.
_KEPT = re.compile(
    r"record|stor(?:e|age)|save|output|export|decimated|reduced|speicher|ausgabe|aufzeichn|enregistr|grabacion"
    r"|registr|保存|记录|記録"
)
_OF_KEPT = re.compile(r"rate|fre[qc]|interval|率|レート|周波数|间隔|間隔")
#: Names and values that say how many samples became one row.
_THINNED = re.compile(
    r".*(?:decimat|dezim|(?:down|over|sub|under|re) ?sampl|reduc|redukt|skip|every|jede|export|thinn|binning)"
    r".*|(?:log|sampl|data|storage)\w* ratio|averag\w*(?: (?:samples|points|count|factor|over|number))*"
    r"|mittel(?:ung|wertbildung)?|moyennage"
)
_SO_MANY = re.compile(
    r"(?:every )?(?:1 ?[:/] ?)?(\d+)(?:st|nd|rd|th|\.)?"
    r"(?: ?(?:x|times|rows?|samples?|points?|pts|scans?|values?|werte?|punkte?))?"
)
_STATED = re.compile(r"([\d.]+(?:[eE][+-]?\d+)?)\s*([^\W\d_]+)")
#: Units of a rate, in samples a second.
_RATES = {
    "hz": 1.0, "khz": 1e3, "1/s": 1.0, "/s": 1.0, "s/s": 1.0, "sps": 1.0,
    "samples/s": 1.0, "samples/sec": 1.0, "points/s": 1.0, "points/sec": 1.0, "pts/s": 1.0, "pts/sec": 1.0,
    "scans/s": 1.0, "scans/sec": 1.0,
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
            key, _, text = re.sub("[:=,]", "\0", key, count=1).partition("\0")
        words = plain_words(key)
        many = _SO_MANY.fullmatch(text.strip().casefold())
        if many is not None and int(many[1]) > 1 and _THINNED.fullmatch(words):
            return None  # of a rate that is stated nobody knows which it is
        alone = _BY_ITSELF.fullmatch(words)
        sampled = _SAMPLING.search(words) and (_OF_A_RATE.search(words) or _OF_A_STEP.search(words))
        rated = text.rpartition(" ")[2].casefold() in _RATES
        kept = _KEPT.search(words) and (_OF_KEPT.search(words) or rated)
        if not (alone or sampled or kept):
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
