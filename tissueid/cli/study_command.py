"""``tissueid study``: write, check, correct and publish the study file."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path

import click

from tissueid.cli.flags import (
    FOLDER,
    FOLDER_THERE,
    THERE,
    OutputFlags,
    argument,
    example_lines,
    option,
    subcommand,
)
from tissueid.cli.output import EXIT_INCOMPLETE, echo, echo_json, note, refusing, write_output
from tissueid.cli.reading import ReadingFlags, read_all, read_options
from tissueid.documents import plain
from tissueid.errors import refuse
from tissueid.result import Refusal

#: Missing items printed without -v, after the essential ones.
FEW_MISSING = 8

EXAMPLES = """
tissueid study init lab_data/
tissueid study check lab_data/
tissueid study exclude lab_data/run_7.csv --because "the tool slipped"
tissueid study include lab_data/run_7.csv
tissueid study export lab_data/ --crate crate/ --anonymise
"""


@click.group("study", epilog=example_lines(EXAMPLES))
def command() -> None:
    """Write, check, correct and publish study.toml.

    The study file stands beside the recordings and says what they can't: specimens, protocols, calibration,
    decisions and their reasons. fit reads it. exclude asks for --because; export writes a folder, --crate,
    and takes names out with --anonymise.
    """


class _InitFlags(ReadingFlags, OutputFlags):
    folder: str = argument(type=FOLDER_THERE)
    force: bool = option("Write over a study.toml that is there.")


@subcommand("init", "lab_data/", "lab_data/ --force", group=command)
def init(flags: _InitFlags) -> int:
    """Write a study.toml from the headers and data of a folder, with comments for what is missing."""
    from tissueid.ingest.manifest import MANIFEST
    from tissueid.study.draft import draft_study

    folder = Path(flags.folder)
    target = folder / MANIFEST
    if target.exists() and not flags.force:
        refuse(f"{target} is there already: edit it, or write over it with --force")
    refused: list[Refusal] = []
    trials = list(read_all((flags.folder,), read_options(flags), refused=refused))
    if not trials:
        refuse(f"{folder}: no recording could be read ({refused[0] if refused else 'there is none'})")
    content = draft_study(folder, trials, refused).encode("utf-8")
    write_output(target, content, way_out="check the rights of the folder")
    if flags.as_json:
        echo_json({"path": str(target), "trials": len(trials), "refused": [one.as_json() for one in refused]})
    for one in refused:
        echo(f"refused ({one.code})  {one}", fg="red", err=True)
    many = f"{len(trials)} trial{'s' * (len(trials) > 1)}"
    note(f"wrote {target}: {many}; fill it in, then `tissueid study check`", quiet=flags.quiet)
    return EXIT_INCOMPLETE if refused else 0


class _CheckFlags(OutputFlags):
    study: str = argument(type=THERE)


@subcommand("check", "lab_data/", "lab_data/study.toml --json", group=command)
def check(flags: _CheckFlags) -> int:
    """Grade how complete a study file is, A to F, and say what is missing and why it is asked for.

    Exit code 0 where nothing essential is missing, 7 where something is or a named file is not there, 3
    where the file is not valid.
    """
    from tissueid.ingest.manifest import read_study, unmatched_files
    from tissueid.study.completeness import ESSENTIAL, completeness

    study = read_study(flags.study)
    unmatched = unmatched_files(study)
    found = completeness(study, unmatched)
    essential = sum(one.weight == ESSENTIAL for one in found.missing)
    if flags.as_json:
        echo_json(plain(found))
    elif not flags.quiet:
        echo(f"{study.path}: grade {found.grade}, {100 * found.share:.0f} % of what is asked for is stated")
        shown = found.missing if flags.verbose else found.missing[: essential + FEW_MISSING]
        for one in shown:
            named = ", ".join([*one.where[:3], *["..."] * (len(one.where) > 3)])
            where = f" (of {named})" if named else ""
            mark = "essential" if one.weight == ESSENTIAL else "missing  "
            table = f"[[{one.table}]]" if one.table in {"specimen", "trial"} else f"[{one.table}]"
            echo(f"  {mark}  {table} {' or '.join(one.keys)}{where}: {one.why}")
        if len(shown) < len(found.missing):
            echo(f"  and {len(found.missing) - len(shown)} more (-v prints them)")
    for refusal in unmatched:
        echo(str(refusal), fg="red", err=True)
    return EXIT_INCOMPLETE if unmatched or essential else 0


class _IncludeFlags(OutputFlags):
    trial: str = argument()
    study: str | None = option("Study file. [default: the nearest above TRIAL]", type=THERE)


class _ExcludeFlags(_IncludeFlags):
    because: str = option("Why; shown wherever the trial is missed.", required=True)


@subcommand(
    "exclude",
    'lab_data/run_7.csv --because "the tool slipped"',
    '"meat.xlsx::Sheet 3" --because "thawed" --study lab_data/',
    group=command,
)
def exclude(flags: _ExcludeFlags) -> int:
    """Take a recording out of the fit, with the reason; the report shows the numbers with and without it.

    TRIAL is a file, or file::sheet for one sheet of a workbook.
    """
    from tissueid.study.exclusions import exclude, find_manifest

    manifest = find_manifest(flags.trial, flags.study)
    with refusing(manifest, "changed", "check the rights of its folder"):
        named, replaced = exclude(flags.trial, flags.because, manifest=manifest)
    if replaced not in {None, flags.because} and not flags.quiet:
        echo(f"note: {named} was excluded already, because: {replaced}", fg="yellow", err=True)
    return _changed(manifest, named, flags, f"{named} is excluded in {manifest}: {flags.because}")


@subcommand("include", "lab_data/run_7.csv", group=command)
def include(flags: _IncludeFlags) -> int:
    """Take a recording back into the fit."""
    from tissueid.study.exclusions import find_manifest, include

    manifest = find_manifest(flags.trial, flags.study)
    with refusing(manifest, "changed", "check the rights of its folder"):
        named = include(flags.trial, manifest=manifest)
    return _changed(manifest, named, flags, f"{named} is fitted again, says {manifest}")


def _changed(manifest: Path, named: str, flags: OutputFlags, message: str) -> int:
    if flags.as_json:
        echo_json({"study": str(manifest), "trial": named})
    note(message, quiet=flags.quiet)
    return 0


class _ExportFlags(ReadingFlags, OutputFlags):
    study: str = argument(type=THERE)
    crate: str = option(
        "Write an RO-Crate 1.1 into this empty folder: recordings, study file, metadata with hashes.",
        required=True,
        type=FOLDER,
        metavar="OUT",
    )
    anonymise: bool = option(
        "Without names of people, places and animals, dates and ethics number; recordings without headers."
    )
    date: str | None = option("Day of publication, YYYY-MM-DD. [default: today]")


@subcommand("export", "lab_data/ --crate crate/", "lab_data/ --crate crate/ --anonymise", group=command)
def export(flags: _ExportFlags) -> int:
    """Publish a study: recordings, study file and metadata in one folder."""
    from tissueid.collection import display_names
    from tissueid.study.crate import Anonymiser, crate_files, crate_metadata, read_salt, write_crate
    from tissueid.study.recordings import locate_study

    study, paths = locate_study((flags.study,))
    if study is None:
        refuse(f"{flags.study}: there is no study.toml; `tissueid study init` writes one")
    try:
        day = date.fromisoformat(flags.date) if flags.date else datetime.now(UTC).date()
    except ValueError:
        refuse(f"--date is {flags.date!r}: write a day as 2024-05-31")
    refused: list[Refusal] = []
    trials = list(read_all(paths, read_options(flags), study, refused))
    names = display_names([(trial.specimen, trial.source) for trial in trials])
    trials = [replace(trial, specimen=names[trial.specimen]) for trial in trials]
    anonymiser = None
    if flags.anonymise:
        folder = Path(study.path).parent
        anonymiser = Anonymiser(study, {trial.specimen for trial in trials}, read_salt(folder))
    files = crate_files(study, trials, anonymiser)
    metadata = crate_metadata(study, files, published=day.isoformat(), anonymiser=anonymiser)
    write_crate(Path(flags.crate), files, metadata)
    if flags.as_json:
        echo_json(metadata)
    for one in refused:
        echo(f"left out ({one.code})  {one}", fg="red", err=True)
    note(f"wrote {len(files)} files and their metadata to {flags.crate}", quiet=flags.quiet)
    if anonymiser is not None:
        note(
            "read the reasons and the machine's name once more: free text can name people", quiet=flags.quiet
        )
    return EXIT_INCOMPLETE if refused else 0
