"""Verdicts on two tissues: whether they differ, and whether a hand could tell; all pairs as one document.

The mean difference of ln force is as far out, by Mahalanobis' distance, as a share of the draws of that
difference are: chi-squared where they are normal, and less surprising where few logs leave far tails.  Limits
of hands vary between studies and conditions: they say an order of magnitude.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from tissueid import __version__
from tissueid.arrays import FloatArray, evenly
from tissueid.documents import contrast as documents
from tissueid.documents import plain
from tissueid.errors import refuse
from tissueid.measured.spread import SAME_SPEED
from tissueid.model.channels import ChannelModel, loading_force
from tissueid.model.functionals import force_after_ramp
from tissueid.model.passivity import scaling_for

#: Tissues are called different below this probability.
LEVEL = 0.02
#: Directions whose variance is below this share of the largest one are rounding and not data.
NEGLIGIBLE = 1e-6
CENTRAL = (0.025, 0.5, 0.975)


Draws = Mapping[str, FloatArray]


def _both(one: Draws, other: Draws) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Numbers that both have, with as many draws of each: posteriors are independent, any pair will do."""
    for name in one:
        if name in other:
            count = min(one[name].size, other[name].size)
            yield name, one[name][:count], other[name][:count]


def rows(one: Draws, other: Draws) -> list[documents.Number]:
    """Numbers that both have, beside each other."""
    found = []
    for name, a, b in _both(one, other):
        shifts, ratio = _shifted(b), None
        if a.min() > 0.0 and b.min() > 0.0:
            ratio = _central(np.concatenate([shift / a for shift in shifts]))
        # a tie is half of either
        larger = float(np.mean([np.mean(shift > a) + 0.5 * np.mean(shift == a) for shift in shifts]))
        found.append(documents.Number(name, _central(one[name]), _central(other[name]), ratio, larger))
    return found


def difference(one: Draws, other: Draws) -> documents.Difference:
    """Test all forces together: numbers whose names begin with "force", draws by name."""
    pairs = [(a, b) for name, a, b in _both(one, other) if name.startswith("force")]
    a, b = (np.log(np.maximum(of, 1e-12)) for of in zip(*pairs, strict=True))
    gap = b.mean(axis=1) - a.mean(axis=1)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(a) + np.cov(b)))
    used = values > NEGLIGIBLE * values.max()
    root = vectors[:, used] / np.sqrt(values[used])
    distance = float(np.sum((gap @ root) ** 2))
    apart = np.concatenate([(shift - a).T - gap for shift in _shifted(b)])
    farther = int(np.count_nonzero(np.sum((apart @ root) ** 2, axis=1) >= distance))
    probability = (1 + farther) / (1 + len(apart))
    return documents.Difference(distance, int(used.sum()), probability, probability < LEVEL)


