"""Ruptures of a cohort (rupture.json)."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, field

from tissueid.documents.base import Count, Document, Fraction, NonNegative, Placed, Positive, PositiveCount
from tissueid.documents.identification import Provenance
from tissueid.documents.population import Confounding
from tissueid.flags import Flag

Criterion = Literal["work", "weighted-force", "stored-energy", "depth"]
Unit = Literal["N mm", "N", "mm"]
Kind = Literal["work", "weighted force", "elastic limit"]
Quantity = Literal["force_N", "depth_mm", "work_N_mm"]
Direction = Literal["falls", "rises", "undecided"]


class Law(Document, frozen=True):
    """The tissue breaks when a measure of its loading first reaches the threshold."""

    criterion: Criterion
    threshold: Positive  # Median over tests of this specimen
    unit: Unit
    weight: NonNegative
    sd_ln: NonNegative  # Of ln threshold from test to test
    specimen_sd_ln: NonNegative
    population: Positive  # Median over specimens
    population_ci95: tuple[float, float]
    residual: Fraction  # Share of the force that is left


class Decision(Document, frozen=True):
    """Criterion that was decided for."""

    answer: Literal["decided", "undecided", "none"]
    kind: Kind | None
    criterion: Criterion | None
    probability: dict[str, NonNegative]  # Of each kind of criterion: work, weighted force, elastic limit
    reason: str


class Threshold(Document, frozen=True):
    """Threshold under one criterion."""

    criterion: Criterion
    unit: Unit
    median: Positive
    ci95: tuple[float, float]
    sd_ln: NonNegative
    specimen_sd_ln: NonNegative
    ln_evidence: float
    growth: Positive
    trend: float
    trend_p: Fraction | None
    specimens: dict[str, float]


class AtRupture(Document, frozen=True):
    """Force, depth and work at rupture."""

    force_N: float | None
    depth_mm: float | None
    work_N_mm: float | None


class Speed(Document, frozen=True):
    """Ruptures at one speed."""

    speed_mm_s: Positive
    ruptured: Count
    censored: Count
    mean: AtRupture
    sd: AtRupture
    hardening: float | None  # Mean of x F_s'/F
    dynamic_share: float | None


class Change(Document, frozen=True):
    """Change from the slowest to the fastest speed."""

    quantity: Quantity
    ratio: Positive
    ci95: tuple[float, float]
    direction: Direction


class Hardening(Document, frozen=True):
    """Growth of the dynamic share with speed."""

    mean: float
    ci95: tuple[float, float]
    ruptures: PositiveCount
    direction: Direction


class Limit(Document, frozen=True):
    """Threshold of one criterion for one specimen."""

    value: float  # Of censored tests a lower bound of the threshold
    sd_ln: NonNegative
    growth: Positive  # d ln(value) / d ln(depth) at the end


class Measures(Document, frozen=True):
    """Measures of one test at its rupture."""

    work: Limit
    weighted_force: Limit = field(name="weighted-force")
    stored_energy: Limit = field(name="stored-energy")
    depth: Limit


class Test(Placed, frozen=True):
    """One test to rupture, or to its end without."""

    specimen: str
    ruptured: bool
    speed_mm_s: Positive
    force_N: float
    force_sd_N: NonNegative
    depth_mm: Positive
    depth_sd_mm: NonNegative
    work_N_mm: float
    work_sd_N_mm: NonNegative
    dynamic_share: float
    hardening: float
    hardening_sd: NonNegative
    settled: bool
    residual: float | None
    measures: Measures


class RuptureLaw(Document, frozen=True):
    """Rupture law of one bundle."""

    specimen: str
    bundle: str
    law: Law


class LeftOut(Placed, frozen=True):
    """Recording that took no part."""

    reason: str


class Rupture(Document, frozen=True):
    """Ruptures of a cohort, and the criterion they agree with."""

    schema: Literal["tissueid/rupture/1"]
    asked: Literal["none", "auto", "work", "weighted-force", "stored-energy", "depth"]
    taken: Literal["none", "work", "weighted-force", "stored-energy", "depth"]  # Criterion in the bundles
    weight: NonNegative  # w of the weighted force F_s + w F_d
    decision: Decision
    criteria: tuple[Threshold, Threshold, Threshold, Threshold]
    confounding: Confounding
    speeds: tuple[Speed, ...]
    #: At ten times the speed, inside specimens; empty where no effect of speed can be told
    changes: tuple[Change, ...]
    hardening: Hardening | None  # x F_s'/F of ruptures at depths of ten v tau or more
    tests: Annotated[tuple[Test, ...], Meta(min_length=1)]
    laws: tuple[RuptureLaw, ...]
    sentences: tuple[str, ...]
    left_out: tuple[LeftOut, ...]
    flags: tuple[Flag, ...]
    provenance: Provenance
