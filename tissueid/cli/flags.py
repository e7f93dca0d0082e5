"""Commands whose flags are a frozen object: each is declared once, with its option beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import wraps
from inspect import get_annotations
from pathlib import Path
from types import NoneType
from typing import Any, Literal, dataclass_transform, get_args, get_origin, get_type_hints

import click

#: Key of a field's option among its metadata.
_DECLARED = "click"


class _OfFolder(click.Path):
    """A file, or the folder whose bundle.h5 it is."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path of the file."""
        return super().convert(Path(value) / "bundle.h5" if Path(value).is_dir() else value, param, ctx)


_TYPES = {int: int, float: float, Path: click.Path(dir_okay=False, path_type=Path)}
#: Types that many options have.
PATH, THERE = click.Path(), click.Path(exists=True)
FILE_THERE = click.Path(exists=True, dir_okay=False, path_type=Path)
BUNDLE = _OfFolder(exists=True, dir_okay=False, path_type=Path)
FILE, FOLDER = click.Path(dir_okay=False), click.Path(file_okay=False)
FOLDER_THERE = click.Path(exists=True, file_okay=False)
FROM_0, FROM_1 = click.IntRange(min=0), click.IntRange(min=1)
REAL_FROM_0, ABOVE_0 = click.FloatRange(min=0.0), click.FloatRange(min=0.0, min_open=True)
PORT = click.IntRange(1, 65535)


def option(words: str, *names: str, **settings: Any) -> Any:
    """Declare an option at the field that holds it: ``words`` are its help.

    Its annotation says what the option is where ``settings``, of :func:`click.option`, do not: a bool is a
    flag, a Literal a choice, a tuple of any length may be given several times.  ``names``: where not the
    field's own.
    """
    return field(metadata={_DECLARED: (click.option, names, {"help": words, **settings})})


def argument(**settings: Any) -> Any:
    """Declare a positional argument, with the settings of :func:`click.argument`."""
    return field(metadata={_DECLARED: (click.argument, (), settings)})


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(option, argument))
class Flags:
    """Base of the flags of a command: its subclasses are frozen dataclasses of options and arguments."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)


def subcommand(
    name: str, *examples: str, group: click.Group | None = None
) -> Callable[[Callable[[Any], int]], click.Command]:
    """Make a command of a function that takes ``flags``, with the options of their class.

    Options stand in ``--help`` in the order of the fields: of the class itself, then of those it is made of.
    ``examples``: what one types behind the name of the command.
    """

    def decorate(function: Callable[[Any], int]) -> click.Command:
        kind = get_type_hints(function)["flags"]

        @wraps(function)
        def called(**values: Any) -> int:
            return function(kind(**values))

        for declare in reversed(list(_declared(kind))):
            declare(called)
        whole = name if group is None else f"{group.name} {name}"
        lines = (f"tissueid {whole} {example}".rstrip() for example in examples)
        make = click.command if group is None else group.command
        return make(name, epilog=example_lines("\n".join(lines)))(called)

    return decorate


def typed(*fields: str) -> list[str]:
    """Options of these fields that stand on the command line, as they are written there."""
    context = click.get_current_context()
    found = {one.name: one.opts[-1] for one in context.command.params}
    said = click.core.ParameterSource.COMMANDLINE
    return [found[name] for name in fields if context.get_parameter_source(name) is said]


def example_lines(examples: str) -> str:
    """The end of a command's help."""
    return "\b\nExamples:\n" + "".join(f"  {line}\n" for line in examples.strip().splitlines())


def _declared(kind: type[Any]) -> Iterator[Callable[[Any], Any]]:
    hints = get_type_hints(kind)
    for part in kind.__mro__:
        for name in get_annotations(part):
            declared, names, given = kind.__dataclass_fields__[name].metadata[_DECLARED]
            of, several = _single(hints[name])
            known = {"type": click.Choice(get_args(of)) if get_origin(of) is Literal else _TYPES.get(of)}
            if declared is click.argument:
                yield click.argument(name, **{**known, **({"nargs": -1} if several else {}), **given})
                continue
            if of is bool:
                known = {} if any("/" in one for one in names) else {"is_flag": True}
            elif "count" in given:
                known = {}
            if not any(one.startswith("--") for one in names):
                names = (*names, f"--{name.replace('_', '-')}")
            shown = given.get("default") is not None and of is not bool
            settings = {**known, "multiple": several, "show_default": shown or None, **given}
            yield click.option(*names, name, **settings)


def _single(annotation: Any) -> tuple[Any, bool]:
    """Type of one value of an annotation that may be None, and whether it takes several."""
    of = get_args(annotation)[0] if NoneType in get_args(annotation) else annotation
    several = get_origin(of) is tuple and get_args(of)[-1] is ...
    return (get_args(of)[0], True) if several else (of, False)


def below(group: click.Command, names: Iterable[str]) -> click.Command | None:
    """The command that names lead to from a group; ``None`` where there is none."""
    found: click.Command | None = group
    for part in names:
        found = found.get_command(click.Context(found), part) if isinstance(found, click.Group) else None
    return found


def walk(
    command: click.Command, name: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """A command with its names, and where it is a group all that stand below it."""
    yield name, command
    if isinstance(command, click.Group):
        for part in command.list_commands(click.Context(command)):
            found = below(command, (part,))
            if found is not None:
                yield from walk(found, (*name, part))


class OutputFlags(Flags):
    """Amount and form of what is printed."""

    quiet: int = option("Print errors only.", "-q", count=True)
    verbose: int = option("Say more; a bug shows its traceback.", "-v", count=True)
    as_json: bool = option("Print one JSON document to stdout.", "--json")
