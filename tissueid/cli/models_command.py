"""``tissueid models``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tissueid.cli.flags import OutputFlags, argument, subcommand
from tissueid.cli.output import MARGIN, labelled, note, tell
from tissueid.errors import refuse


class _ModelsFlags(OutputFlags):
    names: tuple[str, ...] = argument(metavar="[NAME]...")


@subcommand("models", "", "fractional", "--json")
def command(flags: _ModelsFlags) -> int:
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
    tell(flags, rows, (_each if flags.names else _table)(rows))
    return 0


def _table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """One line a law, under its kind."""
    kind = ""
    for row in rows:
        if row["kind"] != kind:
            kind = row["kind"]
            yield f"{kind}:"
        yield f"  {row['key']:<{MARGIN - 4}}  {row['equation']}"


def _each(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Everything of some laws."""
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
