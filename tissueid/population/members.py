"""Specimens as a cohort takes them: a posterior, what was tested, what is known of them, and their design."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, evenly
from tissueid.documents.population import LeftOut
from tissueid.errors import refuse
from tissueid.model.channels import ChannelModel
from tissueid.model.grammar import KELVIN_VOIGT, rebuilt
from tissueid.population.coordinates import Coordinates
from tissueid.population.stage_one import Design, StageOne
from tissueid.result import Curve, ModelChoice

#: Two specimens have one difference, and no spread to speak of.
FEWEST_SPECIMENS = 3
#: Draws taken of each specimen, all together: single precision keeps them below some 200 MB.
MOST_DRAWS_IN_ALL = 6_000_000
FEWEST_DRAWS = 500
#: Quantiles whose distances to the median say how even draws are about it.
_TAILS = (0.05, 0.95)

#: Law, branches, degree of K.
Order = tuple[str, int, int]
#: Logarithm by which fixed times of specimens may differ from their median: neighbours differ by much more.
SAME_TIMES = 0.1
#: Words of a storage that froze the tissue.
FROZEN = ("frozen", "freez", "thaw", "-20", "-80", "\N{MINUS SIGN}20", "\N{MINUS SIGN}80")


@dataclass(frozen=True, slots=True, eq=False)
class TrialRow:
    """One fitted log of a specimen."""

    path: str
    sheet: str | None
    gain: float  # its force over that of the specimen's common tissue; 1 where pooling leaves no gain
    speed_mm_s: float
    depth_mm: float
    run: int | None = None  # place in the order of testing
    site: str | None = None
    curve: Curve | None = None  # decimated recording


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One specimen of a cohort."""

    specimen: str
    model: ModelChoice
    depth_mm: float  # its model is claimed on [0, depth_mm]
    draws: FloatArray  # (n, p), statistical posterior draws of theta
    log_prior: FloatArray | None  # (n,), ln of their stage-1 prior density, up to a constant
    draws_total: FloatArray | None = None  # (m, p), with the calibration nuisances
    #: What the study says of it; ``None`` for what is not stated.
    covariates: Mapping[str, Any] = field(default_factory=dict)
    trials: tuple[TrialRow, ...] = ()
    speeds_mm_s: tuple[float, float] = (0.0, 0.0)
    tip_radius_mm: float | None = None
    sigma_N: float = 0.0
    units: Mapping[str, str] = field(default_factory=dict)  # of length and force; a cohort has one kind

    @property
    def order(self) -> Order:
        """Law, branches and degree of K."""
        law = KELVIN_VOIGT if self.model.key == KELVIN_VOIGT else self.model.name or self.model.key
        words = " * ".join(word.strip() for word in law.split("*"))
        return words, self.model.branches, self.model.stiffness_degree

    @property
    def fixed_s(self) -> FloatArray:
        """Times of its spectrum [s]; none of other laws."""
        return rebuilt(self.model, self.depth_mm).fixed_s


def common_model(members: Sequence[Member]) -> Order:
    """The commonest law and order; of equally common ones the simplest."""
    counts = Counter(member.order for member in members)
    most = max(counts.values(), default=0)
    simplest = (KELVIN_VOIGT, 1, 0)
    return min((order for order, count in counts.items() if count == most), default=simplest)


def model_of(members: Sequence[Member]) -> ChannelModel:
    """The contact model that members of one law have in common, on the depth that all reached."""
    ends = [one.model.range_s for one in members if one.model.range_s is not None]
    reach = (min(one[0] for one in ends), max(one[1] for one in ends)) if ends else None
    return rebuilt(replace(members[0].model, range_s=reach), min(one.depth_mm for one in members))


