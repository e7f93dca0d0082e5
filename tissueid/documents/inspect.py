"""Output of `tissueid inspect --json`."""

from __future__ import annotations

from typing import Literal

from tissueid.documents.base import Count, Document, Fraction, NonNegative, OfSheet, PositiveCount, Text
from tissueid.documents.measured import Measured
from tissueid.documents.quantities import Cycle
from tissueid.flags import Flag

#: Why an input was refused: REFUSAL_CODES of tissueid.ingest.refusals, and those that only a fit finds
#: (no_contact, too_few_samples, fit_failed, mixed_axes, frame_range), or that end a job.
RefusalCode = Literal[
    "unreadable_file", "empty_file", "not_an_export", "unreadable_workbook", "unreadable_archive",
    "reader_failed", "job_failed", "out_of_memory", "worker_killed", "other_versions", "no_trial_sheet",
    "unknown_sheet", "no_recording", "no_rows", "no_columns", "column_not_found", "unknown_unit",
    "wrong_unit", "unit_conflict", "ambiguous_decimal", "inconsistent_decimal", "damaged_number",
    "text_in_numbers", "empty_cell", "not_finite", "ragged_rows", "mixed_tables", "time_backwards",
    "several_clocks", "implausible_range", "invalid_study", "study_unmatched", "invalid_frame", "damaged_log",
    "wrong_scale", "not_rigid", "frame_range", "no_contact", "fit_failed", "mixed_axes",
    "too_few_samples",
]  # fmt: skip


class Error(Document, frozen=True):
    """Reason of a refusal."""

    code: RefusalCode
    message: Text
    line: PositiveCount | None
    column: PositiveCount | None


class Refusal(OfSheet, frozen=True):
    """Recording that could not be read."""

    error: Error


class Columns(Document, frozen=True):
    """Columns that were taken, by quantity, named as printed in the file."""

    time: str | None = None
    displacement: str | None = None
    force: str | None = None


class Point(Document, frozen=True):
    """One sample as recorded, in s, mm and N, before sign or zero are changed."""

    time_s: float
    displacement_mm: float
    force_N: float


class Contact(Document, frozen=True):
    """Contact of tool and tissue, in recorded displacement; null where there was none."""

    displacement_mm: float
    sd_mm: NonNegative
    baseline_N: float
    in_record: bool


class Phase(Document, frozen=True):
    """Phase of a recording."""

    kind: Literal["approach", "ramp", "hold", "creep", "retract", "rest", "cycle"]
    start_s: float
    end_s: float
    #: Of the line through 20 to 80 % of the travel, in compression; of a cycle, mean speed of its loading
    speed_mm_s: float
    braking_s: float  # Time a ramp brakes before its stop
    peak_s: float | None  # Time of a cycle's deepest sample; null in other phases


class Corner(Document, frozen=True):
    """Corner between ramp and hold."""

    phase: Count  # Index of the ramp in phases
    time_s: float  # Meeting of the ramp's line with that of the next phase
    duration_s: NonNegative
    overshoot_mm: NonNegative
    ringing_swings: Count
    ringing_period_s: float | None


class Event(Document, frozen=True):
    """Event that a machine logged."""

    kind: Literal["rupture", "doubtful_rupture", "slip", "settling", "abort", "load_limit"]
    time_s: float
    values: dict[str, float]  # Numbers of the event, named with their unit


class Verdict(Document, frozen=True):
    """Keep it (good), stop and look, or push again (repeat), with one reason."""

    level: Literal["good", "look", "repeat"]
    reason: str | None


class Units(Document, frozen=True):
    """Units of displacement and force: mm and N, or normalised; keys keep names, each `unit` is in these."""

    length: Literal["mm", "1"]  # 1 for a strain or stretch
    force: Literal["N", "MPa"]  # MPa for a stress
    time: Literal["s"]


class Trial(OfSheet, frozen=True):
    """Recording as it was read."""

    specimen: str
    excluded: str | None  # Why the study takes it out of the fit; null where it takes part
    recipe: Text  # Key of the reader that matched
    recipe_reason: str  # Why the reader was taken, in its own words
    recipe_confidence: Fraction  # Confidence of the reader in the file
    encoding: str | None
    delimiter: str | None
    decimal: str | None
    columns: Columns  # Column that was taken for each quantity, named as printed in the file
    n_samples: Count  # All numeric rows
    first: Point
    last: Point
    peak_force: Point  # The sample of largest absolute force
    compression_sign: Literal[1, -1]
    force_sign: Literal[1, -1]  # Sign of the recorded force under compression
    force_noise_N: NonNegative  # Standard deviation of the white part of the force noise
    contact: Contact | None
    phases: tuple[Phase, ...]
    corners: tuple[Corner, ...]  # Stop or turn of each ramp
    events: tuple[Event, ...]
    cycles: tuple[Cycle, ...]  # Load-unload loops, measured from the samples alone
    measured: Measured  # Peaks, forces in the hold, loops, relaxation times and moduli, no model
    verdict: Verdict  # Keep it (good), stop and look, or push again (repeat), with one reason
    flags: tuple[Flag, ...]
    units: Units


class Judged(Document, frozen=True):
    """As `inspect` says it; refused where the file can't be used."""

    level: Literal["good", "look", "repeat", "refused"]
    reason: str | None


class Parameter(Document, frozen=True):
    """Parameter of a first fit."""

    name: str
    unit: str
    value: float | None
    stderr: float | None


class Fit(Document, frozen=True):
    """First fit of a recording."""

    nrmsd: NonNegative
    parameters: tuple[Parameter, ...]


class Watch(OfSheet, frozen=True):
    """Judged on a recording that arrived."""

    specimen: str | None
    excluded: str | None
    units: Units | None
    contact: Contact | None
    measured: Measured | None
    verdict: Judged  # As `inspect` says it; refused where the file can't be used
    flags: tuple[Flag, ...]
    digest: str | None  # SHA-256 of the samples; null for a file that was refused
    error: Error | None
    #: With --fit: the test fitted alone, one branch and constant stiffness; null where it was not
    fit: Fit | None
