"""The ``[priors]`` table of a study file -> :class:`tissueid.priors.Priors`.

A table stands for a parameter and carries its unit in its name; a number in it may be text with another unit
of the same kind: ``[[priors.relaxation_time_s]]`` with ``median = "20 ms"``.  What only compares (``sd_ln``,
``scale`` of a gain, ``low`` and ``high`` of a correlation) has no unit.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from itertools import pairwise
from typing import Any

from tissueid.ingest.stated import in_unit, unit_of, without_unit
from tissueid.manifest import TomlTable
from tissueid.priors import PopulationPriors, Priors, SpreadPrior

#: Keys of a prior that are in the unit of its parameter.
_IN_UNIT = ("mean", "sd", "median")
#: What the names of a second and third branch end in.
_BRANCH = re.compile(r"_b[23]$")

Place = tuple[str | int, ...]


class PriorError(ValueError):
    """Fault of the table, and its place.

    ``where``: keys and positions below ``priors``.
    """

    def __init__(self, where: Place, message: str) -> None:
        super().__init__(message)
        self.where = where


def _bare(name: str) -> str:
    """``stiffness_0_N_per_mm_b2`` without its unit: ``stiffness_0_b2``."""
    branch = _BRANCH.search(name)
    return without_unit(_BRANCH.sub("", name)) + (branch[0] if branch else "")


def _known_name(written: str, known: TomlTable) -> str:
    """The name of a prior; a unit is never guessed.

    Raises PriorError: there is no such name: the nearest is given.
    """
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
    """The table with known names and plain numbers, ready for the schema.

    ``table``: as parsed; ``known``: names of the schema.  Raises PriorError.
    """
    plain: dict[str, Any] = {}
    for written, value in table.items():
        name = _known_name(written, known)
        if isinstance(value, list):
            plain[name] = [_numbers(one, name, (name, i)) for i, one in enumerate(value)]
        else:
            plain[name] = _numbers(value, name, (name,))
    return plain


def priors_of(plain: TomlTable) -> Priors:
    """Priors from a table that the schema has passed.

    ``plain``: from :func:`plain_priors`; what is missing keeps its default.  Raises PriorError: limits in the
    wrong order, or relaxation times that do not ascend.
    """
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
        message = f"low = {phi['low']:g} is not below high = {phi['high']:g}"
        raise PriorError(("phi", "low"), message)
    sigma = plain.get("sigma_N")
    return Priors(
        linear={name: (one["mean"], one["sd"]) for name, one in plain.items() if "mean" in one},
        relaxation_time_s=tuple(SpreadPrior(**one) for one in times),
        sigma_N=None if sigma is None else SpreadPrior(**sigma),
        phi=default.phi if phi is None else (phi["low"], phi["high"]),
        gain_sd=plain["gain_sd"]["scale"] if "gain_sd" in plain else default.gain_sd,
    )


def population_of(plain: TomlTable) -> PopulationPriors:
    """Priors of the population from a ``[population]`` table that the schema has passed.

    ``plain``: what is missing keeps its default.
    """
    default = PopulationPriors()
    tails = plain.get("tails")
    return PopulationPriors(
        mean_sd=plain.get("mean_sd", default.mean_sd),
        effect_sd=plain.get("effect_sd", default.effect_sd),
        between=SpreadPrior(**plain["between"]) if "between" in plain else default.between,
        level=SpreadPrior(**plain["level"]) if "level" in plain else default.level,
        correlation_shape=plain.get("correlation_shape", default.correlation_shape),
        tail_shape=default.tail_shape if tails is None else tails["shape"],
        tail_rate=default.tail_rate if tails is None else tails["rate"],
    )
