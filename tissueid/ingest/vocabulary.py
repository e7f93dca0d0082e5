"""The words test machines print: column names and header keys in nine languages, names in fourteen more.

These are Bulgarian, Czech, Danish, Dutch, Finnish, Greek, Hungarian, Korean, Norwegian, Romanian, Russian,
Swedish, Turkish and Ukrainian.
One table says which printed name is a time, a displacement or a force, and which of several is taken: the
lower rank wins, the leftmost column among equals.  It is the written rule behind the ``column_choice`` flag.
"""

from __future__ import annotations

import re
import unicodedata
from functools import cache
from typing import Literal

from tissueid.units import OTHER_BRACKETS, quantity_of

#: The three channels every recording must have.
Channel = Literal["time", "displacement", "force"]

CHANNELS: tuple[Channel, ...] = ("time", "displacement", "force")

_SENSE = r"(?:compressive|compression|flexural|flexure|bending|tensile|tension|druck|biege|zug)"
_SENSE_AFTER = (
    r"(?: (?:de|en|a|di|w) (?:la )?(?:compression|compresion|compressao|compressione|traction|flexion))"
)

#: Names of a channel by their rank.
_NAMES: dict[Channel, dict[int, str]] = {
    "time": {
        0: (  # the time of the test
            r"(?:total |test |running |run |measured )?timer?(?: measurement)?|seconds?|secs?|ms|msecs?"
            r"|millis(?:econds?)?|us|usecs?|micros(?:econds?)?|mins|minutes?|zeit|pruf ?zeit"
            r"|test ?zeit|versuchszeit|laufzeit|messzeit"
            r"|temps(?: d essai)?|temps total|duree|tiempo(?: de ensayo| total)?|tempo(?: di prova| (?:de"
            r"|do) ensaio| total)?|czas(?: testu| proby)?|godzina|(?:测试|试验|試験|測定|計測)?(?:时间|時間)"
            r"|(?:test ?)?tijd|tid|cas|zaman|sure|время|време|시간|aika|timp|ido|χρονοσ"
        ),
        1: (  # elapsed time of a cycle or step, which starts again; a time stamp; LabVIEW's X_Value
            r"(?:cycle |step |segment )?elapsed(?: time)?|time elapsed|(?:cycle|step|segment) time"
            r"|temps ecoule|経過時間|時刻|time ?stamp|ts|epoch|unix time|date ?time|zeitstempel|uhrzeit"
            r"|x value|tiempo transcurrido"
        ),
    },
    "displacement": {
        0: (  # depth of the tool in the tissue, measured as such
            r"indentation(?: depth)?|depth(?: of indentation)?|penetration(?: depth)?"
            r"|eindring(?:tiefe|weg)|eindruckung|profondeur(?: d indentation)?|enfoncement|profundidad"
            r"|profundidade|profondita|affondamento|penetra(?:zione|cion|cao)|indenta(?:zione|cion|cao)"
            r"|glebokosc|(?:压入|压痕)?深度|βαθοσ|压入量|(?:押し?込み?|侵入)(?:量|深さ)"
            r"|indring(?:diepte|ing)|intrangningsdjup|hloubka|derinlik|глубина(?: внедрения)?|глибина|깊이"
        ),
        1: (  # travel of the machine from its zero
            r"(?:primary |axial |actuator )?(?:extension|displacement|travel|elongation)(?: measurement)?"
            r"|standard travel|displ?|depl|distance|dist"
            r"|(?:(?:standard|axial|kolben|stempel|zylinder|maschinen|traversen|pruf) ?)?weg|hub"
            r"|verschiebung|verlangerung|verformung|course standard"
            r"|allongement|course(?: (?:de (?:la )?)?(?:traverse|machine|verin))?"
            r"|deplacement(?: (?:de (?:la )?)?(?:traverse|machine|verin))?|traverse"
            r"|crosshead (?:displacement|travel|extension)"
            r"|desplazamiento|alargamiento|carrera|carrera estandar|extensao|deslocamento|alongamento"
            r"|curso|estensione|spostamento|allungamento"
            r"|corsa|corsa standard|przemieszczenie|wydluzenie|droga"
            r"|(?:压头|轴向|横梁)?位移|伸长|伸長|伸び|延伸|拉伸|变形|変位量?|行程|ストローク|ｽﾄﾛｰｸ|ist ?weg"
            r"|verplaatsing|verlenging|forskjutning|forlangning|forskydning|forskyvning|forlengelse"
            r"|vandring|siirtyma|elmozdulas|deplasare|extensie|draha|μετατοπιση|переміщення|преместване"
            r"|posun(?:uti)?|posuv|prodlouzeni|yer degistirme|uzama|deplasman"
            r"|перемещение(?: траверсы)?|смещение|удлинение|ход|변위|신장"
        ),
        2: (  # the same with the sense of the test
            rf"{_SENSE} ?(?:extension|displacement|deflection|weg|verformung)(?: measurement)?"
            rf"|(?:extension|deplacement|extensao|deslocamento|desplazamiento|estensione|spostamento){_SENSE_AFTER}"
            r"|压缩位移|压缩伸长"
        ),
        3: (  # absolute position
            r"(?:absolute )?(?:crosshead|traverse|traversen)(?: absolute?| absolut| position)?"
            r"|traverse absolue|position (?:de (?:la )?|du )?(?:traverse|verin)"
            r"|traversen(?:position|weg absolut)|pos(?:ition)?(?: absolue| z)?|posicion|posizione|pozycja"
            r"|stroke|actuator|height(?: measured| sensor)?|z(?: pos(?:ition)?)?|hoehe|hohe|hauteur|位置"
        ),
        4: (  # what is left between the tools
            r"ecartement entre (?:outils|mors)|(?:tool|grip)(?: to (?:tool|grip))? separation"
            r"|werkzeugabstand|einspannlange|(?:(?:un)?corrected |axial |measured )?gap"
        ),
        5: (  # another sensor
            r"capteur de course|extensometer|extensometre|dehnung|weg ?(?:aufnehmer|sensor|geber)|deflection"
            r"|durchbiegung|strain 1|lvdt|displacement strain 1"
        ),
    },
    "force": {
        0: (  # the load cell
            r"(?:standard |primary |axial |normal |vertical )?(?:force|load)(?: measurement| z| normal)?"
            r"|force standard"
            r"|(?:(?:standard|axial|normal|pruf|kolben|stempel|zylinder) ?)?kraft|last|charge|carga"
            r"|effort(?: normal)?|fuerza(?: estandar)?|forca|forza(?: standard)?|carico|sila(?: standardowa)?"
            r"|obciazenie"
            r"|(?:标准|法向|轴向|试验|試験)?力|力值|载荷|載荷|载重|负荷|負荷|荷重値?|fz|load ?cell|ist ?kraft"
            r"|kracht|belasting|belastning|zatizeni|kuvvet|yuk|сила|нагрузка|усилие|зусилля|하중|시험력|힘"
            r"|voima|forta|δυναμη|φορτιο"
        ),
        1: (  # the same with the sense of the test
            rf"{_SENSE} ?(?:load|force|kraft|last)(?: measurement)?"
            rf"|(?:charge|force|fuerza|carga|forca|forza|carico){_SENSE_AFTER}|压缩载荷|压缩力"
        ),
        # another channel
        2: r"capteur de force|kraft ?(?:aufnehmer|sensor|messdose)|load channel|force channel",
    },
}
#: Rank of a sensor beside which a column of any name may be the travel.
OTHER_SENSOR_RANK = 5
_CHANNEL_NUMBER = re.compile(r"(.*?) ?([1-9])")
#: A channel number above one adds to the rank.
_CHANNEL_PENALTY = 5
#: Rank of none of these names, but a word of them and a unit that agrees.
_LOOSE_RANK = 8
#: Rank of a letter, where it is the only one that could be meant; case matters,
#: for ``T`` is a temperature unless its unit says otherwise.
SYMBOL_RANK = 9
_SYMBOLS: dict[Channel, frozenset[str]] = {
    "time": frozenset({"t"}),
    "displacement": frozenset({*"xXzZduUhLlδ", "delta"}),
    "force": frozenset("FfP"),
}
#: Letters with a unit that agrees: ``s [mm]``, ``ΔL [mm]``, ``P [mN]``, ``F1 (N)``.
_LOOSE_SYMBOLS = {
    "time": re.compile("t[1-9]?"),
    "displacement": re.compile("(?:(?:d|δ ?|delta ?)?[xzduhls]|δ|delta)[1-9]?"),
    "force": re.compile("[fp][1-9]?|f n"),
}
#: Words that will do with a unit that agrees, and what will without a space; so will any name of these two.
_LOOSE_WORDS: dict[Channel, tuple[str, str]] = {
    "time": (r"time|timestamp|\w*zeit|temps|tiempo|tempo|czas|час", "时间"),
    # strain in other languages, and letters of an indenter: with a unit of length alone
    "displacement": (
        r"piston|p[xyz]|(?<=\w )[xy]|pd|deformation|deforma(?:zione|cion|cao|ce)|compression|деформация",
        "位移|^ext$",
    ),
    # what a scale shows, with a unit of force or weight alone
    "force": (r"fn|weight|mass|gewicht|masse|poids|peso|ero", "载荷|压力"),
}
#: Path of a channel in the messages of a robot: ``field.wrench.force.z``, ``/arm/pose/position/z``.
_IN_MESSAGE = re.compile(r"(?:.* )?(?:pose (position z)|wrench (force z))")
#: Where a word begins by its capital alone: ``ProbePos``, ``XForce``.
_CAPITALS = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
#: Rank of a loose name with the letter of a sideways axis.
SIDEWAYS_RANK = 10
_SIDEWAYS = re.compile(r"\bp?[xy]\b")
#: A name with one of these is a rate, a result or another quantity, never a channel.
_NOT_A_CHANNEL = re.compile(
    r"\b(?:stress|strain|rate|speed|velocity|modulus|energy|work|max|maximum|min|minimum|at|per|peak|mean"
    r"|average|sd|std|error|cycle|cycles|count|point|offset|zero|stiffness|contrainte|spannung"
    r"|position [xy]|[xy] position|command(?:ed)?|cmd|set ?point"
    r"|set (?=force|load|pos|disp|dist|travel|depth)|demand(?:ed)?|sp|preset|ref(?:erence)?|limit|threshold"
    r"|shear|lateral|tangential|friction(?:al)?"
    r"|set$|des|goal|desired|programmed|nominal|target|soll\w*|consigne|valor nominal)\b"
)
#: Lengths that are no travel.
_SIZE = re.compile(
    r"\b(?:width|thickness|diam(?:eter)?|radius|wave ?length|breite|dicke|durchmesser|wellenlange|largeur"
    r"|epaisseur|diametre|ancho|espesor)\b"
)

