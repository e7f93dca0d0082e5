"""Cohort of the specimens of a fit (population.json)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta

from tissueid.documents.base import Count, Document, Fraction, NonNegative, Positive
from tissueid.flags import Flag


class LeftOut(Document, frozen=True):
    """Specimen that took no part."""

    specimen: str
    reason: str


class Model(Document, frozen=True):
    """Contact model of every specimen."""

    branches: Count
    stiffness_degree: Count
    name: str | None = None  # Law that the specimens have in common


#: Ends of a central 95 % interval.
Interval = tuple[float, float]


class Level(Document, frozen=True):
    """Spread of one level of the cohort."""

    sd_ln: NonNegative
    ci95: Interval


class Quantity(Document, frozen=True):
    """One quantity of the population."""

    name: str  # Unit at its end
    words: str  # With the depth it is at
    unit: str
    median: Positive  # Of the typical tissue
    ci95: Interval  # Of the median, statistical
    #: With the machine that measured all specimens, whose calibration does not average out
    ci95_total: Interval | None
    #: Standard deviation of the natural logarithm between specimens, in the core of the distribution
    sd_ln: NonNegative
    sd_ln_ci95: Interval
    cv: NonNegative  # Coefficient of variation of that core
    cv_ci95: Interval
    levels: dict[str, Level]  # Standard deviation of ln between donors, sites or operators


class DegreesOfFreedom(Document, frozen=True):
    """Degrees of freedom of the t distribution."""

    median: NonNegative
    ci95: Interval


class Effect(Document, frozen=True):
    """Effect of a group or covariate on one quantity."""

    name: str
    covariate: str
    of: str | None
    against: str | None
    per: float | None  # Change of a numeric covariate that the ratio is of: one standard deviation
    ratio: NonNegative  # Of the quantity
    ci95: Interval
    probability: Fraction  # That the ratio is above 1


class Specimen(Document, frozen=True):
    """One specimen, in the order of `quantities`."""

    specimen: str
    separate: tuple[float, ...]  # Median of each quantity from its own logs
    separate_ci95: tuple[Interval, ...]
    pooled: tuple[float, ...]  # With the population
    pooled_ci95: tuple[Interval, ...]
    shrinkage: tuple[Fraction, ...]  # Share of the variance of ln that the population takes away
    far: Fraction  # Probability of being beyond the 99 % of a normal core
    outlier: str | None  # The quantity in which it is farthest, where it is an outlier
    deviation: float  # Of the quantity it is farthest in, in standard deviations between specimens
    smoothed: bool  # Its likelihood was written as a mixture of normals
    worth: NonNegative  # Effective stage-1 draws under the population


class Repeatability(Document, frozen=True):
    """Force of repeats within a specimen against that between specimens."""

    logs: Count
    groups: Count
    freedom: Count
    within_cv: NonNegative
    within_cv_ci95: Interval
    between_cv: NonNegative
    between_cv_ci95: Interval
    icc: Fraction
    icc_ci95: Interval


class Spread(Document, frozen=True):
    """Over logs."""

    median: NonNegative
    low68: NonNegative
    high68: NonNegative


class Trial(Document, frozen=True):
    """Typical tissue against one log of a held-out specimen."""

    specimen: str
    path: str
    sheet: str | None
    nrmsd_range: NonNegative
    nrmsd_mean: NonNegative


class HeldOut(Document, frozen=True):
    """Typical tissue of the others on each specimen; fractions, not percent."""

    folds: Count
    paper_a_percent: Interval
    nrmsd_range: Spread
    nrmsd_mean: Spread
    trials: tuple[Trial, ...]


class CohortSize(Document, frozen=True):
    """Specimens that a precision needs."""

    name: str
    precision: NonNegative  # Half width of a 95 % interval, relative
    mean: Count
    mean_range: tuple[Count, Count]
    sd: Count
    sd_range: tuple[Count, Count]


class Predictive(Document, frozen=True):
    """Draws of a new specimen."""

    specimens: Count
    refused: Count  # Draws that were not passive
    typical_is_drawn: bool


class Sampler(Document, frozen=True):
    """Chains and their convergence."""

    converged: bool
    chains: Count
    sweeps: Count
    r_hat: NonNegative
    r_hat_wanted: NonNegative
    ess: NonNegative
    ess_wanted: NonNegative


class Populations(Document, frozen=True):
    """Population that the specimens are drawn from."""

    model: Model
    depth_mm: Positive  # Common depth: the smallest that a specimen was identified to
    quantities: tuple[Quantity, ...]
    #: Medians, of ln quantities between specimens
    correlation: tuple[tuple[Annotated[float, Meta(ge=-1, le=1)], ...], ...]
    degrees_of_freedom: DegreesOfFreedom | None  # Of the t distribution; null for a normal population
    groups: tuple[str, ...]  # Groups that are compared, the largest first
    effects: tuple[Effect, ...]
    specimens: tuple[Specimen, ...]
    repeatability: Repeatability | None
    held_out: HeldOut | None
    #: Specimens needed; ranges are for the ends of the interval of the spread
    cohort_size: tuple[CohortSize, ...]
    predictive: Predictive
    sampler: Sampler


class Pair(Document, frozen=True):
    """Successive repeats of one specimen."""

    specimen: str
    force_N: NonNegative
    ln_ratio: float  # ln of the later over the earlier repeat


class Agreement(Document, frozen=True):
    """Bland-Altman of successive repeats, in ln force."""

    pairs: tuple[Pair, ...]
    bias: float
    bias_ci95: Interval
    lower: float
    lower_ci95: Interval
    upper: float
    upper_ci95: Interval


class Order(Document, frozen=True):
    """Effect of the order of runs."""

    per_run: float  # Change of ln force from one run to the next
    ci95: Interval
    p_value: NonNegative
    logs: Count
    specimens: Count


class Confounding(Document, frozen=True):
    """Speed against specimen: can the two be told apart."""

    kind: Literal["none", "partly", "confounded", "single speed"]
    speeds_mm_s: tuple[NonNegative, ...]
    parts: tuple[tuple[NonNegative, ...], ...]  # Speeds that meet in specimens
    sentence: str


class Provenance(Document, frozen=True):
    """Inputs and options of a cohort."""

    tissueid: str
    identification_sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
    group_by: str | None
    covariates: tuple[str, ...]
    tails: Literal["t", "normal"]
    seed: Count
    priors: dict[str, Any]  # As [population] of study.toml


class Population(Document, frozen=True):
    """Units are in the names; ln is natural."""

    schema: Literal["tissueid/population/1"]
    specimens_used: tuple[str, ...]
    left_out: tuple[LeftOut, ...]  # Specimens that can't stand in this population
    reason: str | None  # Why there is no population
    population: Populations | None
    agreement: Agreement | None
    order: Order | None
    confounding: Confounding | None
    flags: tuple[Flag, ...]
    provenance: Provenance
