"""Units as laboratories print them, converted once at the boundary to s, mm and N.

Not a unit system of our own: the factors are pint's.  Those of the units that machines print are kept
here, and pint is loaded on the first other one (it costs half a second).  What is ours is the list of
spellings that pint does not read: ``(sec)``, ``gf``, ``毫米``, ``кгс``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from typing import Any, Literal, get_args

#: What can be converted: the three channels of a recording, the rate of a protocol, and the channels of a
#: normalised recording.
Quantity = Literal["time", "displacement", "force", "speed", "strain", "stress"]

#: The unit used inside, by quantity.
INTERNAL_UNITS: Mapping[Quantity, str] = {
    "time": "s", "displacement": "mm", "force": "N", "speed": "mm/s", "strain": "mm/mm", "stress": "MPa",
}  # fmt: skip

#: Spellings seen in exports that pint does not know, or takes for something else.
_SPELLINGS: Mapping[str, str] = {
    "g": "force_gram", "cm³": "cm**3", "%": "percent",
    # Cyrillic: a capital С is Celsius, Нм a torque, Гс a gauss
    "с": "s", "мс": "ms", "мкс": "us", "м": "m", "нм": "nm", "Н": "N", "кН": "kN", "мН": "mN", "мкН": "uN",
    "г": "force_gram", "гс": "force_gram",
}  # fmt: skip
#: Words that mean one unit however they are capitalised; ``MN``, ``Ms`` and ``G`` may mean two.
#: Masses, where a force is printed, are their weight under standard gravity.
_WORDS: Mapping[str, str] = {
    "s": "s sec secs sek seg sn second seconds sekunde sekunden seconde secondes secondi segundo segundos"
    " 秒 초 сек",
    "ms": "msec msecs millis millisecond milliseconds millisekunden 毫秒 ミリ秒 мсек",
    "us": "usec usecs µsec micros microsecond microseconds 微秒",
    "min": "min mins minute minutes minuten 分 мин",
    "hour": "hr hrs hour hours",
    "mm": "mm millimeter millimeters millimetre millimetres millimetri milímetros millimètres 毫米 ミリ мм",
    "cm": "cm centimeter centimeters centimetre centimetres 厘米 см",
    "um": "um micron microns micrometer micrometers micrometre micrometres 微米 мкм",
    "nm": "nanometer nanometers nanometre nanometres 纳米",
    "inch": "in inch inches",
    "thou": "mil mils thou",
    "newton": "newton newtons 牛 牛顿 ニュートン",
    "kN": "kn kilonewton kilonewtons 千牛",
    "mN": "millinewton millinewtons 毫牛",
    "uN": "micronewton micronewtons 微牛",
    "force_gram": "gf gr gram grams gram-force grams-force gram_force 克 克力",
    "force_kilogram": "kg kgf kgs kp kilogram kilograms kilogram-force kilopond 公斤 公斤力 千克 千克力"
    " кг кгс",
    "force_pound": "lb lbs lbf pound pounds pound-force pounds-force",
    "force_ounce": "oz ozf ounce ounces ounce-force",
}
_FOLDED = {word: unit for unit, words in _WORDS.items() for word in words.split()}
#: What machines print most: what it measures, and pint's factor.
KNOWN_UNITS: Mapping[str, tuple[Quantity, float]] = {
    "sec": ("time", 1.0),
    "ms": ("time", 0.001),
    "min": ("time", 60.0),
    "um": ("displacement", 0.001),
    "µm": ("displacement", 0.001),
    "m": ("displacement", 1000.0),
    "kN": ("force", 1000.0),
    "mN": ("force", 0.001),
    "mm/min": ("speed", 1.0 / 60.0),
    "mm/sec": ("speed", 1.0),
}
#: Words over columns that are no unit, though they are shaped like one.
KNOWN_WORDS = frozenset(
    {"Time", "Extension", "Load", "Displacement", "Force", "Position", "Depth", "Strain", "Stress"}
)
#: What motors and converters count: of no dimension, and no strain.
_COUNTS = frozenset({"step", "steps", "tick", "ticks", "count", "counts", "bit", "bits", "adc", "pulses"})
#: Letters that number repeats ("Load-a"), though they may be years, bits or days.
REPEATS = frozenset("abcde")
#: Brackets as East Asian keyboards write them, and others around units.
OTHER_BRACKETS = str.maketrans("（）［］【】{}<>", "()[][]()()")
_BRACKETS = re.compile(r"^\s*[(\[]\s*(.*?)\s*[)\]]\s*$", re.DOTALL)
#: A unit is a short word, perhaps a product of powers: never hand anything else to a parser.
_UNIT_SHAPED = re.compile(r"[^\W\d_][\w²³]*(?:(?:\s?[/*·]\s?|\^|\*\*|\s)-?[\w²³]+){0,4}|%|µ\w+")
_LONGEST_UNIT = 24
#: Signs of the inch.
_INCHES = frozenset({'"', "''", "″"})


def bare_unit(text: str) -> str:
    """The unit without brackets, padding or a final full stop: ``"(sec) "`` gives ``"sec"``."""
    text = text.translate(OTHER_BRACKETS)
    match = _BRACKETS.match(text)
    bare = (match[1] if match else text).strip().rstrip(".")
    return "in" if bare in _INCHES else bare


@cache
def _registry() -> Any:
    """Pint's registry, made on first use."""
    import pint  # 0.3 s: only where a unit is not already the internal one

    return pint.UnitRegistry()


