"""Progress of a run."""

from __future__ import annotations

from typing import Literal

from tissueid.documents.base import Count, Document


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
