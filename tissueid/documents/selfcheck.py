"""Calibrate.json: whether the posterior covers what it claims, for one protocol."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, field

from tissueid.documents.base import (
    Count,
    Document,
    Fraction,
    NonNegative,
    OpenFraction,
    Positive,
    PositiveCount,
    Text,
)


class Source(Document, frozen=True):
    """Origin of the tissues that are simulated."""

    kind: Literal["recipe", "study", "bundle"]
    path: Text
    specimen: str


class Model(Document, frozen=True):
    """Contact model of the simulations."""

    branches: Annotated[int, Meta(ge=0, le=3)]
    stiffness_degree: Annotated[int, Meta(ge=0, le=2)]
    static_pooling: Literal["scaled", "partial", "shared"]
    depth_mm: Positive


class Noise(Document, frozen=True):
    """Noise of the simulations."""

    model: Literal["white", "ar1", "white+ar1"]
    white_share: Fraction  # Share of the variance that is white beside the correlated part
    reference_step_s: Positive  # Step [s] over which phi is the correlation


class Protocol(Document, frozen=True):
    """Recordings of one simulated specimen."""

    words: Text
    logs: PositiveCount
    samples: PositiveCount
    step_s: Positive
    duration_s: Positive
    depth_mm: Positive
    speeds_mm_s: tuple[NonNegative, NonNegative]
    #: Largest standard deviation of the depth at which the tool meets the tissue [mm]
    contact_sd_mm: NonNegative


class Prior(Document, frozen=True):
    """Prior of one parameter."""

    name: Text
    prior: Text
    stated: bool  # True where the study states it, false where it is centred on the tissue or a default


class Simulations(Document, frozen=True):
    """Simulations that were asked for and done."""

    asked: PositiveCount
    done: PositiveCount
    failed: tuple[str, ...]  # Why a simulation has no posterior, one entry each
    draws: PositiveCount  # Thinned posterior draws that each truth is ranked among
    seed: Count
    sampler: Literal["emcee", "exact"]
    median_seconds: NonNegative  # Of one simulation and its inference
    #: Means: acceptance of the sampler, shares of identified parameters and of misfit alarms, logs fitted
    detail: dict[str, float]


class Inside(Document, frozen=True):
    """Ranks inside each band."""

    percent_95: bool = field(name="95")
    percent_99: bool = field(name="99")
    family: bool


class Coverage(Document, frozen=True):
    """Coverage of intervals of one level."""

    level: OpenFraction
    fraction: Fraction
    low: Fraction
    high: Fraction
    inside: bool


Counts = Annotated[tuple[Count, ...], Meta(min_length=1)]


class Parameter(Document, frozen=True):
    """Calibration of one parameter."""

    name: Text
    calibrated: bool  # Ranks and every coverage keep the family-wise 99 % bands
    mean_z: float  # Mean of (truth - posterior mean) / posterior sd; 0 where right
    #: Root mean square of the same; 1 where right, above 1 where intervals are too narrow
    spread_ratio: NonNegative
    contraction: float  # 1 - mean posterior variance / variance of the truths; 0 where the data said nothing
    inside: Inside
    coverage: Annotated[tuple[Coverage, ...], Meta(min_length=1)]
    histogram: Counts  # Ranks in 20 equal parts of their range
    ecdf: Counts  # Ranks below each of bands.points


class Band(Document, frozen=True):
    """Band of the counts of ranks."""

    level: OpenFraction  # Simultaneous probability of keeping the band
    low: Counts
    high: Counts


class Bands(Document, frozen=True):
    """Counts of ranks below each point that a right posterior keeps, at all points at once."""

    points: Annotated[tuple[OpenFraction, ...], Meta(min_length=1)]
    percent_95: Band = field(name="95")
    percent_99: Band = field(name="99")
    family: Band


class Verdict(Document, frozen=True):
    """Verdict on all parameters."""

    calibrated: bool
    reasons: tuple[Text, ...]


class Provenance(Document, frozen=True):
    """Program of the run."""

    tissueid: Text


class SelfCheck(Document, frozen=True):
    """Calibration of intervals by simulation."""

    schema: Literal["tissueid/selfcheck/1"]
    source: Source
    model: Model
    noise: Noise
    #: total: calibration defects were drawn from their priors, and the intervals know these
    interval: Literal["statistical", "total"]
    protocol: Protocol
    priors: tuple[Prior, ...]  # Priors that truths were drawn from, and those the inference was given
    simulations: Simulations
    parameters: Annotated[tuple[Parameter, ...], Meta(min_length=1)]
    bands: Bands  # Counts of ranks below each point that a right posterior keeps, at all points at once
    verdict: Verdict
    provenance: Provenance