def fit_for_cohort(members: Sequence[Member]) -> tuple[tuple[Member, ...], tuple[LeftOut, ...]]:
    """The members that can stand in one population, and the others with the reason."""
    order = common_model([one for one in members if one.draws.size])
    units = Counter(tuple(sorted(one.units.items())) for one in members).most_common(1)
    kept, left = [], []
    for one in members:
        reason = None
        if not one.draws.size:
            reason = "it has no posterior; fit it with a sampler"
        elif one.log_prior is None:
            reason = "its posterior was kept without its prior, by an older run; fit it again"
        elif tuple(sorted(one.units.items())) != units[0][0]:
            reason = "its recordings are in other units than those of most specimens"
        elif one.order != order:
            reason = _other_order(one.order, order)
        if reason is None:
            kept.append(one)
        else:
            left.append(LeftOut(one.specimen, reason))
    return _of_like_times(kept, left)


def _of_like_times(kept: list[Member], left: list[LeftOut]) -> tuple[tuple[Member, ...], tuple[LeftOut, ...]]:
    """Members without those whose spectrum stands at other times, and all that take no part."""
    if not kept or not kept[0].fixed_s.size:
        return tuple(kept), tuple(left)
    logs = np.log([one.fixed_s for one in kept])
    middle = np.median(logs, axis=0)
    like = (np.abs(logs - middle) <= SAME_TIMES).all(axis=1)
    reason = (
        "the times of its spectrum, {:.3g} to {:.3g} s, are not those of most specimens, {:.3g} to {:.3g} s"
    )
    most = np.exp(middle[[0, -1]])
    for one, same in zip(kept, like, strict=True):
        if not same:
            left.append(LeftOut(one.specimen, reason.format(*one.fixed_s[[0, -1]], *most)))
    return tuple(one for one, same in zip(kept, like, strict=True) if same), tuple(left)


def thawed_among_fresh(members: Sequence[Member]) -> tuple[list[str], list[str]]:
    """Names of specimens that were frozen, and of those that were not, as far as their storage is stated."""
    thawed: list[str] = []
    fresh: list[str] = []
    for one in members:
        cycles, storage = one.covariates.get("freeze_thaw_cycles"), one.covariates.get("storage")
        if cycles is None and storage is None:
            continue
        words = str(storage or "").lower()
        never = cycles == 0 or any(word in words for word in ("never", "not frozen", "unfrozen"))
        frozen = not never and (bool(cycles) or any(word in words for word in FROZEN))
        (thawed if frozen else fresh).append(one.specimen)
    return thawed, fresh


def _other_order(own: Order, most: Order) -> str:
    """Why a specimen of another law, order or spectrum takes no part."""
    if own[0] != most[0]:
        return f"its law is {own[0]}, that of most specimens {most[0]}; fit all with --model '{most[0]}'"
    said = [f"{one[1]} branch{'es' * (one[1] > 1)} and K of degree {one[2]}" for one in (own, most)]
    return (
        f"its model has {said[0]}, that of most specimens {said[1]}; "
        f"fit all with --branches {most[1]} --stiffness-degree {most[2]}"
    )


