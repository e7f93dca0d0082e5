"""From records to verdicts: uniform ranks, coverage, bias and spread of each parameter, and their document.

The rank of a truth among draws of a right posterior is uniform (Talts et al. 2018, arXiv 1804.06788).  Counts
of ranks below growing z are a Markov chain: the probability that all stay within their pointwise binomial
intervals is a product of small matrices, and the pointwise level of a simultaneous band is found by bisection
(the idea of Saeilynoja, Buerkner & Vehtari 2022, doi 10.1007/s11222-022-10090-6, sections 2 and 3).  Bands
are family-wise: a right posterior leaves any of them, over all parameters (and levels), with a probability of
1 % at most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import gammaln
from scipy.stats import binom

from tissueid import PosteriorOptions, __version__
from tissueid.arrays import FloatArray, IntArray
from tissueid.documents import plain
from tissueid.documents import selfcheck as documents
from tissueid.documents.selfcheck import Coverage, Inside, Parameter, Prior
from tissueid.errors import NotIdentifiedError
from tissueid.selfcheck.protocol import Protocol
from tissueid.selfcheck.records import DRAWS, Record
from tissueid.selfcheck.tissue import TissueCheck
from tissueid.selfcheck.truth import prior_words

#: Points at which the distribution of ranks is looked at; DRAWS + 1 is a multiple.
POINTS = 100
_BISECTIONS = 40


@dataclass(frozen=True, slots=True, eq=False)
class EcdfBand:
    """Counts that an ECDF of uniform ranks keeps, at all points at once."""

    points: FloatArray  # (k,), z in (0, 1)
    #: (k,): fewest and most ranks below each z.
    low: IntArray
    high: IntArray  # (k,)
    level: float  # simultaneous probability that was asked for; the band's own is at least that

    def holds(self, counts: IntArray) -> bool:
        """True where all counts lie within."""
        return bool(((self.low <= counts) & (counts <= self.high)).all())


def ecdf_counts(ranks: IntArray) -> IntArray:
    """Count the ranks below each of ``POINTS - 1`` equally spaced shares of their range."""
    edges = np.arange(1, POINTS) * ((DRAWS + 1) // POINTS)
    return np.searchsorted(np.sort(ranks), edges, side="left").astype(np.int64)


def _stays(low: IntArray, high: IntArray, points: FloatArray, simulations: int) -> float:
    """Probability that all counts of uniform ranks stay within their intervals."""
    log_factorial = gammaln(np.arange(1.0, simulations + 2.0))
    at = np.array([0])
    mass = np.ones(1)
    before = 0.0
    for z, least, most in zip(points, low, high, strict=True):
        share = (z - before) / (1.0 - before)
        to = np.arange(least, most + 1)
        more = to[:, None] - at[None, :]
        left = simulations - at[None, :]
        possible = (more >= 0) & (more <= left)
        k = np.where(possible, more, 0)
        log_p = (
            log_factorial[left]
            - log_factorial[k]
            - log_factorial[left - k]
            + k * np.log(share)
            + (left - k) * np.log1p(-share)
        )
        mass = np.where(possible, np.exp(log_p), 0.0) @ mass
        at, before = to, float(z)
    return float(mass.sum())


@lru_cache(maxsize=64)
def ecdf_band(simulations: int, level: float) -> EcdfBand:
    """The narrowest band of equal pointwise level that holds with at least ``level``."""
    z = np.arange(1, POINTS) / POINTS

    def interval(error: float) -> tuple[IntArray, IntArray]:
        low, high = binom.interval(1.0 - error, simulations, z)
        return np.asarray(low, dtype=np.int64), np.asarray(high, dtype=np.int64)

    # by Boole a pointwise error of (1 - level) / POINTS is enough, and one of 1 - level at least is needed
    narrow, wide = np.log(1.0 - level), np.log((1.0 - level) / POINTS)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (narrow + wide)
        if _stays(*interval(float(np.exp(middle))), z, simulations) >= level:
            wide = middle
        else:
            narrow = middle
        if narrow - wide < 1e-3:
            break
    low, high = interval(float(np.exp(wide)))
    return EcdfBand(points=z, low=low, high=high, level=level)


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


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The verdict on a whole check."""

    parameters: tuple[Parameter, ...]
    #: ``95``, ``99`` and ``family`` -> :class:`~tissueid.selfcheck.verdicts.EcdfBand`.
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
            if not one.inside.family:
                said.append(f"{one.name}: ranks leave the family-wise 99 % band")
            said += [
                f"{one.name}: the {100 * row.level:g} % interval covers {100 * row.fraction:.1f} % "
                f"(band {100 * row.low:.1f} to {100 * row.high:.1f} %)"
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
            "parameters": plain(self.parameters),
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
    n, (low, high) = ranks.size, binom.interval(1.0 - error, ranks.size, level)
    inside = (ranks >= out) & (ranks <= DRAWS - out)
    if level == QUOTED:
        inside = np.array([own if told is None else told for own, told in zip(inside, held, strict=True)])
    covered = int(inside.sum())
    return Coverage(level, covered / n, float(low / n), float(high / n), inside=bool(low <= covered <= high))


def _parameter(name: str, records: Sequence[Record], bands: Mapping[str, EcdfBand], family: int) -> Parameter:
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
    inside = Inside(*(bands[key].holds(counts) for key in ("95", "99", "family")))
    coverage = tuple(_coverage(ranks, level, error, held) for level in LEVELS)
    return Parameter(
        name=name,
        calibrated=inside.family and all(row.inside for row in coverage),
        mean_z=float(z.mean()),
        spread_ratio=float(np.sqrt((z**2).mean())),
        contraction=1.0 - float((sd**2).mean()) / spread if spread > 0.0 else 0.0,
        inside=inside,
        coverage=coverage,
        histogram=tuple(np.histogram(ranks, bins=BINS, range=(0, DRAWS + 1))[0].tolist()),
        ecdf=tuple(counts.tolist()),
    )


def verdict_of(records: Sequence[Record]) -> Verdict:
    """Judge the records of a check."""
    good = [record for record in records if record.failed is None]
    if not good:
        why = f"; the first: {records[0].failed}" if records else ""
        raise NotIdentifiedError(f"none of {len(records)} simulations has a posterior{why}")
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
        failed=tuple(str(record.failed) for record in records if record.failed is not None),
    )