@cache
def _parsed(unit: str) -> Any | None:
    """Bare unit as pint takes it, or ``None`` where it knows nothing of the name."""
    spelled = _SPELLINGS.get(unit) or _FOLDED.get(unit.casefold())
    if len(unit) > _LONGEST_UNIT or (spelled is None and not _UNIT_SHAPED.fullmatch(unit)):
        return None
    import pint

    try:
        return _registry().parse_units(spelled or unit)
    # what is shaped like a unit may be none that its parser has thought of
    except (pint.errors.PintError, ValueError, TypeError, AttributeError, AssertionError, ArithmeticError):
        return None


@cache
def factor_to(unit_text: str, quantity: Quantity) -> float:
    """The factor that turns a value in a printed unit into s, mm, N or mm/s (strain: 1, stress: MPa).

    ``unit_text``: as printed, brackets allowed: ``"(sec)"``, ``"kN"``, ``"[µm]"``, ``"mm/min"``; ``quantity``
    {"time", "displacement", "force", "speed", "strain", "stress"}.  Returns multiply by this.  Raises
    ValueError: unknown unit, or a unit of something else; the message names it and what would do.
    """
    if quantity not in get_args(Quantity):
        raise ValueError(f"unknown quantity {quantity!r}, one of {', '.join(get_args(Quantity))}")
    unit = bare_unit(unit_text)
    internal = INTERNAL_UNITS[quantity]
    if unit == internal:
        return 1.0
    known = KNOWN_UNITS.get(unit)
    if known is not None and known[0] == quantity:
        return known[1]
    parsed = _parsed(unit)
    if parsed is None:
        raise ValueError(f"unknown unit {unit!r} of {quantity}: write a unit such as {_examples(quantity)}")
    if parsed.dimensionality != _registry().parse_units(internal).dimensionality:
        msg = f"unit {unit!r} does not measure {quantity}: write a unit such as {_examples(quantity)}"
        raise ValueError(msg)
    # through base units, so that 1 kN is 1000 N and not 999.9999999999999
    return float(_registry().Quantity(1, parsed).to(internal).magnitude)


@cache
def quantity_of(unit_text: str) -> Quantity | Literal["other"] | None:
    """Quantity of a printed unit; ``"other"`` for a known unit of anything else, ``None`` if unknown."""
    unit = bare_unit(unit_text)
    for quantity, internal in INTERNAL_UNITS.items():
        if unit == internal:
            return quantity
    if unit in KNOWN_UNITS:
        return KNOWN_UNITS[unit][0]
    if unit.casefold() in _COUNTS:
        return "other"
    parsed = None if unit in KNOWN_WORDS or unit in REPEATS else _parsed(unit)
    if parsed is None:
        return None
    for quantity, internal in INTERNAL_UNITS.items():
        if parsed.dimensionality == _registry().parse_units(internal).dimensionality:
            return quantity
    return "other"


def _examples(quantity: Quantity) -> str:
    return {
        "time": "s, ms, min",
        "displacement": "mm, um, m, in",
        "force": "N, kN, mN, kgf, gf, lbf",
        "speed": "mm/s, mm/min",
        "strain": "%, mm/mm",
        "stress": "Pa, kPa, MPa, psi",
    }[quantity]
