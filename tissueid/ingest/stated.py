"""Values as a study file states them: ``thickness_mm = 5`` or ``thickness = "5 mm"``, one key inside.

A key that ends in a unit holds a number in that unit, or text with another unit of the same kind; the same
key without its unit takes text with a unit only.  A number without a unit is never taken.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import Any

from tissueid.units import factor_to

_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*$", re.DOTALL)
_SECONDS_PER_HOUR = 3600.0
#: Julian year: the age of an animal is not known to leap days.
_SECONDS_PER_YEAR = 365.25 * 24 * _SECONDS_PER_HOUR
_HERTZ = {"Hz": 1.0, "kHz": 1e3, "1/s": 1.0, "S/s": 1.0}
_DEGREES = {"deg": 1.0, "degree": 1.0, "degrees": 1.0, "°": 1.0, "rad": 57.29577951308232}
_CELSIUS = {"C", "°C", "degC", "celsius", "Celsius"}
_KELVIN_AT_ZERO_C = 273.15


def _stiffness(power: int) -> Callable[[float, str], float]:
    """Force over a power of length, as a coefficient of F_s(x) or K(x) is."""
    exponent = "" if power == 1 else str(power)

    def convert(value: float, unit: str) -> float:
        force, slash, length = unit.partition("/")
        plain = length.removesuffix(exponent).removesuffix("^") if length.endswith(exponent) else ""
        if not slash or not plain:
            msg = f"unit {unit!r} does not measure stiffness: write N/mm{exponent} or kN/mm{exponent}"
            raise ValueError(msg)
        return value * factor_to(force, "force") / factor_to(plain, "displacement") ** power

    return convert


def _temperature(value: float, unit: str) -> float:
    if unit in _CELSIUS:
        return value
    if unit == "K":
        return value - _KELVIN_AT_ZERO_C
    msg = f"unit {unit!r} of temperature is not known: write C or K"
    raise ValueError(msg)


def _of(table: Mapping[str, float]) -> Callable[[float, str], float]:
    def convert(value: float, unit: str) -> float:
        if unit not in table:
            msg = f"unit {unit!r} is not known here: write one of {', '.join(table)}"
            raise ValueError(msg)
        return value * table[unit]

    return convert


#: Unit at the end of a key -> how text in another unit becomes a number in it.
_CONVERT: Mapping[str, Callable[[float, str], float]] = {
    "N_per_mm": _stiffness(1),
    "N_per_mm2": _stiffness(2),
    "N_per_mm3": _stiffness(3),
    "mm_s": lambda value, unit: value * factor_to(unit, "speed"),
    "mm": lambda value, unit: value * factor_to(unit, "displacement"),
    "s": lambda value, unit: value * factor_to(unit, "time"),
    "h": lambda value, unit: value * factor_to(unit, "time") / _SECONDS_PER_HOUR,
    "years": lambda value, unit: value * factor_to(unit, "time") / _SECONDS_PER_YEAR,
    "N": lambda value, unit: value * factor_to(unit, "force"),
    "Hz": _of(_HERTZ),
    "deg": _of(_DEGREES),
    "C": _temperature,
}

#: Units that a key can't spell.
_PRINTED = {"N_per_mm": "N/mm", "mm_s": "mm/s"}


def unit_of(key: str) -> str | None:
    """The unit at the end of a key, ``None`` where it has none: ``"thickness_mm_sd"`` gives ``"mm"``."""
    bare = key.removesuffix("_sd")
    return next((unit for unit in _CONVERT if bare.endswith(f"_{unit}")), None)


def without_unit(key: str) -> str:
    """``"thickness_mm_sd"`` without its unit: ``"thickness_sd"``."""
    unit = unit_of(key)
    if unit is None:
        return key
    sd = "_sd" if key.endswith("_sd") else ""
    return key.removesuffix("_sd").removesuffix(f"_{unit}") + sd


def canonical_key(key: str, value: Any, known: Mapping[str, Any]) -> str:
    """The key under which a value is kept.

    ``key``: as written; ``known``: keys that there are.  Raises ValueError: there is no such key (the nearest
    are named), or a number has no unit.
    """
    if key in known:
        return key
    whole = [name for name in known if without_unit(name) == key and unit_of(name) is not None]
    if len(whole) == 1:
        if isinstance(value, str):
            return whole[0]
        unit = _PRINTED.get(str(unit_of(whole[0])), unit_of(whole[0]))
        msg = f'{key} = {value} has no unit: write {whole[0]} = {value}, or {key} = "{value} {unit}"'
        raise ValueError(msg)
    near = get_close_matches(key, known, n=2, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(known)}"
    msg = f"there is no key {key!r} here; {hint}"
    raise ValueError(msg)


def in_unit(key: str, text: str, *, shown: str | None = None) -> float:
    """A number in the unit of its key, from text with a unit: ``("speed_mm_s", "250 mm/min")`` gives 4.1667.

    ``key``: ends in its unit; ``shown``: what a message calls the key.  Raises ValueError: no number, no
    unit, or a unit of something else.
    """
    unit = unit_of(key)
    key = shown or key
    match = _NUMBER.match(text)
    if unit is None or match is None:
        msg = f'{key} = "{text}" is not a number with a unit: write a decimal point, a space, the unit'
        raise ValueError(msg)
    written = match[2]
    if not written:
        msg = f'{key} = "{text}" has no unit: write {key} = {match[1]} without quotes, or add the unit'
        raise ValueError(msg)
    if written.startswith(","):
        msg = f'{key} = "{text}" has a decimal comma: write a point'
        raise ValueError(msg)
    try:
        return _CONVERT[unit](float(match[1]), written)
    except ValueError as error:
        msg = f'{key} = "{text}": {error}'
        raise ValueError(msg) from error
