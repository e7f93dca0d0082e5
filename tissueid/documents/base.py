"""Base of every document, and the numbers and texts they share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Protocol

from msgspec import Meta, Struct

#: JSON Schema, or a part of one
JsonSchema = Mapping[str, Any]
NonNegative = Annotated[float, Meta(ge=0)]
Positive = Annotated[float, Meta(gt=0)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
OpenFraction = Annotated[float, Meta(gt=0, lt=1)]
Count = Annotated[int, Meta(ge=0)]
PositiveCount = Annotated[int, Meta(ge=1)]
Text = Annotated[str, Meta(min_length=1)]
Sha256 = Annotated[str, Meta(pattern="^([0-9a-f]{64})?$")]  # empty where a recording came from no file


class Document(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Immutable record of a document; a field with a default may be left out of the file."""


class Placed(Protocol):
    """Part of a document that says where it comes from."""

    @property
    def path(self) -> str:
        """File, as it was named."""

    @property
    def sheet(self) -> str | None:
        """Sheet of a workbook; ``None`` where the file has none."""
