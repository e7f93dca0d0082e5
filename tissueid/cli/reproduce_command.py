"""``tissueid reproduce``."""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from tissueid.cli.output import echo, echo_json, note, output_options, progress_bar
from tissueid.errors import UsageError

EPILOG = """\b
Examples:
  tissueid reproduce all
  tissueid reproduce sadeghnejad -o paper-a --json
  tissueid reproduce sadeghnejad --set stiffness=linear --set criterion=weighted-force
  tissueid reproduce pires --set surface=cone
"""
FILES = ("reproduction.json", "reproduction.html")


@click.command("reproduce", epilog=EPILOG)
@click.argument("paper", type=click.Choice(["sadeghnejad", "pires", "all"]))
@click.option(
    "-o", "--out", type=click.Path(file_okay=False), default="tissueid-reproduction", show_default=True,
    help="Folder for reproduction.json and reproduction.html.",
)  # fmt: skip
@click.option(
    "--set", "settings", multiple=True, metavar="NAME=CHOICE",
    help="Read a lost equation otherwise; the page lists names and choices.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), help="Seed of everything random. [default: fixed]")
@output_options
def command(**flags: Any) -> int:
    """Recompute tables and figures of the two papers this project starts from.

    PAPER is sadeghnejad (sinus surgery: model, identification, adaptive controller), pires (hip resurfacing:
    contact law, guidance), or all. Each printed number stands beside a recomputed one with its interval and
    what stands behind it: reproduced, recomputed (no number is printed beside it), given (an input), a round
    trip (the number was among the inputs), assumed, or not reproducible.
    """
    from dataclasses import replace

    from tissueid.report.reproduction_page import render_reproduction
    from tissueid.reproduce.document import PAPERS, reproduction
    from tissueid.reproduce.readings import readings_from
    from tissueid.reproduce.recordings import Effort
    from tissueid.store.files import json_bytes, plain_json, write_file
    from tissueid.store.schema import check as check_schema

    quiet: int = flags["quiet"]
    readings = readings_from(flags["settings"])
    out = _folder(flags["out"])
    papers = PAPERS if flags["paper"] == "all" else (flags["paper"],)
    with progress_bar(show=not quiet) as progress:
        effort = Effort(progress=lambda message: progress(message, 0, 0))
        if flags["seed"] is not None:
            effort = replace(effort, seed=flags["seed"])
        document: dict[str, Any] = plain_json(reproduction(papers, readings, effort))
    check_schema(document, "reproduction", where=FILES[0])
    created = datetime.now(UTC).isoformat(timespec="seconds")
    write_file(out / FILES[0], json_bytes(document))
    write_file(out / FILES[1], render_reproduction(document, created=created).encode("utf-8"))
    if flags["as_json"]:
        echo_json(document)
    elif not quiet:
        _print(document)
    note(f"{out / FILES[1]}", quiet=quiet)
    return 0


def _folder(name: str) -> Path:
    out = Path(name)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f"{name}: can't be made ({error.strerror}); choose another folder with -o"
        raise UsageError(msg) from error
    return out


def _print(document: dict[str, Any]) -> None:
    for item in document["items"]:
        agrees = {None: "", True: "agrees", False: "differs"}[item["agrees"]]
        echo(
            f"{item['item']:<32} {_value(item['published']):>16} {_value(item['recomputed']):>18}  "
            f"{agrees:<8} {item['kind']}",
        )
    counts = Counter(item["kind"] for item in document["items"])
    echo("  ".join(f"{kind}: {count}" for kind, count in counts.items()))


def _value(value: float | list[float] | None) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        return " to ".join(f"{one:.4g}" for one in value)
    return f"{value:.5g}"