def _shifted(draws: FloatArray) -> list[FloatArray]:
    """Draws in other orders: every pair of independent draws is as good as any other."""
    count = draws.shape[-1]
    return [np.roll(draws, count * k // 7, axis=-1) for k in range(7)]


def _central(values: FloatArray) -> documents.Quantiles:
    low, middle, high = (float(q) for q in np.quantile(values, CENTRAL))
    return low, middle, high


#: Below this force at a device the difference that is noticed no longer shrinks [N].
LEAST_FORCE_N = 0.5


#: Just-noticeable differences: beginning of the numbers, Weber fraction, source and conditions.
LIMITS = (
    documents.Limit(
        "force", 0.07, "Jones 1989, Perception 18:681", "10.1068/p180681", "elbow flexors, forces matched"
    ),
    documents.Limit(
        "static stiffness", 0.23, "Jones & Hunter 1990, Exp Brain Res 79:150", "10.1007/BF00228884",
        "two arms, motors, stiffness matched",
    ),
    documents.Limit(
        "viscosity", 0.34, "Jones & Hunter 1993, Exp Brain Res 94:343", "10.1007/BF00230304",
        "two arms, motors, viscosity matched",
    ),
)  # fmt: skip


def noticed(one: Draws, other: Draws, *, force_scale: float) -> list[documents.Noticed]:
    """Compare differences with what is noticed, at the scale of a device.

    ``one``, ``other``: draws by name; ``force_scale``: force at the device over that of the tissue.  A common
    scale keeps ratios of stiffness and viscosity; forces that become faint are harder to tell apart.
    """
    found = []
    for name, a, b in _both(one, other):
        limit = next((limit for limit in LIMITS if name.startswith(limit.of)), None)
        if limit is None:
            continue
        middle = 0.5 * np.abs(a + b)
        if limit.of == "force":
            middle = np.maximum(middle, LEAST_FORCE_N / force_scale)
        times = (b - a) / (limit.share * middle)
        # more or less, but of one sign: what scatters to both sides of 0 is no difference
        times *= np.copysign(1.0, np.median(times))
        low, median, high = _central(times)
        interval = max(low, 0.0), max(high, -low)
        found.append(documents.Noticed(name, limit, median, interval, float(np.mean(times > 1.0))))
    return found


def hand_words(found: Sequence[documents.Noticed], *, different: bool) -> str:
    """Say whether a hand could tell; not known where an interval has one just-noticeable difference in it."""
    felt = [one for one in found if one.interval[0] > 1.0] if different else []
    possible = felt or [one for one in found if one.interval[1] > 1.0]
    if not possible:
        return "a hand would hardly tell: no difference exceeds a published just-noticeable one"
    most = max(possible, key=lambda one: (one.probability, one.times))
    said = "a hand could tell" if felt else "it is not known whether a hand could tell"
    low, high = (f"{end:.2g}" for end in most.interval)
    limit = most.limit
    return (
        f"{said}: {most.name}, {most.times:.2g} ({low} to {high}) times the just-noticeable difference "
        f"({limit.source}, doi {limit.doi}: {limit.conditions})"
    )


#: Shares of the common depth at which forces are compared.
DEPTH_SHARES = (0.25, 0.5, 1.0)
#: Draws that are evaluated; more say nothing more about a 2 % level.
MOST_DRAWS = 2000
#: Fewer draws than these have no covariance worth the name.
LEAST_DRAWS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """One tissue of a comparison."""

    name: str
    model: ChannelModel
    draws: FloatArray  # (n, p), of its posterior
    speeds_mm_s: tuple[float, float]  # slowest and fastest identified speed
    total: bool  # whether the draws know the machine's calibration
    logs: int | None = None  # recordings behind it, where known

    def __post_init__(self) -> None:
        if len(self.draws) < LEAST_DRAWS:
            refuse(
                f"{self.name}: {len(self.draws)} draws are too few to compare; fit it with a sampler "
                "(`tissueid fit` does by default)"
            )

    def some_draws(self) -> FloatArray:
        """At most :data:`MOST_DRAWS` of them, evenly spread."""
        return np.asarray(self.draws[evenly(len(self.draws), MOST_DRAWS)])


def common_range(tissues: Sequence[Compared]) -> documents.Common:
    """Depths and speeds at which every tissue was identified; without a common speed nothing is compared."""
    slow = max(tissue.speeds_mm_s[0] for tissue in tissues)
    fast = min(tissue.speeds_mm_s[1] for tissue in tissues)
    if slow > fast * SAME_SPEED:
        told = "; ".join(
            f"{tissue.name} at {tissue.speeds_mm_s[0]:.3g} to {tissue.speeds_mm_s[1]:.3g} mm/s"
            for tissue in tissues
        )
        refuse(f"no speed is common to them ({told}): what the speed does and the tissue can't be told apart")
    return documents.Common(min(tissue.model.depth_mm for tissue in tissues), (slow, max(slow, fast)))


def draws_of_numbers(tissue: Compared, common: documents.Common) -> dict[str, FloatArray]:
    """Draws (n,) of every number that is compared, by its name with unit: positive forces [N] first."""
    draws = tissue.some_draws()
    found: dict[str, FloatArray] = {}
    for share in DEPTH_SHARES:
        depth = share * common.depth_mm
        for speed in dict.fromkeys(common.speeds_mm_s):
            found[f"force at {depth:.3g} mm, {speed:.3g} mm/s [N]"] = np.array(
                [force_after_ramp(tissue.model, theta, depth, speed, 0.0) for theta in draws]
            )
    half = np.array([0.5 * common.depth_mm])
    found[f"static stiffness to {half[0]:.3g} mm [N/mm]"] = np.array(
        [float(tissue.model.static_force(theta, half)[0]) / half[0] for theta in draws]
    )
    if tissue.model.branches:
        tau = np.array([tissue.model.times(theta) for theta in draws])
        if tissue.model.viscous:
            stiffness = np.array([tissue.model.stiffness(theta, half)[:, 0] for theta in draws])
            found[f"viscosity at {half[0]:.3g} mm [N s/mm]"] = (stiffness * tau).sum(axis=1)
        found["relaxation time, longest [s]"] = tau.max(axis=1)
    return found


#: Points of a drawn curve.
POINTS = 61
#: A hold is drawn for so many of the longest median relaxation time of all, and from so small a part of it.
HOLD_TAUS = 5.0
HOLD_FROM = 1e-3


def force_curves(tissues: list[Compared], common: documents.Common) -> list[documents.Curve]:
    """Curves of every tissue on the same depths, speeds and times.

    Bands are the 2.5, 50 and 97.5 % quantiles of the force [N]; holds follow the end of the fastest common
    ramp to the common depth.
    """
    depth = np.linspace(0.0, common.depth_mm, POINTS)
    speeds = list(dict.fromkeys(common.speeds_mm_s))
    longest = max((_longest(tissue) for tissue in tissues), default=0.0)
    time = np.concatenate([[0.0], np.geomspace(HOLD_FROM, 1.0, POINTS - 1)]) * HOLD_TAUS * (longest or 1.0)
    return [_of_tissue(tissue, depth, speeds, time) for tissue in tissues]


def _longest(tissue: Compared) -> float:
    """Median of the longest relaxation time [s]; 0 without a branch."""
    if not tissue.model.branches:
        return 0.0
    return float(np.median([tissue.model.times(theta).max() for theta in tissue.draws[:MOST_DRAWS]]))


def _of_tissue(tissue: Compared, depth: FloatArray, speeds: list[float], time: FloatArray) -> documents.Curve:
    draws = tissue.some_draws()
    ramps = np.empty((len(speeds), len(draws), depth.size))
    holds = np.empty((len(draws), time.size))
    for row, theta in enumerate(draws):
        for place, speed in enumerate(speeds):
            ramps[place, row] = loading_force(tissue.model, theta, depth, speed_mm_s=speed)
        still = float(tissue.model.static_force(theta, depth[-1:])[0])
        holds[row] = still + tissue.model.relaxing(theta, float(depth[-1]), time, speeds[-1])
    loading = tuple(
        documents.Loading(speed, tuple(depth.tolist()), *_band(ramps[place]))
        for place, speed in enumerate(speeds)
    )
    return documents.Curve(tissue.name, loading, documents.Hold(tuple(time.tolist()), *_band(holds)))


def _band(forces: FloatArray) -> list[tuple[float, ...]]:
    return [tuple(row.tolist()) for row in np.quantile(forces, CENTRAL, axis=0)]


def _remarks(tissues: Sequence[Compared]) -> list[str]:
    """Words on what intervals do not know."""
    found = []
    if not all(one.total for one in tissues):
        found.append(
            "statistical intervals hold the machine at each fit's own estimate: where it was not stated, one "
            "tissue may be called different; name output folders, with --interval total"
        )
    once = [one.name for one in tissues if one.logs == 1]
    if once:
        found.append(
            f"{len(once)} of {len(tissues)} tissues (first {once[0]}) have one log: what two pushes into one "
            "tissue differ by is in no interval, and 'differ' may say no more; push again"
        )
    return found


def _told(one: Compared) -> documents.Tissue:
    order = (one.model.branches, one.model.stiffness_degree)
    return documents.Tissue(one.name, *order, len(one.draws), "total" if one.total else "statistical")


def contrast_document(
    tissues: Sequence[Compared],
    *,
    clamp_N: float,
    progress: Callable[[str, int, int], None] = lambda _message, _done, _total: None,
) -> dict[str, Any]:
    """Compare tissues pair by pair (``schemas/contrast.schema.json``); the stiffest sets the scale."""
    common = common_range(tissues)
    draws = []
    for done, tissue in enumerate(tissues):
        progress(tissue.name, done, len(tissues))
        draws.append(draws_of_numbers(tissue, common))
    progress("comparing", len(tissues), len(tissues))
    scales = [
        scaling_for(
            tissue.model, np.median(tissue.draws, axis=0), clamp_N=clamp_N, fastest_mm_s=tissue.speeds_mm_s[1]
        ).force
        for tissue in tissues
    ]
    scale = min(scales)
    pairs = []
    for i, j in combinations(range(len(tissues)), 2):
        one, other = draws[i], draws[j]
        apart, felt = difference(one, other), tuple(noticed(one, other, force_scale=scale))
        told = tuple(rows(one, other)), felt, hand_words(felt, different=apart.different)
        pairs.append(documents.Pair(tissues[i].name, tissues[j].name, apart, *told))
    return {
        "schema": "tissueid/contrast/1",
        "tissueid": __version__,
        "level": LEVEL,
        "common": plain(common),
        "device": {"clamp_N": clamp_N, "force_scale": scale},
        "tissues": plain([_told(tissue) for tissue in tissues]),
        "curves": plain(force_curves(list(tissues), common)),
        "pairs": plain(pairs),
        "remarks": _remarks(tissues),
    }
