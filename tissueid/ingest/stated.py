"""Values and priors as a study file states them: ``thickness_mm = 5`` or ``thickness = "5 mm"``.

A key that ends in a unit holds a number in that unit, or text with another unit of the same kind; the same
key without its unit takes text with a unit only.  A number without a unit is never taken.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from itertools import pairwise
from typing import Any

from tissueid.manifest import TomlTable
from tissueid.priors import PopulationPriors, Priors, SpreadPrior
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
    raise ValueError(f"unit {unit!r} of temperature is not known: write C or K")


def _of(table: Mapping[str, float]) -> Callable[[float, str], float]:
    def convert(value: float, unit: str) -> float:
        if unit not in table:
            raise ValueError(f"unit {unit!r} is not known here: write one of {', '.join(table)}")
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
    return next((unit for unit in _CONVERT if key.removesuffix("_sd").endswith(f"_{unit}")), None)


def without_unit(key: str) -> str:
    """``"thickness_mm_sd"`` without its unit: ``"thickness_sd"``."""
    unit = unit_of(key)
    if unit is None:
        return key
    sd = "_sd" if key.endswith("_sd") else ""
    return key.removesuffix("_sd").removesuffix(f"_{unit}") + sd


def canonical_key(key: str, value: Any, known: Mapping[str, Any]) -> str:
    """The key under which a value is kept."""
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
    raise ValueError(f"there is no key {key!r} here; {hint}")


def in_unit(key: str, text: str, *, shown: str | None = None) -> float:
    """A number in its key's unit, from text: ``("speed_mm_s", "250 mm/min")`` gives 4.1667."""
    unit, key = unit_of(key), shown or key
    match = _NUMBER.match(text)
    if unit is None or match is None:
        why = " is not a number with a unit: write a decimal point, a space, the unit"
    elif not match[2]:
        why = f" has no unit: write {key} = {match[1]} without quotes, or add the unit"
    elif match[2].startswith(","):
        why = " has a decimal comma: write a point"
    else:
        try:
            return _CONVERT[unit](float(match[1]), match[2])
        except ValueError as error:
            why = f": {error}"
    raise ValueError(f'{key} = "{text}"{why}')


#: Keys of a prior that are in the unit of its parameter.
_IN_UNIT = ("mean", "sd", "median")
#: What the names of a second and third branch end in.
_BRANCH = re.compile(r"_b[23]$")

Place = tuple[str | int, ...]


class PriorError(ValueError):
    """Fault of the table, and its place."""

    def __init__(self, where: Place, message: str) -> None:
        super().__init__(message)
        self.where = where


def _bare(name: str) -> str:
    """``stiffness_0_N_per_mm_b2`` without its unit: ``stiffness_0_b2``."""
    branch = _BRANCH.search(name)
    return without_unit(_BRANCH.sub("", name)) + (branch[0] if branch else "")


def _known_name(written: str, known: TomlTable) -> str:
    """The name of a prior; a unit is never guessed."""
    if written in known:
        return written
    if written.startswith("viscosity"):
        message = f"{written} has no prior of its own: viscosity is K times tau, state those two"
        raise PriorError((written,), message)
    whole = [name for name in known if _bare(name) == written]
    near = whole[:1] or get_close_matches(written, known, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(known)}"
    raise PriorError((written,), f"there is no prior of {written!r}; {hint}")


def _numbers(table: Any, name: str, where: Place) -> Any:
    """One table with its texts as numbers in the unit of its name."""
    if not isinstance(table, Mapping):
        return table
    plain = dict(table)
    unit = _BRANCH.sub("", name)
    for key in _IN_UNIT:
        if isinstance(plain.get(key), str) and unit_of(unit) is not None:
            try:
                plain[key] = in_unit(unit, plain[key], shown=key)
            except ValueError as error:
                raise PriorError((*where, key), str(error)) from error
    return plain


def plain_priors(table: TomlTable, known: TomlTable) -> dict[str, Any]:
    """The table with known names and plain numbers, ready for the schema."""
    plain: dict[str, Any] = {}
    for written, value in table.items():
        name = _known_name(written, known)
        if isinstance(value, list):
            plain[name] = [_numbers(one, name, (name, i)) for i, one in enumerate(value)]
        else:
            plain[name] = _numbers(value, name, (name,))
            _kind(plain[name], name, linear=known[name])
    return plain


def _kind(table: Any, name: str, *, linear: bool | TomlTable) -> None:
    """PriorError unless a coefficient of a law has a mean, and another parameter a median."""
    keys = ("mean", "sd") if linear else ("median", "sd_ln")
    if isinstance(linear, bool) and isinstance(table, Mapping) and set(table) != set(keys):
        message = f"{name} takes {keys[0]} and {keys[1]}, and has {', '.join(map(str, table)) or 'neither'}"
        raise PriorError((name,), message)


def priors_of(plain: TomlTable) -> Priors:
    """Priors from a table that the schema has passed."""
    default = Priors()
    times = plain.get("relaxation_time_s", ())
    for i, (one, after) in enumerate(pairwise(times)):
        if not one["median"] < after["median"]:
            message = (
                f"median = {after['median']:g} is not above the {one['median']:g} before it: "
                "write the shortest relaxation time first"
            )
            raise PriorError(("relaxation_time_s", i + 1, "median"), message)
    phi = plain.get("phi")
    if phi is not None and not phi["low"] < phi["high"]:
        raise PriorError(("phi", "low"), f"low = {phi['low']:g} is not below high = {phi['high']:g}")
    sigma = plain.get("sigma_N")
    return Priors(
        linear={name: (one["mean"], one["sd"]) for name, one in plain.items() if "mean" in one},
        relaxation_time_s=tuple(SpreadPrior(**one) for one in times),
        shapes={
            name: SpreadPrior(**one)
            for name, one in plain.items()
            if name not in {"sigma_N", "relaxation_time_s"} and "median" in one
        },
        sigma_N=None if sigma is None else SpreadPrior(**sigma),
        phi=default.phi if phi is None else (phi["low"], phi["high"]),
        gain_sd=plain["gain_sd"]["scale"] if "gain_sd" in plain else default.gain_sd,
    )


def population_of(plain: TomlTable) -> PopulationPriors:
    """Priors of the population from a ``[population]`` table that the schema has passed."""
    said: dict[str, Any] = {f"tail_{key}": value for key, value in plain.get("tails", {}).items()}
    for name, value in plain.items():
        if name != "tails":
            said[name] = SpreadPrior(**value) if name in ("between", "level") else value
    return PopulationPriors(**said)
