"""From records to verdicts: uniform ranks, coverage at four levels, bias and spread, for each parameter.

Bands are family-wise: a right posterior leaves any of them, over all parameters (and, of coverage, levels),
with a probability of 1 % at most.  A parameter's own 95 and 99 % bands are for the eye.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissueid.arrays import IntArray
from tissueid.errors import NotIdentifiedError
from tissueid.selfcheck.ranks import DRAWS, EcdfBand, binomial_interval, ecdf_band, ecdf_counts
from tissueid.selfcheck.records import Record, failures

#: Relative difference below which truths are the same.
SAME = 1e-12
#: Intervals whose coverage is counted; each holds a whole number of the DRAWS + 1 ranks.
LEVELS = (0.5, 0.8, 0.9, 0.95)
#: Probability that a right posterior leaves any band of its kind.
FAMILY_ERROR = 0.01
#: Share of simulations without a posterior beyond which nothing can be said of the others.
MOST_FAILED = 0.01
BINS = 20
#: Level of the intervals that a fit quotes.
QUOTED = 0.95


@dataclass(frozen=True, slots=True)
class Coverage:
    """Count of truths in an interval: the central one, and at 95 % the one that a fit quotes."""

    level: float
    covered: int
    simulations: int
    #: Family-wise band of ``covered``.
    low: int
    high: int

    @property
    def inside(self) -> bool:
        """True where the count lies within its band."""
        return self.low <= self.covered <= self.high

    @property
    def fraction(self) -> float:
        """Share of the simulations."""
        return self.covered / self.simulations

    def as_json(self) -> dict[str, Any]:
        """A row of ``coverage``."""
        n = self.simulations
        return {
            "level": self.level,
            "fraction": self.fraction,
            "low": self.low / n,
            "high": self.high / n,
            "inside": self.inside,
        }


@dataclass(frozen=True, slots=True, eq=False)
class ParameterCheck:
    """Verdict of the simulations on one parameter."""

    name: str
    ranks: IntArray  # (n,)
    counts: IntArray  # ranks below each point of the band
    coverage: tuple[Coverage, ...]  # one for each of :data:`LEVELS`
    #: Mean of (truth - posterior mean) / posterior sd; 0 where right, its standard error 1 / sqrt(n).
    mean_z: float
    spread_ratio: float  # root mean square of the same: 1 where right, above 1 where intervals are too narrow
    contraction: float  # 1 - mean posterior variance / variance of the truths: 0 where the data said nothing
    #: Whether the ECDF keeps the parameter's own bands, and the family-wise one.
    inside_95: bool
    inside_99: bool
    inside_family: bool

    @property
    def calibrated(self) -> bool:
        """True where ranks and coverage keep the family-wise bands."""
        return self.inside_family and all(row.inside for row in self.coverage)

    def as_json(self) -> dict[str, Any]:
        """A row of ``parameters``."""
        return {
            "name": self.name,
            "calibrated": self.calibrated,
            "mean_z": self.mean_z,
            "spread_ratio": self.spread_ratio,
            "contraction": self.contraction,
            "inside": {"95": self.inside_95, "99": self.inside_99, "family": self.inside_family},
            "coverage": [row.as_json() for row in self.coverage],
            "histogram": np.histogram(self.ranks, bins=BINS, range=(0, DRAWS + 1))[0].tolist(),
            "ecdf": self.counts.tolist(),
        }


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The verdict on a whole check."""

    parameters: tuple[ParameterCheck, ...]
    #: ``95``, ``99`` and ``family`` -> :class:`~tissueid.selfcheck.ranks.EcdfBand`.
    bands: Mapping[str, EcdfBand]
    simulations: int  # with a posterior
    failed: tuple[str, ...]  # why the others have none

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not calibrated; empty where it is."""
        said = []
        total = self.simulations + len(self.failed)
        if len(self.failed) > MOST_FAILED * total:
            said.append(f"{len(self.failed)} of {total} simulations have no posterior: {self.failed[0]}")
        for one in self.parameters:
            if not one.inside_family:
                said.append(f"{one.name}: ranks leave the family-wise 99 % band")
            said += [
                f"{one.name}: the {100 * row.level:g} % interval covers {100 * row.fraction:.1f} % "
                f"(band {100 * row.low / row.simulations:.1f} to {100 * row.high / row.simulations:.1f} %)"
                for row in one.coverage
                if not row.inside
            ]
        return tuple(said)

    @property
    def calibrated(self) -> bool:
        """True where nothing speaks against the posterior."""
        return self.simulations > 0 and not self.reasons

    def as_json(self) -> dict[str, Any]:
        """``parameters``, ``bands`` and ``verdict`` of the schema."""
        points = next(iter(self.bands.values())).points
        return {
            "parameters": [one.as_json() for one in self.parameters],
            "bands": {
                "points": points.tolist(),
                **{
                    name: {"level": band.level, "low": band.low.tolist(), "high": band.high.tolist()}
                    for name, band in self.bands.items()
                },
            },
            "verdict": {"calibrated": self.calibrated, "reasons": list(self.reasons)},
        }


def _coverage(ranks: IntArray, level: float, error: float, held: Sequence[bool | None]) -> Coverage:
    """Count truths in the quoted interval; else ranks in the central one: (L + 1) * level of the L + 1."""
    out = round((1.0 - level) / 2.0 * (DRAWS + 1))
    low, high = binomial_interval(ranks.size, level, error)
    inside = (ranks >= out) & (ranks <= DRAWS - out)
    if level == QUOTED:
        inside = np.array([own if told is None else told for own, told in zip(inside, held, strict=True)])
    return Coverage(level=level, covered=int(inside.sum()), simulations=ranks.size, low=low, high=high)


def _parameter(
    name: str, records: Sequence[Record], bands: Mapping[str, EcdfBand], family: int
) -> ParameterCheck:
    truth, mean, sd = (
        np.array([getattr(record, key)[name] for record in records]) for key in ("truth", "mean", "sd")
    )
    ranks = np.array([record.rank[name] for record in records], dtype=np.int64)
    z = (truth - mean) / np.maximum(sd, np.finfo(float).tiny)
    counts = ecdf_counts(ranks)
    held = [record.held.get(name) for record in records]
    # a truth that is the same in every simulation has no spread but that of rounding
    varies = truth.size > 1 and float(np.ptp(truth)) > SAME * float(np.abs(truth).max())
    spread = float(truth.var(ddof=1)) if varies else 0.0
    error = FAMILY_ERROR / (family * len(LEVELS))
    return ParameterCheck(
        name=name,
        ranks=ranks,
        counts=counts,
        coverage=tuple(_coverage(ranks, level, error, held) for level in LEVELS),
        mean_z=float(z.mean()),
        spread_ratio=float(np.sqrt((z**2).mean())),
        contraction=1.0 - float((sd**2).mean()) / spread if spread > 0.0 else 0.0,
        inside_95=bands["95"].holds(counts),
        inside_99=bands["99"].holds(counts),
        inside_family=bands["family"].holds(counts),
    )


def verdict_of(records: Sequence[Record]) -> Verdict:
    """Judge the records of a check.

    ``records``: at least one with a posterior; all of them with the same names.  Raises NotIdentifiedError:
    no simulation has a posterior.
    """
    good = [record for record in records if record.failed is None]
    if not good:
        why = f"; the first: {records[0].failed}" if records else ""
        msg = f"none of {len(records)} simulations has a posterior{why}"
        raise NotIdentifiedError(msg)
    names = list(good[0].rank)
    bands = {
        "95": ecdf_band(len(good), 0.95),
        "99": ecdf_band(len(good), 0.99),
        "family": ecdf_band(len(good), 1.0 - FAMILY_ERROR / len(names)),
    }
    return Verdict(
        parameters=tuple(_parameter(name, good, bands, len(names)) for name in names),
        bands=bands,
        simulations=len(good),
        failed=tuple(str(record.failed) for record in failures(records)),
    )
