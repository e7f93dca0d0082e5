"""``tissueid rupture``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.flags import FOLDER, PATH, REAL_FROM_0, OutputFlags, argument, option, subcommand
from tissueid.cli.output import EXIT_INCOMPLETE, echo, note, progress_bar, tell
from tissueid.cli.reading import StudyFlags, read_all, read_options, refuse_same_folder, segment_options
from tissueid.documents import typed
from tissueid.documents.rupture import Rupture, Speed
from tissueid.rupture_law import CRITERIA

if TYPE_CHECKING:
    from tissueid.result import Refusal
    from tissueid.rupture.run import RuptureRun

#: What may be asked for; a test holds it against the code.
ASKED = ("none", "auto", *CRITERIA)
S_PER_MIN = 60.0


class _RuptureFlags(StudyFlags, OutputFlags):
    paths: tuple[str, ...] = argument(required=True, type=PATH)
    out: str = option("Folder to write to.", "-o", required=True, type=FOLDER)
    criterion: str = option(
        "What the bundles rupture by; auto takes what the evidence decides for, or none.",
        type=click.Choice(ASKED),
        default="none",
    )
    weight: float = option("w of the weighted force F_s + w F_d.", type=REAL_FROM_0, default=1.5)
    model: str | None = option("Law of the tissue, as of tissueid fit.", metavar="NAME")


@subcommand(
    "rupture",
    "study.toml -o rupture",
    "lab_data/ -o rupture --criterion auto",
    'lab_data/ -o rupture --criterion work --specimen-by "(sheep-[0-9]+)"',
    'lab_data/ -o rupture --model "power * tangent * prony"',
)
def command(flags: _RuptureFlags) -> int:
    """Study tests to rupture: force, depth and work at failure, against speed, and what broke the tissue.

    PATHS are recordings, folders of them, or a study.toml; tests that did not rupture belong to it. Compares
    work, weighted force, stored energy and depth by evidence; "undecided" and "none of them" are answers.
    Writes rupture.json, rupture.html and a bundle a specimen; tissueid render breaks a tissue whose bundle
    holds a criterion. Exit code 4 where too few tests ruptured, 7 where something was left out.
    """
    from tissueid.rupture.run import write_rupture

    refuse_same_folder(flags.paths, flags.out)
    with progress_bar(show=not flags.quiet) as progress:
        written = write_rupture(Path(flags.out), lambda: _run(flags, progress))
    document = typed(written, Rupture)
    tell(flags, written, _lines(document))
    for row in document.left_out:
        echo(f"left out  {row.path}: {row.reason}", fg="red", err=True)
    note(f"wrote rupture.json, rupture.html and the bundles to {flags.out}", quiet=flags.quiet)
    return EXIT_INCOMPLETE if document.left_out else 0


def _run(flags: _RuptureFlags, progress: Any) -> RuptureRun:
    from tissueid.inference.specimen import FitOptions
    from tissueid.pipeline import IdentifyOptions
    from tissueid.rupture.run import run_rupture
    from tissueid.study.recordings import locate_study, read_decided_one

    reading = read_options(flags)
    study, paths = locate_study(flags.paths, named=flags.study, ignore=flags.no_study)
    refused: list[Refusal] = []
    return run_rupture(
        read_all(paths, reading, study, refused),
        study=study,
        options=IdentifyOptions(fit=FitOptions(model=flags.model), segment=segment_options(flags)),
        reload=lambda source: read_decided_one(source.path, source.sheet, reading, study),
        refused=refused,
        asked=flags.criterion,
        weight=flags.weight,
        progress=progress,
    )


def _lines(document: Rupture) -> list[str]:
    def mean(row: Speed, name: str) -> str:
        value, sd = getattr(row.mean, name), getattr(row.sd, name)
        if value is None:
            return "-"
        return f"{value:.4g}" if sd is None else f"{value:.4g} ± {sd:.2g}"

    lines = [f"{'mm/min':>8}{'ruptured':>10}{'force [N]':>18}{'depth [mm]':>16}{'work [N mm]':>18}"]
    lines += [
        f"{S_PER_MIN * row.speed_mm_s:>8.4g}{row.ruptured:>6}/{row.ruptured + row.censored:<3}"
        f"{mean(row, 'force_N'):>18}{mean(row, 'depth_mm'):>16}{mean(row, 'work_N_mm'):>18}"
        for row in document.speeds
    ]
    lines += [
        f"{row.criterion:<15} {row.median:.4g} {row.unit} ({row.ci95[0]:.4g} to "
        f"{row.ci95[1]:.4g}), ln evidence {row.ln_evidence:.1f}"
        for row in document.criteria
    ]
    decision = document.decision
    kind = f": {decision.kind}" if decision.kind else ""
    lines.append(f"{decision.answer}{kind} ({decision.reason}); in the bundles: {document.taken}")
    return [*lines, *document.sentences]
