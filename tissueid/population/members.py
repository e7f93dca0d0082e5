"""Specimens as a cohort takes them: a posterior, what was tested, and what is known of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.population.coordinates import Coordinates
from tissueid.population.stage_one import StageOne
from tissueid.result import Curve, ModelChoice

#: Two specimens have one difference, and no spread to speak of.
FEWEST_SPECIMENS = 3
#: Draws taken of each specimen, all together: single precision keeps them below some 200 MB.
MOST_DRAWS_IN_ALL = 6_000_000
FEWEST_DRAWS = 500
#: Quantiles whose distances to the median say how even draws are about it.
_TAILS = (0.05, 0.95)

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
    def order(self) -> tuple[int, int]:
        """Branches, and degree of K."""
        return self.model.branches, self.model.stiffness_degree


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A specimen that takes no part, and why."""

    specimen: str
    reason: str

    def as_json(self) -> dict[str, str]:
        """A row of ``left_out``."""
        return {"specimen": self.specimen, "reason": self.reason}


def common_model(members: Sequence[Member]) -> tuple[int, int]:
    """The commonest order of the model, (branches, degree of K); of equally common ones the simplest."""
    counts = Counter(member.order for member in members)
    most = max(counts.values(), default=0)
    return min((order for order, count in counts.items() if count == most), default=(1, 0))


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
            reason = (
                f"its model has {_order_words(one.order)}, that of most specimens {_order_words(order)}; "
                f"fit all with --branches {order[0]} --stiffness-degree {order[1]}"
            )
        if reason is None:
            kept.append(one)
        else:
            left.append(LeftOut(one.specimen, reason))
    return tuple(kept), tuple(left)


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


def _order_words(order: tuple[int, int]) -> str:
    return f"{order[0]} branch{'es' * (order[0] > 1)} and K of degree {order[1]}"


def stage_one(members: Sequence[Member], coordinates: Coordinates) -> tuple[StageOne, dict[str, int]]:
    """Draws of all members in the population's coordinates.

    Returns ``stage``; ``floored``: specimen -> draws of which a number was zero and was set to its floor.
    """
    most = max(MOST_DRAWS_IN_ALL // max(len(members), 1), FEWEST_DRAWS)
    phi: list[NDArray[Any]] = []
    reference: list[FloatArray] = []
    floored: dict[str, int] = {}
    for one in members:
        rows = np.linspace(0, len(one.draws) - 1, min(most, len(one.draws))).astype(np.int64)
        values, low = coordinates.to_phi(one.draws[rows])
        assert one.log_prior is not None  # noqa: S101 -- fit_for_cohort saw to it
        phi.append(values.astype(np.float32))
        reference.append(one.log_prior[rows] + coordinates.log_jacobian(values))
        if low:
            floored[one.specimen] = low
    times = np.array([name.startswith("relaxation_time") for name in coordinates.names])
    linear = ~times & _more_even_itself(phi)
    return StageOne(tuple(phi), tuple(reference), linear, np.flatnonzero(times)), floored


def _more_even_itself(phi: Sequence[NDArray[Any]]) -> NDArray[np.bool_]:
    """True where draws are nearer to even about their median in the quantity than in its logarithm.

    Noise leaves a force open by so many N: it may be next to nothing.  A gain leaves it open by a factor: a
    normal of the force itself, wide enough for its high draws, would then make no force at all likely too.
    """
    away = np.array([np.quantile(one, _TAILS, axis=0) - np.median(one, axis=0) for one in phi], np.float64)
    logarithm, itself = (np.abs(_unevenness(scale)).sum(axis=0) for scale in (away, np.expm1(away)))
    return np.asarray(itself <= logarithm)


def _unevenness(away: FloatArray) -> FloatArray:
    """Skewness by quantiles, -1 to 1, from distances to the median, (n, 2, p); 0 where all are equal."""
    span = np.ptp(away, axis=1)
    return np.asarray(np.divide(away.sum(axis=1), span, out=np.zeros_like(span), where=span > 0.0))
