"""Output of tissueid study check --json."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from tissueid.documents.base import Document, Fraction
from tissueid.documents.inspect import Refusal


class Missing(Document, frozen=True):
    """Keys that are missing."""

    table: Literal["study", "calibration", "tip", "specimen", "trial"]
    keys: Annotated[tuple[str, ...], Meta(min_length=1)]  # Any one of them will do
    weight: Literal[1, 2, 3]  # 3: essential; 2: a reviewer asks for it; 1: it helps
    why: str
    where: tuple[str, ...]  # Specimens or trials without it; empty where none has it


class StudyCheck(Document, frozen=True):
    """Completeness of a study file."""

    schema: Literal["tissueid/study-check/1"]
    path: str  # study.toml as it was named
    grade: Literal["A", "B", "C", "D", "E", "F"]
    share: Fraction  # Share of the weights that is stated
    missing: tuple[Missing, ...]  # What is not stated, the weightiest first
    unmatched: tuple[Refusal, ...]
