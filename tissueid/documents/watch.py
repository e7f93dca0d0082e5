"""One line of `tissueid watch --json`: the verdict on one test."""

from __future__ import annotations

from typing import Literal

from tissueid.documents.base import Document, NonNegative, Text
from tissueid.documents.flag import Flag
from tissueid.documents.inspect import Contact, Error, Units
from tissueid.documents.measured import Measured


class Verdict(Document, frozen=True):
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


class Watch(Document, frozen=True):
    """Verdict on a recording that arrived."""

    path: Text
    sheet: str | None  # Workbook sheet, null where the file has none
    specimen: str | None
    excluded: str | None
    units: Units | None
    contact: Contact | None
    measured: Measured | None
    verdict: Verdict  # As `inspect` says it; refused where the file can't be used
    flags: tuple[Flag, ...]
    digest: str | None  # SHA-256 of the samples; null for a file that was refused
    error: Error | None
    #: With --fit: the test fitted alone, one branch and constant stiffness; null where it was not
    fit: Fit | None
