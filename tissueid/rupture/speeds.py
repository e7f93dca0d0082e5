"""Rupture against speed: mean and spread at each speed, change inside specimens, and the sign test.

What speed does is seen inside specimens that were tested at several speeds. Where each speed has specimens
of its own, a difference between speeds may be one between specimens, and nothing is said of an effect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as t_distribution

from tissueid.arrays import FloatArray
from tissueid.population.confounding import Confounding
from tissueid.rupture.failures import Failure

#: What is quoted of a rupture.
QUOTED: Mapping[str, Callable[[Failure], float]] = {
    "force_N": lambda one: one.test.force_N,
    "depth_mm": lambda one: one.depth_mm,
    "work_N_mm": lambda one: one.test.work_N_mm,
}
CONFIDENCE = 0.95
#: Specimens from which their own scatter gives the interval.
FEWEST_SPECIMENS = 3
#: Two speeds inside a specimen differ, in ln.
SPEEDS_DIFFER = 0.05


@dataclass(frozen=True, slots=True)
class AtSpeed:
    """Ruptures at one speed."""

    speed_mm_s: float
    ruptured: int
    censored: int
    #: Of force [N], depth [mm] and work [N mm] at rupture; no sd of a single rupture.
    mean: Mapping[str, float | None]
    sd: Mapping[str, float | None]


@dataclass(frozen=True, slots=True)
class Change:
    """Change of a quantity from one speed to ten times it, inside specimens."""

    quantity: str
    ratio: float  # at ten times the speed over at the speed
    ci95: tuple[float, float]

    @property
    def direction(self) -> str:
        """``falls``, ``rises`` or ``undecided``."""
        if self.ci95[1] < 1.0:
            return "falls"
        return "rises" if self.ci95[0] > 1.0 else "undecided"


@dataclass(frozen=True, slots=True)
class Hardening:
    """The sign test x F_s'/F over the ruptures."""

    mean: float  # of the specimens' means
    ci95: tuple[float, float]
    ruptures: int  # how many it is of

    @property
    def direction(self) -> str:
        """Force at rupture with speed if the work is constant: ``falls``, ``rises`` or ``undecided``."""
        if self.ci95[0] > 1.0:
            return "falls"
        return "rises" if self.ci95[1] < 1.0 else "undecided"


def per_speed(failures: Sequence[Failure], confounding: Confounding) -> list[AtSpeed]:
    """Means and standard deviations at each speed, slowest first.

    ``confounding``: whose speeds are told apart.
    """
    speeds = np.log(confounding.speeds_mm_s)
    groups: list[list[Failure]] = [[] for _ in speeds]
    for one in failures:
        groups[int(np.argmin(np.abs(speeds - np.log(one.test.speed_mm_s))))].append(one)
    found = []
    for speed, group in zip(confounding.speeds_mm_s, groups, strict=True):
        broken = [one for one in group if one.ruptured]
        values = {name: np.array([of(one) for one in broken]) for name, of in QUOTED.items()}
        found.append(
            AtSpeed(
                speed_mm_s=speed,
                ruptured=len(broken),
                censored=len(group) - len(broken),
                mean={name: float(v.mean()) if v.size else None for name, v in values.items()},
                sd={name: float(v.std(ddof=1)) if v.size > 1 else None for name, v in values.items()},
            )
        )
    return found


def change_with_speed(failures: Sequence[Failure]) -> list[Change]:
    """Change of force, depth and work at rupture with speed, inside specimens; of ruptured tests alone.

    Returns empty where no specimen ruptured at two speeds.
    """
    broken = [one for one in failures if one.ruptured]
    names = list(dict.fromkeys(one.specimen for one in broken))
    who = np.array([names.index(one.specimen) for one in broken], dtype=int)
    speed = _inside(np.log10([one.test.speed_mm_s for one in broken]), who)
    left = len(broken) - len(names) - 1
    if left < 1 or not np.abs(speed).max(initial=0.0) > SPEEDS_DIFFER:
        return []
    found = []
    quantile = float(t_distribution.ppf(0.5 + CONFIDENCE / 2.0, left))
    for name, of in QUOTED.items():
        values = _inside(np.log([of(one) for one in broken]), who)
        total = float((speed**2).sum())
        slope = float((speed * values).sum()) / total
        error = float(np.sqrt(((values - slope * speed) ** 2).sum() / left / total))
        ends = (float(np.exp(slope - quantile * error)), float(np.exp(slope + quantile * error)))
        found.append(Change(name, float(np.exp(slope)), ends))
    return found


def _inside(values: FloatArray, who: NDArray[np.intp]) -> FloatArray:
    """Values less the mean of their specimen."""
    inside: FloatArray = values.astype(np.float64)
    for k in np.unique(who):
        inside[who == k] -= inside[who == k].mean()
    return inside


def hardening_of(failures: Sequence[Failure]) -> Hardening | None:
    """Mean x F_s'/F at rupture with a 95 % interval, over specimens.

    Of ruptures at depths of many v tau: only there it tells the sign.  From three specimens on their scatter
    gives the interval, which holds what the laws do not know; of fewer the draws of their laws do.

    Returns ``None`` where every rupture came too fast for it.
    """
    broken = [one for one in failures if one.ruptured and one.settled]
    names = list(dict.fromkeys(one.specimen for one in broken))
    if not names:
        return None
    means = np.array([np.mean([one.hardening for one in broken if one.specimen == name]) for name in names])
    count = len(names)
    if count >= FEWEST_SPECIMENS:
        error = float(means.std(ddof=1)) / count**0.5
        half = float(t_distribution.ppf(0.5 + CONFIDENCE / 2.0, count - 1)) * error
    else:
        # draws of one law move all its tests together
        own = [np.mean([one.hardening_sd for one in broken if one.specimen == name]) for name in names]
        half = float(t_distribution.ppf(0.5 + CONFIDENCE / 2.0, np.inf)) * float(np.linalg.norm(own)) / count
    mean = float(means.mean())
    return Hardening(mean, (mean - half, mean + half), len(broken))
