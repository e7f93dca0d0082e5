"""``tissueid explain``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import click
from click.shell_completion import CompletionItem

from tissueid.cli.flags import OutputFlags, argument, subcommand
from tissueid.cli.output import labelled, tell

if TYPE_CHECKING:
    from tissueid.explanations import Explanation


def _complete(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    from tissueid.explanations import explanations

    return [
        CompletionItem(name, help=one.title or one.meaning)
        for name, one in explanations().items()
        if name.startswith(typed)
    ]


class _ExplainFlags(OutputFlags):
    names: tuple[str, ...] = argument(metavar="[NAME]...", shell_complete=_complete)


@subcommand("explain", "not_identified", "tau", "7", "viscosity_N_s_per_mm --json", "")
def command(flags: _ExplainFlags) -> int:
    """Say in plain words what a flag, a parameter or an exit code means, and what to do about it.

    NAME is the code of a flag, a parameter by its symbol or its name in identification.json, or an exit
    code. Without one the names are listed.
    """
    from tissueid.explanations import explain, explanations

    entries = [explain(name) for name in flags.names] or list(explanations().values())
    width = max(len(entry.name) for entry in entries)
    listed = (f"{one.kind:<9}  {one.name:<{width}}  {one.title or one.meaning}" for one in entries)
    tell(flags, [asdict(one) for one in entries], _each(entries) if flags.names else listed)
    return 0


def _each(entries: Sequence[Explanation]) -> Iterator[str]:
    from tissueid.explanations import gravity

    for position, entry in enumerate(entries):
        if position:
            yield ""
        title = f": {entry.title}" if entry.title else ""
        how = f" ({gravity(entry.name)})" if entry.kind == "flag" else ""
        yield f"{entry.kind} {entry.symbol or entry.name}{title}{how}"
        yield f"  {entry.meaning}"
        for label, text in (
            ("unit", f"{entry.unit}; {entry.name} in identification.json" if entry.unit else ""),
            ("depends", entry.depends),
            ("interval", entry.interval),
            ("what follows", entry.follows),
            ("what to do", entry.remedy),
        ):
            yield from labelled(label, text)
