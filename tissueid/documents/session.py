"""The JSON document inside a session's log."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta

from tissueid.documents.base import Count, Document, Fraction, NonNegative, Positive
from tissueid.documents.identification import TipGeometry


class Tissue(Document, frozen=True):
    """Tissue of a session."""

    label: Count  # as in the records
    name: str  # specimen; in a blind session the number of the sample
    content_sha256: str | None  # of the bundle; null in a blind session
    draw: int | None  # posterior draw; null for theta, the bundle's one coherent vector
    depth_mm: float | None
    fastest_mm_s: float | None
    tip_radius_mm: float | None
    block: tuple[float, ...]  # the environment's parameter block; empty in a blind session
    tip: TipGeometry | None = None


class Device(Document, frozen=True):
    """Device of a session."""

    name: str
    why: str
    hardware: bool
    calibrated: bool
    clamp_N: NonNegative
    damping_N_s_per_m: NonNegative
    delay_ticks: NonNegative


class Scale(Document, frozen=True, forbid_unknown_fields=False):
    """Precheck.as_json; null for an installed force law."""

    force_scale: Positive
    motion_scale: Positive
    felt_force_is_measured_over: float | None = None
    felt_stiffness_is_measured_over: float | None = None
    device_stiffness_N_per_m: float | None = None
    peak_force_N: float | None = None
    clamp_N: float | None = None
    clipped_share_expected: float | None = None  # of the depth, where the force is clamped
    required_damping_N_s_per_m: float | None = None
    device_damping_N_s_per_m: float | None = None
    delay_ticks: float | None = None
    period_s: float | None = None
    known: str | None = None  # where the numbers of the device come from
    lowered_from_force_scale: float | None = None
    remarks: tuple[str, ...] | None = None


class Servo(Document, frozen=True):
    """Servo of a session."""

    period_s: Positive
    virtual_time: bool


class PeriodUs(Document, frozen=True):
    """Absolute error of the period."""

    median: NonNegative
    p99: NonNegative
    p99_9: NonNegative
    max: NonNegative


class Summary(Document, frozen=True):
    """Summary of a session."""

    ticks: Count
    seconds: NonNegative
    skipped_ticks: Count
    lost_records: Count
    period_us: PeriodUs  # absolute error of the period
    timing_degraded: bool  # more than 1 % of the ticks are off by more than 10 %
    scheduling: str
    shares: dict[str, Fraction]  # share of the ticks with each lamp lit
    contact_share: NonNegative
    peak_device_force_N: NonNegative
    peak_tissue_force_N: NonNegative
    deepest_mm: float
    energy_J: float  # taken from the hand, as the observer counts it
    switches: Count
    end_state: str
    fault: str
    recording_stopped: str | None  # why the recording ended before the session; null where it did not


class Session(Document, frozen=True):
    """Log of `tissueid render`: head before the first tick, summary after the last; it names no person."""

    schema: Literal["tissueid/session/1"]
    tissueid: str  # version
    started: str  # UTC, ISO 8601
    pseudonym: str | None  # of the person who felt it; never a name
    blind: bool
    tissues: Annotated[tuple[Tissue, ...], Meta(min_length=1)]
    environment: str  # tissue, free air, or the name of an installed force law
    #: kind (0 plane, 1 sphere, 2 box), point [m], normal, size [m], radius of the tool tip [m]
    surface: Annotated[tuple[float, ...], Meta(min_length=11, max_length=11)]
    device: Device
    scale: Scale | None  # Precheck.as_json; null for an installed force law
    script: str | None
    servo: Servo
    record: tuple[tuple[str, str, tuple[Count, ...]], ...]  # field, numpy type, shape
    summary: Summary | None  # null where the session was killed
    #: name of the scene it comes from; none in a blind session, and in logs before this key
    scene: str | None = None
    participation: dict[str, Any] | None = None  # of a person, in logs of 0.1


class Way(Document, frozen=True):
    """Measures of one way to the end of the drilling."""

    complete: bool  # The wire went through; else the way ends at the deepest place
    seconds: float  # From the cone's entry to the end
    #: Distance from the axis at the entry point of the bone [mm]; null where it was not reached
    entry_error_mm: float | None
    end_error_mm: float  # Distance from the axis at the end [mm]
    angle_deg: float  # Of the chord from the cone's entry to the end, against the axis [degrees]
    angle_se_deg: float
    path_mm: float  # Length of the way, smoothed over 50 ms [mm]
    path_over_chord: float
    mean_force_N: float  # At the device
    peak_force_N: float  # At the device
    #: Less ln of the dimensionless jerk, D^5 / A^2 times the integral of its square (Hogan & Sternad 2009,
    #: doi 10.3200/35-09-004-RC): nearer zero is smoother; null where the way is too short
    log_jerk: float | None


class Attempt(Way, frozen=True):
    """One attempt."""

    file: str
    pseudonym: str | None
    started: str


class Curve(Document, frozen=True):
    """Power law over attempts."""

    first: float  # Fitted value at the first attempt
    exponent: float  # Negative where the measure falls
    exponent_se: float
    attempts: Annotated[int, Meta(ge=4)]


class Learning(Curve, frozen=True):
    """Learning curve of one measure."""

    pseudonym: str | None
    measure: Literal["end_error_mm", "angle_deg", "seconds"]


class Refused(Document, frozen=True):
    """Log that is no attempt."""

    file: str
    reason: str


class Training(Document, frozen=True):
    """Attempts of trainees, measured."""

    schema: Literal["tissueid/training/1"]
    cone_entry_mm: Positive
    attempts: tuple[Attempt, ...]  # By person, then by time
    learning: tuple[Learning, ...]
    refused: tuple[Refused, ...]
