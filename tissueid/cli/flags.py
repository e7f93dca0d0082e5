"""Flags of a command as a frozen dataclass: each field is declared once, with its option beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import wraps
from inspect import get_annotations
from typing import Any

import click

#: Key of a field's option among its metadata.
_DECLARED = "click"


def option(*names: str, **settings: Any) -> Any:
    """Declare an option at the field that holds it.

    ``names``: as typed, ``--out`` and the like; ``settings``: those of :func:`click.option`.
    """
    return field(metadata={_DECLARED: (click.option, names, settings)})


def argument(**settings: Any) -> Any:
    """Declare a positional argument, with the settings of :func:`click.argument`."""
    return field(metadata={_DECLARED: (click.argument, (), settings)})


def takes(kind: type[Any]) -> Callable[[Callable[[Any], int]], Callable[..., int]]:
    """Give a command the options of a dataclass, and the dataclass to its function.

    Options stand in ``--help`` in the order of the fields: of the class itself, then of those it is made of.
    """

    def decorate(function: Callable[[Any], int]) -> Callable[..., int]:
        @wraps(function)
        def called(**values: Any) -> int:
            return function(kind(**values))

        command: Callable[..., int] = called
        for name, (declared, names, settings) in reversed(list(_declared(kind))):
            command = declared(*names, name, **settings)(command)
        return command

    return decorate


def _declared(kind: type[Any]) -> Iterator[tuple[str, Any]]:
    for part in kind.__mro__:
        for name in get_annotations(part):
            yield name, kind.__dataclass_fields__[name].metadata[_DECLARED]


@dataclass(frozen=True, kw_only=True)
class OutputFlags:
    """Amount and form of what is printed."""

    quiet: int = option("-q", "--quiet", count=True, help="Print errors only.")
    verbose: int = option("-v", "--verbose", count=True, help="Say more; a bug shows its traceback.")
    as_json: bool = option("--json", is_flag=True, help="Print one JSON document to stdout.")
