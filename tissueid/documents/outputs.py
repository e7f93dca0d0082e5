"""Manifest of one output set."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from tissueid.documents.base import Count, Document


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