#: A longer text is no key, and would cost the patterns the square of its length.
_LONGEST_KEY = 250
_SPECIMEN_WORDS = re.compile(
    r"\b(?:specimen|proben?\w*|eprouvette|probeta|corpo de prova|provino|probk\w+)\b|试样|试件|样品|样本"
    r"|試験片|試料"
)
_SPECIMEN_NAMING = (
    re.compile(
        r"\blabel\b|bezeichnung|\blibelle\b|\betiquette\b|\bdesignation\b|\betiqueta\b|\brotulo\b"
        r"|etichetta|etykieta|标签|标识|标记|ラヘル"
    ),
    re.compile(r"\bid\b|kennung|identifi\w+|identyfik\w+|编号|番号|nummer"),
    re.compile(r"\bname\b|\w+name\b|\bnom\b|\bnombre\b|\bnome\b|nazwa|oznaczenie|名称"),
)

_COMMENTS = re.compile(
    r"(?:comment|remark|note|annotation)s?|bemerkung(?:en)?|anmerkung(?:en)?|kommentare?|commentaires?"
    r"|remarques?|comentarios?|observac(?:ion|ao|iones|oes)|notas?|commenti|commento|osservazion[ei]|uwagi"
    r"|komentarz|备注|注释|コメント|備考"
)


