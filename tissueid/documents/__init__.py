"""Documents: files and the output of ``--json``, as types."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from tissueid.documents.flag import Flag

_T = TypeVar("_T")


def typed(document: Any, kind: type[_T]) -> _T:
    """Read a document that was parsed, or that is about to be written, as its type.

    ``document``: plain dicts, lists and values; ``kind``: a record of this package, or tuples and mappings of
    such.  Raises msgspec.ValidationError: it is none, with the place.
    """
    return msgspec.convert(document, kind, dec_hook=_flag)


def _flag(kind: type[Any], document: Any) -> Any:
    if kind is Flag and isinstance(document, Mapping):
        return Flag.of(document)
    msg = f"a document holds no {kind.__name__}"
    raise NotImplementedError(msg)


def plain(document: Any) -> Any:
    """Rewrite a document, or any part of one, in plain dicts, lists and values."""
    return _listed(msgspec.to_builtins(document, enc_hook=_members))


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
    return value.tolist()  # numbers and arrays of numpy
