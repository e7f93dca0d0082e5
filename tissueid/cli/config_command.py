"""``tissueid config``."""

from __future__ import annotations

from typing import Any

import click

from tissueid.cli.completing import subcommands
from tissueid.cli.flags import OutputFlags, argument, subcommand
from tissueid.cli.output import echo, echo_json
from tissueid.errors import UsageError

EXAMPLES = """
tissueid config
tissueid config fit
tissueid config study init --json
"""


class _ConfigFlags(OutputFlags):
    name: tuple[str, ...] = argument(metavar="[COMMAND]...", shell_complete=subcommands)


@subcommand("config", EXAMPLES)
def command(flags: _ConfigFlags) -> int:
    """Say which settings are in force, and where each comes from.

    Without a COMMAND: what files and environment set, of all commands. With one: every option of it. What is
    typed counts first, then TISSUEID_COMMAND_OPTION, then ./tissueid.toml (or [tool.tissueid] of
    ./pyproject.toml), then ~/.config/tissueid/config.toml. Both files are checked whole.
    """
    from tissueid.cli.main import cli
    from tissueid.cli.settings import Setting, settings_files, settings_of, user_file

    files = settings_files()
    settings: dict[tuple[str, ...], Setting] = {}
    for name in cli.list_commands(click.Context(cli)):
        below = cli.get_command(click.Context(cli), name)
        if below is not None:
            settings |= settings_of(below, (name,), files, cli)
    rows = [
        {"command": " ".join(path), "option": key, "value": setting.value, "source": setting.source}
        for (*path, key), setting in settings.items()
    ]
    if flags.name:
        rows = _of_command(flags.name, rows)
    user = user_file()
    read = [str(file.path) for file in files]
    if flags.as_json:
        echo_json({"files": read, "settings": rows})
    elif not flags.quiet:
        echo(f"files read: {', '.join(read) or 'none'}")
        if user is not None and str(user) not in read:
            echo(f"your own would be {user}")
        _print(rows)
    return 0


def _of_command(name: tuple[str, ...], rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Every option of one command with its value: set, or the default."""
    from tissueid.cli.main import cli
    from tissueid.cli.settings import settable

    found: click.Command | None = cli
    for part in name:
        found = found.get_command(click.Context(found), part) if isinstance(found, click.Group) else None
        if found is None:
            msg = f"{' '.join(name)}: there is no such command; `tissueid --help` lists them"
            raise UsageError(msg)
    if isinstance(found, click.Group):
        return [row for row in rows if row["command"].split()[: len(name)] == list(name)]
    told = {row["option"]: row for row in rows if row["command"] == " ".join(name)}
    return [
        told.get(key) or {"command": " ".join(name), "option": key, "value": _default(option), "source": None}
        for key, option in settable(found or cli).items()
    ]


def _default(option: click.Option) -> Any:
    """The value of an option that nothing sets; ``None`` where it has none."""
    value = option.to_info_dict()["default"]
    return value if isinstance(value, str | int | float | bool) else None


def _print(rows: list[dict[str, Any]]) -> None:
    if not rows:
        echo("nothing is set: every option has its default")
        return
    named = [f"{row['command']} --{row['option']}" for row in rows]
    for name, row in zip(named, rows, strict=True):
        value = "-" if row["value"] is None else str(row["value"])
        echo(f"{name:<{max(map(len, named))}}  {value:<14}  {row['source'] or 'default'}")
