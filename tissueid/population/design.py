"""Design of specimens, as columns and groups of the population model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import UsageError
from tissueid.population.members import Member
from tissueid.population.stage_one import Design

#: Keys of a study that make random effects where they gather specimens.
LEVELS = ("donor", "site", "operator")
NOT_STATED = "not stated"


@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """The design of a cohort, and how its columns are to be read."""

    design: Design
    group_by: str | None
    groups: tuple[str, ...]  # the first is the one that others are compared with
    scales: Mapping[str, tuple[float, float]]  # numeric covariate -> (mean, sd) it was standardised with
    #: Covariate -> specimens that do not state it and were given its mean.
    missing: Mapping[str, tuple[str, ...]]


def _values(members: Sequence[Member], key: str) -> list[Any]:
    values = [one.covariates.get(key) for one in members]
    if all(value is None for value in values):
        known = sorted(
            {name for one in members for name, value in one.covariates.items() if value is not None}
        )
        there = ", ".join(known) if known else "none: the run had no study"
        msg = f"no specimen states {key!r}; stated are {there}"
        raise UsageError(msg)
    return values


def _indicators(values: Sequence[Any], key: str) -> tuple[list[FloatArray], list[str], tuple[str, ...]]:
    """A column each group but the first, less its share: the mean stays that of the cohort."""
    names = [NOT_STATED if value is None else str(value) for value in values]
    groups = tuple(sorted(set(names), key=lambda name: (-names.count(name), name)))
    if len(groups) < 2:
        msg = f"all specimens have {key} = {groups[0]!r}: there is nothing to compare"
        raise UsageError(msg)
    columns, titles = [], []
    for group in groups[1:]:
        column = np.array([name == group for name in names], dtype=np.float64)
        columns.append(column - column.mean())
        titles.append(f"{key}: {group}")
    return columns, titles, groups


def design_of(members: Sequence[Member], group_by: str | None, covariates: Sequence[str]) -> Described:
    """Columns and random effects of a cohort.

    ``group_by``: covariate whose groups are compared; ``covariates``: others: numbers are standardised, words
    make groups.  Raises UsageError: a covariate that no specimen states, or that is the same for all.
    """
    columns, names = [np.ones(len(members))], ["mean"]
    groups: tuple[str, ...] = ()
    scales: dict[str, tuple[float, float]] = {}
    missing: dict[str, tuple[str, ...]] = {}
    if group_by is not None:
        more, titles, groups = _indicators(_values(members, group_by), group_by)
        columns += more
        names += titles
    for key in dict.fromkeys(covariates):
        values = _values(members, key)
        known = [value for value in values if value is not None]
        if any(isinstance(value, (str, bool)) for value in known):
            more, titles, _ = _indicators(values, key)
            columns += more
            names += titles
            continue
        numbers = np.array([np.nan if value is None else float(value) for value in values])
        mean, sd = float(np.nanmean(numbers)), float(np.nanstd(numbers))
        if not sd > 0.0:
            msg = f"all specimens have {key} = {mean:g}: it explains nothing"
            raise UsageError(msg)
        scales[key] = (mean, sd)
        missing[key] = tuple(
            one.specimen for one, value in zip(members, values, strict=True) if value is None
        )
        columns.append(np.where(np.isnan(numbers), 0.0, (numbers - mean) / sd))
        names.append(key)
    levels = _levels(members, {group_by, *covariates})
    group = np.array([index for _, _, index in levels], dtype=np.int64).reshape(len(levels), len(members))
    design = Design(
        columns=np.column_stack(columns),
        column_names=tuple(names),
        group=group,
        levels=tuple(key for key, _, _ in levels),
        groups=tuple(found for _, found, _ in levels),
    )
    return Described(design, group_by, groups, scales, {key: who for key, who in missing.items() if who})


def _levels(
    members: Sequence[Member], taken: set[str | None]
) -> list[tuple[str, tuple[str, ...], list[int]]]:
    """Random effects: keys with several groups of which one at least has several specimens."""
    found = []
    for key in LEVELS:
        if key in taken:
            continue
        # a specimen without a word is its own group
        names = [
            str(one.covariates.get(key)) if one.covariates.get(key) is not None else f"{NOT_STATED} {k}"
            for k, one in enumerate(members)
        ]
        groups = tuple(dict.fromkeys(names))
        if 1 < len(groups) < len(members):
            index = {name: k for k, name in enumerate(groups)}
            found.append((key, groups, [index[name] for name in names]))
    return found
