"""Tissueid design."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from tissueid.documents.base import Count, Document, NonNegative, Positive, PositiveCount


class Number(Document, frozen=True):
    """Median and central 95 % of the draws."""

    name: str
    median: float
    low: float
    high: float


class Tissue(Document, frozen=True):
    """The tissues that were planned for."""

    name: str
    words: str  # Origin of the tissues
    draws: PositiveCount
    law: str  # Law of the tissues, as fit --model takes it
    branches: Annotated[int, Meta(ge=1, le=12)]
    stiffness_degree: Annotated[int, Meta(ge=0, le=2)]
    depth_mm: Positive
    numbers: tuple[Number, ...]


class Setting(Document, frozen=True):
    """Channel setting of a machine."""

    rate_Hz: Positive
    noise_N: Positive
    noise_correlation_s: NonNegative
    filter_s: NonNegative
    filter_sd_s: float | None


class Machine(Document, frozen=True):
    """Test machine that protocols are planned for."""

    name: str
    max_speed_mm_min: Positive
    acceleration_mm_s2: Positive
    max_force_N: Positive
    settings: Annotated[tuple[Setting, ...], Meta(min_length=1)]
    min_speed_mm_min: Positive
    standoff_mm: NonNegative
    return_speed_mm_min: float | None
    contact_sd_mm: Positive
    frame_stiffness_N_per_mm: float | None
    frame_stiffness_N_per_mm_sd: float | None
    force_gain_sd: NonNegative
    displacement_gain_sd: NonNegative
    skew_sd_s: NonNegative
    notes: str


class Want(Document, frozen=True):
    """Precision that was asked for."""

    name: str
    share: Positive


class Asked(Document, frozen=True):
    """Request: precisions, limits and times."""

    wants: Annotated[tuple[Want, ...], Meta(min_length=1)]
    interval: Literal["statistical", "total"]
    #: Share of the tissues for which a precision must be reached
    assurance: Annotated[float, Meta(ge=0.5, le=1)]
    max_depth_mm: Positive
    max_force_N: Positive
    budget_s: Positive
    recovery_s: NonNegative
    setup_s: NonNegative
    repeats: PositiveCount
    max_logs: PositiveCount
    gain_sd: NonNegative
    time_sd: NonNegative
    specimens: PositiveCount


class Limit(Document, frozen=True):
    """One limit, and what it costs."""

    name: str
    words: str  # Change that was made
    factor: Positive  # By how much the best precision betters; where it is enough, by how much at the least
    enough: bool


class Verdict(Document, frozen=True):
    """Verdict on the best protocol."""

    reached: bool
    limits: tuple[Limit, ...]
    remarks: tuple[str, ...]


class Planned(Document, frozen=True):
    """Channel setting of a protocol."""

    words: str  # In a few words
    rate_Hz: Positive
    noise_N: Positive  # Standard deviation of the noise of one sample
    noise_correlation_s: NonNegative  # Time over which its correlation falls to 1/e; 0 is white
    filter_s: NonNegative  # Time constant of the force channel's low-pass


class Indentation(Document, frozen=True):
    """One kind of indentation in a protocol."""

    words: str
    speed_mm_min: Positive
    depth_mm: Positive
    hold_s: NonNegative
    repeats: PositiveCount
    seconds: Positive  # Machine time of one log without rest
    peak_force_N: NonNegative


class Precision(Document, frozen=True):
    """Precision of one quantity under a protocol."""

    name: str
    wanted: Positive
    median: NonNegative  # Over the tissues
    assured: NonNegative  # Reached or bettered by the share `assurance` of the tissues


class Protocol(Document, frozen=True):
    """Planned protocol, its time and its precisions."""

    reached: bool  # All wants are met
    #: Machine time of a specimen: mounting, approach, ramp, hold, return, rests between logs
    seconds: Positive
    total_seconds: Positive  # Of all specimens
    logs: PositiveCount  # Recordings of a specimen
    setting: Planned
    indentations: Annotated[tuple[Indentation, ...], Meta(min_length=1)]
    precision: Annotated[tuple[Precision, ...], Meta(min_length=1)]
    worst: NonNegative  # Largest ratio of assured to wanted; at most 1 where all wants are met


class Against(Document, frozen=True):
    """Protocol that was given, for comparison."""

    name: str
    obstacle: str | None  # Why it can't be run on this machine
    protocol: Protocol | None


class Front(Protocol, frozen=True):
    """Protocol of least machine time for a multiple of the wants."""

    factor: Positive  # Multiple of the wants


class Work(Document, frozen=True):
    """Amount of what was looked at."""

    paths: Count
    protocols: Count


class Design(Document, frozen=True):
    """Protocols of least machine time for wanted precisions: standard deviations as shares of the value."""

    schema: Literal["tissueid/design/1"]
    tissue: Tissue  # The tissues that were planned for
    machine: Machine
    asked: Asked
    verdict: Verdict
    protocols: Annotated[tuple[Protocol, ...], Meta(min_length=1)]  # The best first
    against: Against | None  # A protocol that was given
    front: tuple[Front, ...]  # The least machine time for multiples of the wants
    work: Work  # Amount of what was looked at
