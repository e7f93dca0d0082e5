"""One remark about a recording or a fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from tissueid.documents.base import Document, Text
from tissueid.flags import FLAGS


class Flag(Document, frozen=True, forbid_unknown_fields=False):
    """A stable code, one plain sentence, and the numbers behind it as further members."""

    #: Constraints of the JSON Schema beyond types
    RULES: ClassVar[Mapping[str, Any]] = {
        "additionalProperties": {
            "anyOf": [
                {"type": ["number", "string", "boolean", "null"]},
                {"type": "array", "items": {"type": ["number", "string", "boolean", "null"]}},
            ]
        }
    }

    code: Annotated[str, Meta(extra_json_schema={"enum": list(FLAGS)})]
    message: Text  # One plain sentence with its numbers
    quantity: str | None = None  # Quantity a decision is about
    unit: str | None = None
    keys: tuple[str, ...] | None = None  # Keys of study.toml that were stated
    because: str | None = None


Value = float | str | bool | None | tuple[float | str | bool | None, ...]