def stage_one(members: Sequence[Member], coordinates: Coordinates) -> tuple[StageOne, dict[str, int]]:
    """Draws of all members in the population's coordinates, and how many of each were floored."""
    most = max(MOST_DRAWS_IN_ALL // max(len(members), 1), FEWEST_DRAWS)
    phi: list[NDArray[Any]] = []
    reference: list[FloatArray] = []
    floored: dict[str, int] = {}
    for one in members:
        rows = evenly(len(one.draws), most)
        values, low = coordinates.to_phi(one.draws[rows])
        assert one.log_prior is not None  # noqa: S101 -- fit_for_cohort saw to it
        phi.append(values.astype(np.float32))
        reference.append(one.log_prior[rows] + coordinates.log_jacobian(values))
        if low:
            floored[one.specimen] = low
    # Noise leaves a force open by so many N: it may be next to nothing.  A gain leaves it open by a factor: a
    # normal of the force itself, wide enough for its high draws, would then make no force at all likely too.
    away = np.array([np.quantile(one, _TAILS, axis=0) - np.median(one, axis=0) for one in phi], np.float64)
    logarithm, itself = (_unevenness(scale) for scale in (away, np.expm1(away)))
    linear = itself <= logarithm
    linear[coordinates.shapes] = False
    return StageOne(tuple(phi), tuple(reference), linear, coordinates.times), floored


def _unevenness(away: FloatArray) -> FloatArray:
    """Sum of skewness by quantiles, 0 to 1 each, from distances to the median (n, 2, p)."""
    span = np.ptp(away, axis=1)
    skewness = np.divide(away.sum(axis=1), span, out=np.zeros_like(span), where=span > 0.0)
    return np.asarray(np.abs(skewness).sum(axis=0))


#: Keys of a study that make random effects where they gather specimens.
LEVELS = ("donor", "site", "operator")
NOT_STATED = "not stated"


def _values(members: Sequence[Member], key: str) -> list[Any]:
    values = [one.covariates.get(key) for one in members]
    if all(value is None for value in values):
        known = sorted(
            {name for one in members for name, value in one.covariates.items() if value is not None}
        )
        there = ", ".join(known) if known else "none: the run had no study"
        refuse(f"no specimen states {key!r}; stated are {there}")
    return values


def _indicators(values: Sequence[Any], key: str) -> tuple[list[FloatArray], list[str], tuple[str, ...]]:
    """A column each group but the first, less its share: the mean stays that of the cohort."""
    names = [NOT_STATED if value is None else str(value) for value in values]
    groups = tuple(sorted(set(names), key=lambda name: (-names.count(name), name)))
    if len(groups) < 2:
        refuse(f"all specimens have {key} = {groups[0]!r}: there is nothing to compare")
    columns, titles = [], []
    for group in groups[1:]:
        column = np.array([name == group for name in names], dtype=np.float64)
        columns.append(column - column.mean())
        titles.append(f"{key}: {group}")
    return columns, titles, groups


def design_of(members: Sequence[Member], group_by: str | None, covariates: Sequence[str]) -> Design:
    """Columns and random effects of a cohort."""
    columns, names = [np.ones(len(members))], ["mean"]
    compared: tuple[str, ...] = ()
    scales: dict[str, float] = {}
    missing: dict[str, tuple[str, ...]] = {}
    if group_by is not None:
        more, titles, compared = _indicators(_values(members, group_by), group_by)
        columns += more
        names += titles
    for key in dict.fromkeys(covariates):
        if key == group_by:
            continue
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
            refuse(f"all specimens have {key} = {mean:g}: it explains nothing")
        scales[key] = sd
        missing[key] = tuple(
            one.specimen for one, value in zip(members, values, strict=True) if value is None
        )
        columns.append(np.where(np.isnan(numbers), 0.0, (numbers - mean) / sd))
        names.append(key)
    levels = _levels(members, {group_by, *covariates})
    group = np.array([*levels.values()], dtype=np.int64).reshape(len(levels), len(members))
    return Design(
        columns=np.column_stack(columns),
        column_names=tuple(names),
        group=group,
        levels=tuple(levels),
        group_by=group_by,
        compared=compared,
        scales=scales,
        missing={key: who for key, who in missing.items() if who},
    )


def _levels(members: Sequence[Member], taken: set[str | None]) -> dict[str, list[int]]:
    """Random effects, with the group of each member: several groups, of which one at least has several."""
    found = {}
    for key in LEVELS:
        if key in taken:
            continue
        # a specimen without a word is its own group
        names = [
            str(one.covariates.get(key)) if one.covariates.get(key) is not None else f"{NOT_STATED} {k}"
            for k, one in enumerate(members)
        ]
        index = {name: k for k, name in enumerate(dict.fromkeys(names))}
        if 1 < len(index) < len(members):
            found[key] = [index[name] for name in names]
    return found
