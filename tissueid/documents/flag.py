"""One remark about a recording or a fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tissueid.documents.base import JsonSchema
from tissueid.flags import FLAGS

#: Members of a flag that are not among the numbers behind it.
_SAID = ("code", "message")
_PLAIN = {"type": ["number", "string", "boolean", "null"]}
#: JSON Schema of a flag: which numbers stand behind its sentence depends on its code.
FLAG_SCHEMA: JsonSchema = {
    "description": "A stable code, one plain sentence, and the numbers behind it as further members.",
    "type": "object",
    "properties": {
        "code": {"enum": list(FLAGS)},
        "message": {"type": "string", "minLength": 1, "description": "One plain sentence with its numbers"},
    },
    "required": list(_SAID),
    "additionalProperties": {"anyOf": [_PLAIN, {"type": "array", "items": _PLAIN}]},
}


class Flag:
    """Code, sentence, and the numbers behind it, which stand beside both in the file."""

    __slots__ = ("code", "message", "values")

    def __init__(self, code: str, message: str, values: Mapping[str, Any]) -> None:
        self.code = code
        self.message = message
        self.values = values

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Flag:
        """Read one from its members."""
        values = {key: value for key, value in document.items() if key not in _SAID}
        return cls(document["code"], document["message"], values)