#: Words for a unit, with their accents and without.
UNIT_WORD = r"(?:unit[eéaà]?s?|einheit(?:en)?|unidad(?:es)?|单位|単位)"
#: Word before a row or over a column of units.
_UNITS_KEY = re.compile(rf"(?:y )?{UNIT_WORD}(?: ?name| label)?s?")


def is_units_key(cell: str) -> bool:
    """True where a cell announces units: ``Units``, ``Einheit:``."""
    return _UNITS_KEY.fullmatch(plain_words(cell.partition(":")[0])) is not None


def is_comment_name(name: str) -> bool:
    """True where a column is named as one of comments, which holds no numbers."""
    return _COMMENTS.fullmatch(plain_words(name)) is not None


@cache
def plain_words(text: str) -> str:
    """Lower case, without accents and punctuation: ``"Temps d'essai"`` gives ``"temps d essai"``."""
    letters = _unaccented(text.replace("ł", "l").replace("Ł", "L")).casefold()
    return " ".join(re.sub(r"[\W_]+", " ", letters).split())


def _unaccented(text: str) -> str:
    return "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))


# as names are compared: Hangul in its letters, kana without their marks
for _ranks in _NAMES.values():
    _ranks.update({rank: _unaccented(pattern) for rank, pattern in _ranks.items()})
