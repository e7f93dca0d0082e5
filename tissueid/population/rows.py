"""The numbers of a population that are quoted: a row a quantity, a specimen, an effect.

Effect of one machine on the mean of a population: it does not average out.
Every specimen's total posterior knows the calibration nuisances, its statistical one does not.  All were
measured by one machine with one set of nuisances, so that the difference between the two is taken to be
common: its mean shift and its covariance, averaged over specimens, are added to the mean of the population.
Where specimens were measured by several machines this is too much, by up to the root of their number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.population import Effect, Level, Quantity, Specimen
from tissueid.population.coordinates import Coordinates
from tissueid.population.design import Described
from tissueid.population.members import Member
from tissueid.population.sampler import PopulationDraws
from tissueid.population.stage_one import StageOne

#: Share of the specimens that must have a total posterior.
FEWEST_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class SharedInstrument:
    """Instrument that is common to all specimens."""

    shift: FloatArray  # (p,), of ln quantities
    covariance: FloatArray  # (p, p)
    specimens: int  # of how many it was taken

    def added_to(self, mean: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draws of the mean with the machine's uncertainty, shape (n, p)."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(mean + self.shift + rng.standard_normal(mean.shape) @ root.T)


def shared_instrument(members: Sequence[Member], coordinates: Coordinates) -> SharedInstrument | None:
    """The common part of total less statistical posteriors.

    Medians and robust spreads of each specimen are averaged, because ln of a number near zero has no variance
    to speak of.

    Returns ``None`` where fewer than half of the specimens have a total posterior.
    """
    shifts, more = [], []
    for one in members:
        if one.draws_total is None or len(one.draws_total) < 2:
            continue
        total, own = coordinates.to_phi(one.draws_total)[0], coordinates.to_phi(one.draws)[0]
        shifts.append(np.median(total, axis=0) - np.median(own, axis=0))
        more.append(_covariance(total) - _covariance(own))
    if len(shifts) < max(FEWEST_SHARE * len(members), 1):
        return None
    covariance = np.median(more, axis=0)
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    positive = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return SharedInstrument(np.median(shifts, axis=0), np.asarray(positive), len(shifts))


def _covariance(phi: FloatArray) -> FloatArray:
    """Covariance of draws pulled in to their central 99 %."""
    low, high = np.quantile(phi, [0.005, 0.995], axis=0)
    return np.asarray(np.cov(np.clip(phi, low, high), rowvar=False))


Interval = tuple[float, float]

#: A specimen is named as an outlier where it is more likely than not beyond the 99 % of a normal core.
OUTLIER_PROBABILITY = 0.5
#: Groups of which every pair is compared; of more, each is compared with the largest.
MOST_PAIRED = 4


def _interval(values: FloatArray) -> Interval:
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def quantity_rows(
    draws: PopulationDraws,
    coordinates: Coordinates,
    described: Described,
    instrument: SharedInstrument | None,
    rng: np.random.Generator,
) -> tuple[Quantity, ...]:
    """Mean and spread of each quantity."""
    p = coordinates.size
    mean, sd = draws.mean, draws.sd.reshape(-1, p)
    total = None if instrument is None else np.exp(instrument.added_to(mean, rng))
    level_sd = draws.level_sd.reshape(len(mean), -1, p)
    rows = []
    for k, name in enumerate(coordinates.names):
        cv = np.sqrt(np.expm1(np.minimum(sd[:, k], 5.0) ** 2))
        rows.append(
            Quantity(
                name=name,
                words=coordinates.words[k],
                unit=coordinates.units[k],
                median=float(np.exp(np.median(mean[:, k]))),
                ci95=_interval(np.exp(mean[:, k])),
                ci95_total=None if total is None else _interval(total[:, k]),
                sd_ln=float(np.median(sd[:, k])),
                sd_ln_ci95=_interval(sd[:, k]),
                cv=float(np.median(cv)),
                cv_ci95=_interval(cv),
                levels={
                    key: Level(float(np.median(one)), _interval(one))
                    for key, one in zip(described.design.levels, level_sd[:, :, k].T, strict=True)
                },
            )
        )
    return tuple(rows)


def _intervals(values: FloatArray) -> tuple[Interval, ...]:
    low, high = np.quantile(values, [0.025, 0.975], axis=0)
    return tuple(zip(low.tolist(), high.tolist(), strict=True))


def specimen_rows(
    members: Sequence[Member], stage: StageOne, draws: PopulationDraws, coordinates: Coordinates
) -> tuple[Specimen, ...]:
    """Every specimen, alone and pooled."""
    smoothed = set(draws.smoothed.tolist())
    rows = []
    for i, one in enumerate(members):
        own = np.asarray(stage.phi[i], dtype=np.float64)
        pooled = draws.specimens[:, i]
        farthest = int(np.abs(draws.deviation[i]).argmax())
        spread = np.maximum(own.var(axis=0), 1e-300)
        rows.append(
            Specimen(
                specimen=one.specimen,
                separate=tuple(np.exp(np.median(own, axis=0)).tolist()),
                separate_ci95=_intervals(np.exp(own)),
                pooled=tuple(np.exp(np.median(pooled, axis=0)).tolist()),
                pooled_ci95=_intervals(np.exp(pooled)),
                shrinkage=tuple(np.clip(1.0 - pooled.var(axis=0) / spread, 0.0, 1.0).tolist()),
                far=float(draws.far[i]),
                outlier=coordinates.names[farthest] if draws.far[i] > OUTLIER_PROBABILITY else None,
                deviation=float(draws.deviation[i, farthest]),
                smoothed=i in smoothed,
                worth=float(draws.worth[i]),
            )
        )
    return tuple(rows)


def effect_rows(draws: PopulationDraws, coordinates: Coordinates, described: Described) -> tuple[Effect, ...]:
    """Ratios between groups, and for one standard deviation of each number."""
    coefficient = draws.coefficient.reshape(-1, *draws.coefficient.shape[2:])
    rows: list[Effect] = []

    def add(
        values: FloatArray, covariate: str, of: str | None, against: str | None, per: float | None
    ) -> None:
        for k, name in enumerate(coordinates.names):
            ratio = np.exp(values[:, k])
            above = float((values[:, k] > 0.0).mean())
            rows.append(
                Effect(name, covariate, of, against, per, float(np.median(ratio)), _interval(ratio), above)
            )

    titles = list(described.design.column_names)
    zero = np.zeros_like(coefficient[:, 0])
    grouped = {f"{described.group_by}: {group}" for group in described.groups[1:]}
    by_group = dict.fromkeys(described.groups[:1], zero) | {
        group: coefficient[:, titles.index(f"{described.group_by}: {group}")]
        for group in described.groups[1:]
    }
    pairs = list(combinations(described.groups, 2))
    if len(described.groups) > MOST_PAIRED:
        pairs = [pair for pair in pairs if pair[0] == described.groups[0]]
    for against, of in pairs:
        add(by_group[of] - by_group[against], str(described.group_by), of, against, None)
    for a, title in enumerate(titles[1:], start=1):
        if title in grouped:
            continue
        scale = described.scales.get(title)
        if scale is not None:
            add(coefficient[:, a], title, None, None, scale[1])
        else:
            key, group = title.split(": ", 1)
            add(coefficient[:, a], key, group, "the largest group", None)
    return tuple(rows)