def _protocol(protocol: Protocol) -> documents.Protocol:
    logs, contact_sd_mm = protocol.logs, max(log.contact_sd_mm for log in protocol.logs)
    times, (slow, fast) = (protocol.step_s, protocol.duration_s), protocol.speeds_mm_s
    size = (len(logs), protocol.samples, *times, protocol.depth_mm)
    return documents.Protocol(protocol.words, *size, (slow, fast), contact_sd_mm)


def check_document(
    source: documents.Source,
    protocol: Protocol,
    check: TissueCheck,
    records: Sequence[Record],
    *,
    simulations: int,
    seed: int,
) -> tuple[dict[str, Any], Verdict]:
    """The document of ``schemas/selfcheck.schema.json``, and the verdict behind it.

    ``simulations``, ``seed``: as they were asked for.
    """
    verdict = verdict_of(records)
    good = [record for record in records if record.failed is None]
    words = prior_words(
        check.priors, correlated=check.correlated, pooling=check.pooling, defects=check.defects
    )
    return {
        "schema": "tissueid/selfcheck/1",
        "source": plain(source),
        "model": {
            "branches": check.model.branches,
            "stiffness_degree": check.model.stiffness_degree,
            "static_pooling": check.pooling,
            "depth_mm": check.model.depth_mm,
        },
        "noise": plain(documents.Noise(check.noise_model, check.white_share, check.reference_step_s)),
        "interval": "total" if check.defects else "statistical",
        "protocol": plain(_protocol(protocol)),
        "priors": plain([Prior(name, said, name in check.stated) for name, said in words.items()]),
        "simulations": {
            "asked": simulations,
            "done": len(records),
            "failed": list(verdict.failed),
            "draws": DRAWS,
            "seed": seed,
            "sampler": PosteriorOptions().sampler,
            "median_seconds": float(np.median([record.seconds for record in good])),
            "detail": {
                name: float(np.mean([record.detail[name] for record in good if name in record.detail]))
                for name in dict.fromkeys(name for record in good for name in record.detail)
            },
        },
        **verdict.as_json(),
        "provenance": {"tissueid": __version__},
    }, verdict
