"""``tissueid config``, and options from configuration files and the environment, none skipped in silence."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.completion_command import subcommands
from tissueid.cli.flags import OutputFlags, argument, below, subcommand, walk
from tissueid.cli.output import tell
from tissueid.errors import refuse

if TYPE_CHECKING:
    from tissueid.manifest import TomlTable


class _ConfigFlags(OutputFlags):
    name: tuple[str, ...] = argument(metavar="[COMMAND]...", shell_complete=subcommands)


@subcommand("config", "", "fit", "study init --json")
def command(flags: _ConfigFlags) -> int:
    """Say which settings are in force, and where each comes from.

    Without a COMMAND: what files and environment set, of all commands. With one: every option of it. What is
    typed counts first, then TISSUEID_COMMAND_OPTION, then ./tissueid.toml (or [tool.tissueid] of
    ./pyproject.toml), then ~/.config/tissueid/config.toml. Both files are checked whole.
    """
    from tissueid.cli.main import COMMANDS

    files = settings_files()
    settings = {key: one for name in COMMANDS for key, one in settings_of(name, files).items()}
    rows = [
        {"command": " ".join(path), "option": key, "value": setting.value, "source": setting.source}
        for (*path, key), setting in settings.items()
    ]
    if flags.name:
        rows = _of_command(flags.name, rows)
    user = user_file()
    read = [str(file.path) for file in files]
    lines = [f"files read: {', '.join(read) or 'none'}"]
    if user is not None and str(user) not in read:
        lines.append(f"your own would be {user}")
    width = max((len(f"{row['command']} --{row['option']}") for row in rows), default=0)
    for row in rows:
        value, name = "-" if row["value"] is None else row["value"], f"{row['command']} --{row['option']}"
        lines.append(f"{name:<{width}}  {value!s:<14}  {row['source'] or 'default'}")
    if not rows:
        lines.append("nothing is set: every option has its default")
    tell(flags, {"files": read, "settings": rows}, lines)
    return 0


def _of_command(name: tuple[str, ...], rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Every option of one command with its value: set, or the default."""
    from tissueid.cli.main import cli

    found = below(cli, name)
    if found is None:
        refuse(f"{' '.join(name)}: there is no such command; `tissueid --help` lists them")
    if isinstance(found, click.Group):
        return [row for row in rows if row["command"].split()[: len(name)] == list(name)]
    told = {row["option"]: row for row in rows if row["command"] == " ".join(name)}
    every = {}
    for key, option in settable(found).items():
        default = option.to_info_dict()["default"]
        value = default if isinstance(default, str | int | float) else None
        every[key] = {"command": " ".join(name), "option": key, "value": value, "source": None}
    return list((every | told).values())


#: Options that stand for a consent, a secret or a check that is left out: they are typed each time.
TYPED_ONLY = frozenset({"because", "force", "help", "no-control", "pseudonym", "token", "version", "yes"})
#: Keys that may stand above all tables: they are options of every command.
GENERAL = ("quiet", "verbose")
PREFIX = "TISSUEID_"
#: Names another user file; empty for none.
USER_FILE = "TISSUEID_CONFIG"
PROJECT_FILE = "tissueid.toml"
PYPROJECT = "pyproject.toml"


@dataclass(frozen=True, slots=True)
class Setting:
    """A value that was not typed."""

    parameter: str  # name by which click knows the option
    value: Any  # as click takes it
    source: str  # file with line, or name of the environment variable


@dataclass(frozen=True, slots=True)
class SettingsFile:
    """A configuration file."""

    path: Path
    table: TomlTable  # its settings
    inside: tuple[str, ...]  # where they stand in the file: empty, or ``("tool", "tissueid")``
    text: str

    def at(self, *key: str) -> str:
        """File and line of a key."""
        from tissueid.ingest.manifest import line_of, lines_of_toml

        line = line_of(lines_of_toml(self.text), (*self.inside, *key))
        return str(self.path) if line is None else f"{self.path}, line {line}"


