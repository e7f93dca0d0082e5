"""``docs/options.md``: every command with its options, written from the command line itself."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

import click

from tissueid.cli.main import cli
from tissueid.cli.settings import TYPED_ONLY, option_name

#: Options that every command has; told once.
COMMON = frozenset({"quiet", "verbose", "json"})


def every_command() -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Every command and group below ``tissueid``, and ``tissueid`` itself first, with its names."""
    yield from _below((), cli)


def _below(name: tuple[str, ...], command: click.Command) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    yield name, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for part in command.list_commands(context):
            found = command.get_command(context, part)
            if found is not None:
                yield from _below((*name, part), found)


def examples_of(command: click.Command) -> list[str]:
    """Lines of a command's examples as one would type them."""
    _, _, lines = (command.epilog or "").partition("Examples:")
    return [line.strip() for line in lines.strip().splitlines()]


def options_page() -> str:
    """The page."""
    lines = [
        "# Commands and options",
        "",
        "Written by `scripts/write-docs` from the command line itself. Every command also takes `-q` (errors",
        "only), `-v` (more; a bug shows its traceback), `--json` (one JSON document to stdout) and `--help`.",
        "Options can be set in a file or the environment: [configuration.md](configuration.md). Those marked",
        "† are typed each time.",
        "",
    ]
    for name, command in every_command():
        if not name:
            continue
        lines += [f"## `tissueid {' '.join(name)}`", "", *_help(command), ""]
        rows = [_row(one) for one in command.params if isinstance(one, click.Option)]
        if any(rows):
            lines += ["| option | what it does |", "|---|---|", *filter(None, rows), ""]
        if not isinstance(command, click.Group):
            lines += ["```", *examples_of(command), "```", ""]
    return "\n".join(lines)


def _help(command: click.Command) -> list[str]:
    return inspect.cleandoc(command.help or "").replace("*", "\\*").replace("<", "&lt;").splitlines()


def _row(option: click.Option) -> str | None:
    """A row of the table; ``None`` for an option that all have."""
    key = option_name(option)
    if key in COMMON:
        return None
    record = option.get_help_record(click.Context(click.Command("tissueid")))
    if record is None:
        return None
    names, words = (part.replace("|", "\\|") for part in record)
    mark = " †" if key in TYPED_ONLY else ""
    return f"| `{names}`{mark} | {words} |"
