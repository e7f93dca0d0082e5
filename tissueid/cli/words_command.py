"""Words of the program of itself: ``tissueid explain``, ``models`` and ``doctor``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from tissueid.cli.flags import OutputFlags, argument, option, subcommand
from tissueid.cli.output import EXIT_INCOMPLETE, MARGIN, echo, echo_json, labelled, note, tell
from tissueid.errors import refuse
from tissueid.flags import flag_level

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
def explain(flags: _ExplainFlags) -> int:
    """Say in plain words what a flag, a parameter or an exit code means, and what to do about it.

    NAME is the code of a flag, a parameter by its symbol or its name in identification.json, or an exit
    code. Without one the names are listed.
    """
    from tissueid.explanations import explain as explained
    from tissueid.explanations import explanations

    entries = [explained(name) for name in flags.names] or list(explanations().values())
    width = max(len(entry.name) for entry in entries)
    listed = (f"{one.kind:<9}  {one.name:<{width}}  {one.title or one.meaning}" for one in entries)
    tell(flags, [asdict(one) for one in entries], _entry_lines(entries) if flags.names else listed)
    return 0


def _entry_lines(entries: Sequence[Explanation]) -> Iterator[str]:
    from tissueid.explanations import GRAVITY

    for position, entry in enumerate(entries):
        if position:
            yield ""
        title = f": {entry.title}" if entry.title else ""
        how = f" ({GRAVITY[flag_level(entry.name)]})" if entry.kind == "flag" else ""
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


class _ModelsFlags(OutputFlags):
    names: tuple[str, ...] = argument(metavar="[NAME]...")


@subcommand("models", "", "fractional", "--json")
def models(flags: _ModelsFlags) -> int:
    """List the laws that contact models are made of, for fit --model.

    A model is kelvin-voigt, STATIC * [STIFFNESS *] RELAXATION or STATIC * DAMPING; NAME is the word of one
    law. Laws of other packages are found behind the entry point tissueid.models.
    """
    from tissueid.model.grammar import described, faulty_laws

    rows = described()
    for remark in faulty_laws():
        note(f"warning: {remark}", quiet=flags.quiet)
    if flags.names:
        known = {row["key"]: row for row in rows}
        missing = [name for name in flags.names if name not in known]
        if missing:
            refuse(f"no law {missing[0]!r}; there are {', '.join(known)}")
        rows = [known[name] for name in flags.names]
    tell(flags, rows, (_law_lines if flags.names else _table)(rows))
    return 0


def _table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """One line a law, under its kind."""
    kind = ""
    for row in rows:
        if row["kind"] != kind:
            kind = row["kind"]
            yield f"{kind}:"
        yield f"  {row['key']:<{MARGIN - 4}}  {row['equation']}"


def _law_lines(rows: list[dict[str, Any]]) -> Iterator[str]:
    for position, row in enumerate(rows):
        if position:
            yield ""
        yield f"{row['key']} ({row['kind']}): {row['equation']}"
        names = ", ".join(f"{one['symbol']} [{one['unit']}]" for one in row["parameters"])
        for label, text in (
            ("parameters", names or "none of its own"),
            ("for", row["purpose"]),
            ("refuses", row["refuses"]),
            ("source", f"doi {row['source']}" if row["source"][:3] == "10." else row["source"]),
        ):
            yield from labelled(label, text)


_MARKS = {"ok": "ok", "note": "note", "missing": "MISSING"}


class _DoctorFlags(OutputFlags):
    warm: bool = option("Compile everything now, so that no later run has to.")


@subcommand("doctor", "--warm", "--json")
def doctor(flags: _DoctorFlags) -> int:
    """Say what this machine can do with tissueid, and what stands in its way.

    Versions, numba's cache, real-time rights of the servo, devices, the viewer's page and a browser; each
    with what to type where something is wanting. Nothing moves: devices are looked for, none is opened. Exit
    code 7 where a part of tissueid does not work here.
    """
    from tissueid.doctor import examine, warm

    if flags.warm:
        warm(lambda words: note(words, quiet=flags.quiet))
    checks = []
    for check in examine():
        checks.append(check)
        if flags.as_json or flags.quiet:
            continue
        echo(f"{_MARKS[check.state]:<8}{check.name:<13}{check.words}")
        if check.way_out:
            echo(f"{'':21}{check.way_out}")
    missing = [check.name for check in checks if check.state == "missing"]
    if flags.as_json:
        echo_json({"checks": [asdict(check) for check in checks], "missing": missing})
    return EXIT_INCOMPLETE if missing else 0