def user_file() -> Path | None:
    """Place of the user's own file; ``None`` where the environment says there is none."""
    named = os.environ.get(USER_FILE)
    if named is not None:
        return Path(named) if named else None
    home = os.environ.get("XDG_CONFIG_HOME")
    if not home:
        try:
            home = str(Path.home() / ".config")
        except RuntimeError:
            # a user without a home, as in a container
            return None
    return Path(home) / "tissueid" / "config.toml"


def settings_files() -> list[SettingsFile]:
    """The files that are there, the one that counts less first."""
    found = []
    user = user_file()
    if user is not None and (user.exists() or USER_FILE in os.environ):
        found.append(_parsed(user, ()))
    project = [_parsed(Path(PROJECT_FILE), ())] if Path(PROJECT_FILE).is_file() else []
    shared = Path(PYPROJECT)
    # most are no concern of ours: one that can't be parsed is refused only where it speaks of tissueid
    if shared.is_file() and "tool.tissueid" in shared.read_text(encoding="utf-8", errors="replace"):
        project.append(_parsed(shared, ("tool", "tissueid")))
    project = [one for one in project if one.table or not one.inside]
    if len(project) > 1:
        refuse(f"this folder has settings in {PROJECT_FILE} and in {PYPROJECT}: keep them in one of the two")
    return found + project


def _parsed(path: Path, inside: tuple[str, ...]) -> SettingsFile:
    try:
        text = path.read_text(encoding="utf-8")
        table: Any = tomllib.loads(text)
    except OSError as error:
        refuse(f"{path}: can't be read ({error.strerror})")
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        refuse(f"{path}: is no valid TOML ({error}); correct it, or move it away")
    for part in inside:
        table = table.get(part, {})
    if not isinstance(table, Mapping):
        refuse(f"{path}: [{'.'.join(inside)}] must be a table")
    return SettingsFile(path, table, inside, text)


def option_name(parameter: click.Parameter) -> str:
    """The long name of an option, without dashes: the key of a file."""
    return max(parameter.opts, key=len).lstrip("-")


def settable(command: click.Command) -> dict[str, click.Option]:
    """Options of a command that may be set, by key."""
    options = (one for one in command.params if isinstance(one, click.Option))
    return {option_name(one): one for one in options if option_name(one) not in TYPED_ONLY}


def settings_of(name: str, files: list[SettingsFile] | None = None) -> dict[tuple[str, ...], Setting]:
    """Settings of a command and those below it, by path and key; the later of the files counts more."""
    from tissueid.cli.main import COMMANDS, cli

    found: dict[tuple[str, ...], Setting] = {}
    command = cli.get_command(click.Context(cli), name)
    if command is None:
        return found
    leaves = [one for one in walk(command, (name,)) if not isinstance(one[1], click.Group)]
    for file in settings_files() if files is None else files:
        for key, value in file.table.items():
            if key not in {*COMMANDS, *GENERAL}:
                refuse(_unknown(file, (key,), [*COMMANDS, *GENERAL], "is no command and no general key"))
            if key in COMMANDS and not isinstance(value, Mapping):
                refuse(f"{file.at(key)}: {key} is a command; its settings stand in a table [{key}]")
        for path, leaf in leaves:
            for key in (key for key in GENERAL if key in file.table and key in settable(leaf)):
                found[*path, key] = _from_file(file, (key,), settable(leaf)[key], file.table[key])
        found |= _from_table(file, command, (name,), file.table.get(name, {}))
    for path, leaf in leaves:
        found |= _from_environment(path, leaf)
    return found


def as_default_map(settings: Mapping[tuple[str, ...], Setting]) -> dict[str, Any]:
    """Defaults as click takes them: values by the names of its parameters, nested as commands are."""
    tree: dict[str, Any] = {}
    for (*path, _), setting in settings.items():
        place = tree
        for part in path:
            place = place.setdefault(part, {})
        place[setting.parameter] = setting.value
    return tree


