"""Base of every document, and the numbers and texts they share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, TypeVar

import msgspec
import numpy as np
from msgspec import Meta, Struct

from tissueid.flags import FLAGS, Flag

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

    RULES: ClassVar[JsonSchema] = {}  # Constraints of the JSON Schema beyond types


class Placed(Document, frozen=True):
    """Part of a document that says where it comes from."""

    path: str
    sheet: str | None


class OfSheet(Placed, frozen=True):
    """Record of one recording."""

    path: Text
    sheet: str | None  # Workbook sheet, null where the file has none


_T = TypeVar("_T")


def typed(document: Any, kind: type[_T], *, known: bool = False) -> _T:
    """Read a document that was parsed, or that is about to be written, as its type.

    ``document``: plain dicts, lists and values; ``kind``: a record of this package, or tuples and mappings of
    such; ``known``: of this version, so that no flag has a code of a later one.  Raises
    msgspec.ValidationError: it is none, with the place.
    """
    return msgspec.convert(document, kind, dec_hook=_known_flag if known else _flag)


def _flag(kind: type[Any], document: Any) -> Any:
    if kind is not Flag:
        raise NotImplementedError(f"a document holds no {kind.__name__}")
    if not isinstance(document, Mapping) or not {"code", "message"} <= document.keys():
        raise ValueError("a flag has a code and a message")
    return Flag.read(document)


def plain(document: Any) -> Any:
    """Rewrite a document, or any part of one, in plain dicts, lists and values."""
    return _listed(msgspec.to_builtins(document, enc_hook=_members, str_keys=True))


def members(one: object, kind: type[Struct]) -> dict[str, Any]:
    """Members of a record, read off an object that has them all."""
    return {name: getattr(one, name) for name in kind.__struct_fields__}


def _listed(value: Any) -> Any:
    """The same value with lists in place of tuples, as JSON reads them."""
    if isinstance(value, dict):
        return {key: _listed(child) for key, child in value.items()}
    return [_listed(child) for child in value] if isinstance(value, list | tuple) else value


def _members(value: Any) -> Any:
    if isinstance(value, Flag):
        return {"code": value.code, "message": value.message, **value.values}
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in JSON: {value!r}")


def _known_flag(kind: type[Any], document: Any) -> Any:
    flag = _flag(kind, document)
    if flag.code not in FLAGS:
        raise ValueError(f"there is no flag {flag.code!r}")
    if not isinstance(flag.message, str) or not all(map(_plain, flag.values.values())):
        raise ValueError("a flag has a sentence and plain values")
    return flag


def _plain(value: Any) -> bool:
    """True of a number, a text, a truth value, null, and a list of such."""
    return all(
        isinstance(one, str | int | float | None) for one in (value if isinstance(value, list) else [value])
    )
