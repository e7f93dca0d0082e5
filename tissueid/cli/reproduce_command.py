"""``tissueid reproduce``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

from tissueid.cli.flags import FOLDER, FROM_0, OutputFlags, argument, option, subcommand
from tissueid.cli.output import checked, made_folder, note, progress_bar, tell
from tissueid.documents.reproduction import Reproduction

FILES = ("reproduction.json", "reproduction.html")


class _ReproduceFlags(OutputFlags):
    paper: Literal["sadeghnejad", "pires", "all"] = argument()
    out: str = option(
        "Folder for reproduction.json and reproduction.html.",
        "-o",
        type=FOLDER,
        default="tissueid-reproduction",
    )
    settings: tuple[str, ...] = option(
        "Read a lost equation otherwise; the page lists names and choices.", "--set", metavar="NAME=CHOICE"
    )
    seed: int | None = option("Seed of everything random. [default: fixed]", type=FROM_0)


@subcommand(
    "reproduce",
    "all",
    "sadeghnejad -o paper-a --json",
    "sadeghnejad --set stiffness=linear --set criterion=weighted-force",
    "pires --set surface=cone",
)
def command(flags: _ReproduceFlags) -> int:
    """Recompute tables and figures of the two papers this project starts from.

    PAPER is sadeghnejad (sinus surgery: model, identification, adaptive controller), pires (hip resurfacing:
    contact law, guidance), or all. Each printed number stands beside a recomputed one with its interval and
    what stands behind it: reproduced, recomputed (no number is printed beside it), given (an input), a round
    trip (the number was among the inputs), assumed, or not reproducible.
    """
    from tissueid.report.reproduction_page import render_reproduction
    from tissueid.reproduce.document import PAPERS, reproduction
    from tissueid.reproduce.published import readings_from
    from tissueid.reproduce.recordings import Effort
    from tissueid.store.files import json_bytes, time_now, write_file

    readings = readings_from(flags.settings)
    out = made_folder(flags.out)
    papers = PAPERS if flags.paper == "all" else (flags.paper,)
    with progress_bar(show=not flags.quiet) as progress:
        effort = Effort(progress=lambda message: progress(message, 0, 0))
        if flags.seed is not None:
            effort = replace(effort, seed=flags.seed)
        found = reproduction(papers, readings, effort)
    written, document = checked(found, Reproduction, where=FILES[0])
    write_file(out / FILES[0], json_bytes(written))
    write_file(out / FILES[1], render_reproduction(document, created=time_now()).encode("utf-8"))
    tell(flags, written, _lines(document))
    note(f"{out / FILES[1]}", quiet=flags.quiet)
    return 0


def _lines(document: Reproduction) -> Iterator[str]:
    for item in document.items:
        agrees = {None: "", True: "agrees", False: "differs"}[item.agrees]
        yield (
            f"{item.item:<32} {_value(item.published):>16} {_value(item.recomputed):>18}  "
            f"{agrees:<8} {item.kind}"
        )
    counts = Counter(item.kind for item in document.items)
    yield "  ".join(f"{kind}: {count}" for kind, count in counts.items())


def _value(value: float | tuple[float, ...] | None) -> str:
    if value is None:
        return "-"
    if isinstance(value, tuple):
        return " to ".join(f"{one:.4g}" for one in value)
    return f"{value:.5g}"