def _unknown(file: SettingsFile, key: tuple[str, ...], names: list[str], words: str) -> str:
    typed = key[-1]
    if typed in TYPED_ONLY:
        return f"{file.at(*key)}: {typed} must be typed each time and can't be set in a file"
    near = get_close_matches(typed.replace("_", "-"), names, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"known here: {', '.join(sorted(names))}"
    return f"{file.at(*key)}: {typed!r} {words}; {hint}"


def _from_table(
    file: SettingsFile, command: click.Command, name: tuple[str, ...], table: TomlTable
) -> dict[tuple[str, ...], Setting]:
    found: dict[tuple[str, ...], Setting] = {}
    if isinstance(command, click.Group):
        names = command.list_commands(click.Context(command))
        for key, own in table.items():
            part = below(command, (key,)) if key in names else None
            if part is None:
                refuse(_unknown(file, (*name, key), names, f"is no part of {' '.join(name)}"))
            if not isinstance(own, Mapping):
                refuse(f"{file.at(*name, key)}: {key} is a command; its settings stand in a table")
            found |= _from_table(file, part, (*name, key), own)
        return found
    options = settable(command)
    for key, value in table.items():
        if key not in options:
            refuse(_unknown(file, (*name, key), list(options), f"is no option of tissueid {' '.join(name)}"))
        found[*name, key] = _from_file(file, (*name, key), options[key], value)
    return found


def _from_file(file: SettingsFile, key: tuple[str, ...], option: click.Option, value: Any) -> Setting:
    try:
        return Setting(str(option.name), _fitting(option, value), file.at(*key))
    except click.BadParameter as error:
        refuse(f"{file.at(*key)}: {key[-1]} = {value!r}: {error.message}")


def _require(words: str, *, fits: bool) -> None:
    if not fits:
        raise click.BadParameter(words)


def _fitting(option: click.Option, value: Any) -> Any:
    """A value of a file as the option takes it; BadParameter with the reason where it does not fit."""
    if option.count:
        _require("must be true, false or a number from 0", fits=isinstance(value, int) and value >= 0)
        return int(value)
    if option.is_flag:
        _require("must be true or false, without quotes", fits=isinstance(value, bool))
        return value
    if option.multiple:
        _require('must be a list, as ["a", "b"]', fits=isinstance(value, list))
        return [_one(option, each) for each in value]
    return _one(option, value)


def _one(option: click.Option, value: Any) -> Any:
    kind = option.type
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(kind, click.types.IntParamType):
        _require("must be a whole number, without quotes", fits=number and isinstance(value, int))
    elif isinstance(kind, click.types.FloatParamType):
        _require("must be a number, without quotes", fits=number)
    else:
        chosen = number and isinstance(kind, click.Choice)
        _require("must be text in quotes", fits=isinstance(value, str) or chosen)
        value = str(value)
    option.type.convert(value, option, None)
    return value


def _from_environment(path: tuple[str, ...], command: click.Command) -> dict[tuple[str, ...], Setting]:
    """Settings of one command from the environment; names that begin as its do and are none are refused."""
    start = PREFIX + "_".join(path).replace("-", "_").upper() + "_"
    options = settable(command)
    names = {start + key.replace("-", "_").upper(): key for key in options}
    found = {}
    for variable, text in os.environ.items():
        # a variable of ``calibrate-frame`` is none of ``calibrate``
        longer = path == ("calibrate",) and variable.startswith(f"{PREFIX}CALIBRATE_FRAME_")
        if not variable.startswith(start) or longer:
            continue
        if variable not in names:
            near = get_close_matches(variable, names, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            refuse(f"environment variable {variable}: tissueid {' '.join(path)} takes no such setting{hint}")
        option = options[names[variable]]
        try:
            found[*path, names[variable]] = Setting(str(option.name), _from_text(option, text), variable)
        except click.BadParameter as error:
            refuse(f"environment variable {variable} = {text!r}: {error.message}")
    return found


def _from_text(option: click.Option, text: str) -> Any:
    """A value of the environment; several are parted by commas."""
    if option.count and text.isdecimal():
        return int(text)
    if option.count or option.is_flag:
        try:
            told = bool(click.BOOL.convert(text, option, None))
        except click.BadParameter as error:
            raise click.BadParameter("must be 1 or 0") from error
        return int(told) if option.count else told
    values = text.split(",") if option.multiple else [text]
    for value in values:
        option.type.convert(value, option, None)
    return values if option.multiple else text