_LOOSE: dict[Channel, re.Pattern[str]] = {}
for _channel, (_words, _more) in _LOOSE_WORDS.items():
    _names = () if _channel == "time" else _NAMES[_channel].values()  # prose has "us" and "sure"
    _LOOSE[_channel] = re.compile(rf"\b(?:{'|'.join((_words, *_names))})\b|{_more}")


@cache
def rank_of(name: str, channel: Channel, *, loose: bool) -> int | None:
    """Rank of a printed name, without its unit, for a channel; ``loose``: a word inside it is enough."""
    words, apart = plain_words(name), plain_words(_CAPITALS.sub(" ", name))
    if (path := _IN_MESSAGE.fullmatch(words)) and not _NOT_A_CHANNEL.search(words):
        words = path[1] or path[2]
    for one in dict.fromkeys((words, apart)):
        numbered = _CHANNEL_NUMBER.fullmatch(one)
        for rank, pattern in _NAMES[channel].items():
            if re.fullmatch(pattern, one):
                return rank
            if numbered and re.fullmatch(pattern, numbered[1]):
                return rank + _CHANNEL_PENALTY * (numbered[2] != "1")
    if loose and _LOOSE[channel].search(apart) and not _NOT_A_CHANNEL.search(apart):
        return SIDEWAYS_RANK if _SIDEWAYS.search(apart) and channel != "time" else _LOOSE_RANK
    letter = name.strip()
    if letter in _SYMBOLS[channel] or (loose and _LOOSE_SYMBOLS[channel].fullmatch(words)):
        return SYMBOL_RANK
    return None


def is_unknown(name: str) -> bool:
    """True of a name that is no channel's and of nothing else that is known."""
    words = plain_words(name)
    known = _NOT_A_CHANNEL.search(words) or _SIZE.search(words) or split_name(name)[1]
    return not known and all(rank_of(name, channel, loose=True) is None for channel in CHANNELS)


def is_specimen_name(words: str) -> bool:
    """True where a column, in plain words, tells specimens apart: ``sample``, ``specimen id``."""
    plain = re.sub(r"\bsample\b", "specimen", re.sub(r" (?:no|nr|number|code)$", "", words))
    if specimen_key_rank(plain) is not None:
        return True
    # a "Probenhöhe" is a height
    return _SPECIMEN_WORDS.fullmatch(plain) is not None and re.fullmatch(r"proben\w+", plain) is None


def specimen_key_rank(key: str) -> int | None:
    """0 for a specimen label, 1 for its number or ID, 2 for its name, ``None`` for any other header key."""
    if len(key) > _LONGEST_KEY:
        return None
    words = plain_words(key.rsplit(":", 1)[-1] if not key.endswith(":") else key)
    if not _SPECIMEN_WORDS.search(words):
        return None
    return next((rank for rank, pattern in enumerate(_SPECIMEN_NAMING) if pattern.search(words)), None)


