"""Completions a shell offers for values that are neither files nor choices: names that tissueid knows."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import click
from click.shell_completion import CompletionItem

_Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def named(names: Callable[[], Iterable[str]], *, or_file: bool = False) -> _Completer:
    """Offer names, and files where one may stand instead.

    ``names``: called when a shell asks; it may import; ``or_file``: the shell completes files where no name
    fits.
    """

    def complete(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
        found = [CompletionItem(name) for name in names() if name.startswith(typed)]
        return found or ([CompletionItem(typed, type="file")] if or_file else [])

    return complete


def _readers() -> Iterable[str]:
    from tissueid.ingest import RECIPES

    return RECIPES


def _recipes() -> Iterable[str]:
    from tissueid.synth import RECIPES

    return RECIPES


def _dialects() -> Iterable[str]:
    from tissueid.synth import EXPORTS

    return EXPORTS


def _presets() -> Iterable[str]:
    from tissueid.rendering.options import PRESETS

    return PRESETS


def _scenes() -> Iterable[str]:
    from importlib import resources

    folder = resources.files("tissueid.rendering") / "scenes"
    return sorted(one.name.removesuffix(".toml") for one in folder.iterdir() if one.name.endswith(".toml"))


def subcommands(context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Names of commands below those that stand in ``name`` already."""
    from tissueid.cli.main import cli

    found: click.Command | None = cli
    for part in context.params.get("name") or ():
        found = found.get_command(click.Context(found), part) if isinstance(found, click.Group) else None
    if not isinstance(found, click.Group):
        return []
    names = found.list_commands(click.Context(found))
    return [CompletionItem(name) for name in names if name.startswith(typed)]


readers = named(_readers)
recipes = named(_recipes, or_file=True)
dialects = named(_dialects)
presets = named(_presets)
scenes = named(_scenes, or_file=True)
