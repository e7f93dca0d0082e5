"""Files of an output folder: bundle, state of a run, list of its files; and the calibration of a frame."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from tissueid.documents.base import Count, Document, NonNegative, Placed, Positive, PositiveCount, Text
from tissueid.documents.identification import Estimate, Model, Provenance, Validity
from tissueid.documents.inspect import Units
from tissueid.documents.rupture import Law
from tissueid.flags import Flag


class File(Document, frozen=True):
    """File of an output set."""

    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
    bytes: Count


class Outputs(Document, frozen=True):
    """Files of one run."""

    schema: Literal["tissueid/outputs/1"]
    run: Annotated[str, Meta(pattern="^[0-9]{6,}$")]
    files: dict[str, File]
    #: Public names of the set that this one follows; those it does not carry are removed
    replaces: tuple[str, ...]


class Writer(Document, frozen=True):
    """Process that writes the output set."""

    pid: int
    host: str


class Files(Document, frozen=True):
    """Files of a run."""

    looked_into: Count
    total: Count
    refused: Count  # Files and sheets that are not used


class Specimens(Document, frozen=True):
    """Specimens of a run."""

    total: Count
    done: Count
    known_before: Count
    running: Count
    waiting: Count
    failed: Count


class Running(Document, frozen=True):
    """Specimen in work."""

    specimen: str
    worker: str
    attempts: Count
    seconds: float


class Failure(Document, frozen=True):
    """Specimen that failed."""

    specimen: str
    reason: str


class Status(Document, frozen=True):
    """Progress of a run."""

    schema: Literal["tissueid/status/1"]
    state: Literal["running", "finished", "interrupted", "stopped", "failed"]
    started: float  # Seconds since 1970
    ended: float | None
    writer: Writer | None
    reason: str | None
    files: Files
    specimens: Specimens
    specimens_per_minute: float | None
    left_s: float | None
    running: tuple[Running, ...]
    failures: tuple[Failure, ...]  # At most 100
    refusals: tuple[str, ...]  # Inputs that are not used, and why: at most 100


class Bundle(Document, frozen=True):
    """The numbers of the model (theta, covariance, draws) are data sets beside it.

    Covariance and draws are the posterior's where one was sampled, and every draw is passive.
    """

    schema: Literal["tissueid/bundle/1"]
    specimen: Text
    model: Model
    theta_names: Annotated[tuple[Text, ...], Meta(min_length=1)]
    parameters: tuple[Estimate, ...]  # None of the yardstick
    validity: Validity
    sigma_N: NonNegative
    units: Units
    flags: tuple[Flag, ...]
    provenance: Provenance
    rupture: Law | None  # When the tissue breaks, as `tissueid rupture` found; null where nothing is claimed


class Source(Placed, frozen=True):
    """Recording a calibration was made from."""

    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]


class Frame(Document, frozen=True):
    """Deflection of machine, load cell and fixture against force."""

    schema: Literal["tissueid/frame/1"]
    tissueid: str  # Version that wrote this
    force_N: Annotated[tuple[NonNegative, ...], Meta(min_length=2)]  # Knots of force, growing from 0 [N]
    #: du/dF at the knots, linear between them [mm/N]
    compliance_mm_per_N: Annotated[tuple[NonNegative, ...], Meta(min_length=2)]
    covariance: tuple[tuple[float, ...], ...]  # Of the compliances, noise and repeatability together [mm2/N2]
    deflection_mm: tuple[NonNegative, ...]  # u(F) at the knots, for reading [mm]
    sd_mm: tuple[NonNegative, ...]  # Standard deviation of u(F) at the knots [mm]
    range_N: tuple[NonNegative, NonNegative]  # Forces the recordings cover [N]
    stiffness_N_per_mm: Positive  # Tangent stiffness at the largest force [N/mm]
    noise_sd_mm: NonNegative  # Standard deviation of the residual displacement [mm]
    #: Standard deviation between loadings at the largest force [mm]; null for one: 5 % is assumed then
    repeatability_sd_mm: NonNegative | None
    loadings: PositiveCount  # Loadings that were used
    sources: Annotated[tuple[Source, ...], Meta(min_length=1)]
