"""Functions that take documents, called with plain ones: tests change a member and say no more of it."""

import inspect
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, TypeVar, get_type_hints

from tissueid.documents import plain, typed

_F = TypeVar("_F", bound=Callable[..., Any])


def typed_call(function: _F) -> _F:
    """The same function for documents as plain dicts: each is read as the type of its parameter."""
    hints, signature = get_type_hints(function), inspect.signature(function)

    @wraps(function)
    def call(*args: Any, **more: Any) -> Any:
        given = signature.bind(*args, **more)
        for name, value in given.arguments.items():
            if _plain(value):
                given.arguments[name] = typed(plain(value), hints[name])
        return function(*given.args, **given.kwargs)

    return call  # type: ignore[return-value]


def _plain(value: Any) -> bool:
    if isinstance(value, Mapping):
        return True
    return isinstance(value, list | tuple) and any(isinstance(one, Mapping) for one in value)
