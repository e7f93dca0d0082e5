"""Recordings beside each other, no model."""

from __future__ import annotations

from typing import Literal

from tissueid.documents.base import Count, Document, PositiveCount


class Side(Document, frozen=True):
    """One number of one side."""

    mean: float | None
    sd: float | None  # Between logs
    count: Count
    ramp_time_s: tuple[float, float] | None


class MeasuredNumber(Document, frozen=True):
    """Measured number of both sides, and their ratio."""

    name: str
    unit: str
    #: Logs of one speed and depth; those with holds first and the deepest of them first
    program: PositiveCount
    hold: Count
    time_s: float | None  # After the stop
    one: Side
    other: Side
    ratio: float | None  # Of other over one
    reason: str | None  # Why they are not compared


class MeasuredPair(Document, frozen=True):
    """Two sets of recordings against each other."""

    one: str
    other: str
    numbers: tuple[MeasuredNumber, ...]


class MeasuredContrast(Document, frozen=True):
    """Recordings against each other, without a model."""

    schema: Literal["tissueid/measured-contrast/1"]
    tissueid: str
    pairs: tuple[MeasuredPair, ...]
