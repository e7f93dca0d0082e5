"""``tissueid completion``: what shells need, and the names that they are offered."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from importlib import import_module, resources
from pathlib import Path

import click
from click.shell_completion import CompletionItem, get_completion_class

from tissueid.cli.flags import OutputFlags, argument, below, option, subcommand
from tissueid.cli.output import echo_bytes, echo_json, made_folder, note, write_output
from tissueid.errors import refuse

#: The variable by which a shell asks; click derives the same from the name of the program.
VARIABLE = "_TISSUEID_COMPLETE"
#: Shell -> what has to be so for an installed file to be found.
FOUND_BY = {
    "bash": "the package bash-completion loads it by itself in new shells",
    "zsh": "~/.zshrc needs, above compinit: fpath=({folder} $fpath); then: autoload -Uz compinit; compinit",
    "fish": "new shells load it by themselves",
}


class _CompletionFlags(OutputFlags):
    shell: str = argument(type=click.Choice(list(FOUND_BY)))
    install: bool = option("Write it where the shell looks; no file of yours is edited.")


@subcommand("completion", "bash --install", "zsh > _tissueid", "fish --install")
def command(flags: _CompletionFlags) -> int:
    """Print the script that completes tissueid in a shell, or install it.

    Completes commands, options, choices, files, readers, recipes and the words that tissueid explain knows.
    """
    from tissueid.cli.main import cli

    kind = get_completion_class(flags.shell)
    if kind is None:
        refuse(f"click {click.__version__} knows no completion for {flags.shell}")
    maker = kind(cli, {}, "tissueid", VARIABLE)
    script = maker.source_template % maker.source_vars() + "\n"
    if not flags.install:
        if flags.as_json:
            echo_json({"shell": flags.shell, "script": script})
        else:
            echo_bytes(script.encode(), safe=True)
        return 0
    target = _target(flags.shell)
    made_folder(target.parent, "print the script and place it yourself")
    write_output(str(target), script.encode("utf-8"))
    if flags.as_json:
        echo_json({"shell": flags.shell, "path": str(target)})
    note(f"wrote {target}: {FOUND_BY[flags.shell].format(folder=target.parent)}", quiet=flags.quiet)
    return 0


def _target(shell: str) -> Path:
    """Folder in which a shell looks for completions of its user."""
    try:
        home = Path.home()
    except RuntimeError:
        refuse("there is no home folder to install into: print the script and place it yourself")
    if shell == "bash":
        data = Path(os.environ.get("XDG_DATA_HOME") or home / ".local" / "share")
        return data / "bash-completion" / "completions" / "tissueid"
    if shell == "zsh":
        return Path(os.environ.get("ZDOTDIR") or home) / ".zfunc" / "_tissueid"
    config = Path(os.environ.get("XDG_CONFIG_HOME") or home / ".config")
    return config / "fish" / "completions" / "tissueid.fish"


_Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def named(names: Callable[[], Iterable[str]], *, or_file: bool = False) -> _Completer:
    """Offer names, and files where one may stand instead."""

    def complete(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
        found = [CompletionItem(name) for name in names() if name.startswith(typed)]
        return found or ([CompletionItem(typed, type="file")] if or_file else [])

    return complete


def _scenes() -> Iterable[str]:
    folder = resources.files("tissueid.rendering") / "scenes"
    return sorted(one.name.removesuffix(".toml") for one in folder.iterdir() if one.name.endswith(".toml"))


def subcommands(context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Names of commands below those that stand in ``name`` already."""
    from tissueid.cli.main import cli

    found = below(cli, context.params.get("name") or ())
    if not isinstance(found, click.Group):
        return []
    return named(lambda: found.list_commands(click.Context(found)))(context, _parameter, typed)


def _of(module: str, table: str) -> Callable[[], Iterable[str]]:
    return lambda: getattr(import_module(module), table)


readers = named(_of("tissueid.ingest", "RECIPES"))
recipes = named(_of("tissueid.synth", "RECIPES"), or_file=True)
dialects = named(_of("tissueid.synth", "EXPORTS"))
presets = named(_of("tissueid.rendering.options", "PRESETS"))
scenes = named(_scenes, or_file=True)