_BRACKETED = re.compile(
    r"(.*?)(?:\s+(?:in|en|em))?\s*[(\[]\s*(?:in\s+(?![)\]\s]))?([^()\[\]]*?)\s*[)\]]\s*", re.DOTALL
)
_AFTER_IN = re.compile(r"(.*[^\s_.])[\s_.]+(?:in|en|em|w|i|в)[\s_.]+([^\s_.]+)")
_AFTER_COMMA = re.compile(r"(.*\S)\s*[,/;|\\]\s*(\S+)\s*", re.DOTALL)
#: MATLAB writes ``Time (s)`` as ``Time_s_``, and a second one as ``Time_s__1``.
_AFTER_GLUE = re.compile(r"(.*[^\s_-])\s?(?:_{1,2}|-)\s?([^\s_\d-][^\s_-]*)(?:_(?:_\d+)?)?", re.DOTALL)
_AFTER_SPACE = re.compile(
    r"(.*\S)\s+(mm|cm|[uµμn]m|[kmuµμ]?N|kgf|gf|lbf|s|sec|ms|msec|мм|мкм|[км]?Н|к?гс|м?с|сек)"
)
_AFTER_DOT = re.compile(r"([^.].*[^.])\.{1,2}([^.\d]+)\.?")
#: ``Time:s``, and ``timeMs``, behind the name of a channel alone: a clock is ``mm:ss``, ``forceZ`` an axis.
_AFTER_COLON = re.compile(r"([^:]*[^\s:])\s*:(\S+)")
_AFTER_CAPITAL = re.compile(r"(.*[a-z])((?:S|Ms|Us)(?:ecs?)?|MS|US|Mm|MM|Um|UM|[KM]n|K?N|Newtons?)")
_CAPITAL_FORCES = {"N": "N", "KN": "kN", "Kn": "kN", "Mn": "mN"}
#: A number of a name that repeats, or a mark of a remark.
_NUMBERED = re.compile(r"(?<=[)\]])(?:[._]\d+|\*+)$")
#: Units that may end a name without brackets: ``Fz, gf``, ``stress_kPa``, ``Stress-kPa``, ``Load N``.
_SPLIT_UNITS = (*CHANNELS, "stress", "strain")
#: A longer text is no name, and would cost the patterns above the square of its length.
_LONGEST_NAME = 250
#: Times that are named by their unit alone.
_NAMED_BY_UNIT = re.compile(
    r"seconds?|secs?|ms|msecs?|millis(?:econds?)?|us|usecs?|micros(?:econds?)?|mins|minutes?", re.IGNORECASE
)
#: A form of clock times, which are read as seconds: ``hh:mm:ss.fff``.
_CLOCK_FORM = re.compile(r"(?:h+:)?m+:s+(?:[.,:][f0sz#]+)?", re.IGNORECASE)
#: A word or sign that may be a unit, or a part of one: ``10^-3 N``, ``″``.
_UNIT_LIKE = re.compile(
    r"[^\W\d_]{1,8}|[x×*·]?\s*(?:10\s*(?:\^|\*\*|[⁻-]?[⁰¹²³⁴-⁹\d]|[⁻-])|1[eE]|0[.,]0*1\b).*"
    r"|[\"'″′#?]{1,2}"
)
#: What ends a name as a unit does, and is none of a channel, or in small letters one of several.
_GLUED_UNIT = re.compile(r"[mµu]?V|[Vv]olts?|[Ss]teps|[Tt]icks|[Cc]ounts|bits|adc|ADC|[mup]n")


def split_name(name: str) -> tuple[str, str | None]:
    """A printed name without its unit, and the unit: ``"Force (kN)"``, ``"Fz, gf"``, ``"time_s"``."""
    if len(name) > _LONGEST_NAME:
        return name, None
    name = _NUMBERED.sub("", name.translate(OTHER_BRACKETS))
    if match := _BRACKETED.fullmatch(name):
        inside = match[2]
        if match[1] and _CLOCK_FORM.fullmatch(inside):
            return match[1], None
        if match[1].endswith((")", "]")) and quantity_of(inside) not in _SPLIT_UNITS:
            before, unit = split_name(match[1])  # a sensor stands behind the unit: "Force [mN] (cell 2)"
            if quantity_of(unit or "") in _SPLIT_UNITS:
                return before, unit
        if match[1] and inside and (quantity_of(inside) is not None or _UNIT_LIKE.fullmatch(inside)):
            before, unit = split_name(match[1])  # it may say so twice: "x_mm [mm]"
            return before if unit == inside else match[1], inside
        return ("time", inside) if not match[1] and quantity_of(inside) == "time" else (name, None)
    if _NAMED_BY_UNIT.fullmatch(name):
        return name, name
    for pattern in (_AFTER_IN, _AFTER_COMMA, _AFTER_GLUE, _AFTER_SPACE, _AFTER_DOT):
        if (match := pattern.fullmatch(name)) and quantity_of(match[2]) in _SPLIT_UNITS:
            return match[1], match[2]
    for pattern in (_AFTER_COLON, _AFTER_CAPITAL):
        if match := pattern.fullmatch(name):
            unit = match[2] if pattern is _AFTER_COLON else _CAPITAL_FORCES.get(match[2], match[2].lower())
            quantity = quantity_of(unit)
            if quantity in CHANNELS and rank_of(match[1], quantity, loose=True) is not None:
                return match[1], unit
    if (match := _AFTER_GLUE.fullmatch(name)) and (match[2] == "n" or _GLUED_UNIT.fullmatch(match[2])):
        return match[1], "N" if match[2] == "n" else match[2]
    return name, None
