"""Measures of guided sessions."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from tissueid.documents.base import Document, Positive


class Attempt(Document, frozen=True):
    """One attempt."""

    file: str
    pseudonym: str | None
    started: str
    complete: bool  # Whether the wire went through
    seconds: float
    entry_error_mm: float | None
    end_error_mm: float
    angle_deg: float
    angle_se_deg: float
    path_mm: float
    path_over_chord: float
    mean_force_N: float
    peak_force_N: float
    log_jerk: float | None  # Less ln of the dimensionless jerk


class Learning(Document, frozen=True):
    """Learning curve of one measure."""

    pseudonym: str | None
    measure: Literal["end_error_mm", "angle_deg", "seconds"]
    first: float
    exponent: float
    exponent_se: float
    attempts: Annotated[int, Meta(ge=4)]


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
