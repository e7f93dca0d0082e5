"""Closing lines of ``fit``, from the documents it wrote: results of an earlier run print the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tissueid.cli.output import echo, note
from tissueid.digits import with_error
from tissueid.documents import typed
from tissueid.documents.identification import Exclusion, Specimen
from tissueid.report.specimen_lines import shared_codes, shared_lines, specimen_lines
from tissueid.store.results import load_identification

if TYPE_CHECKING:
    from tissueid.study.assembly import Assembled

#: Specimens from which on each gets one line of what was measured.
MANY = 4
_COLOURS = {"alarm": "red", "serious": "red", "remark": "yellow"}


def print_summary(found: Assembled, out: str, *, quiet: int, verbose: int) -> None:
    """Numbers to stdout, what was left out and what is missing to stderr.

    ``out``: output folder as the user named it.
    """
    if 0 < found.beside < found.trials:
        note(
            f"{found.beside} of {found.trials} trials are not named by the study and were fitted as well "
            "(only_listed = true leaves them out)",
            quiet=quiet,
        )
    if not quiet:
        _print(found, out, verbose=verbose)
    print_reasons(found, quiet=quiet)


def _print(found: Assembled, out: str, *, verbose: int) -> None:
    if found.large:
        echo(f"{found.fitted} of {found.jobs} specimens fitted")
    elif found.fitted:
        _print_specimens(load_identification(found.document).specimens, verbose=verbose)
    for row in found.exclusions:
        _print_exclusion(typed(row, Exclusion))
    if found.fitted:
        echo()
        echo(f"Report: {out}/report.html")


def _print_specimens(specimens: Sequence[Specimen], *, verbose: int) -> None:
    shared = () if verbose else shared_codes(specimens)
    brief = len(specimens) >= MANY and not verbose
    for specimen in specimens:
        _print_specimen(specimen, shared, verbose=verbose, brief=brief)
    if shared:
        echo()
        echo(f"all {len(specimens)} specimens")
        for line in shared_lines(specimens, shared):
            echo(f"  ! {line}", fg="yellow")
    if not verbose and any(specimen.sampler is not None for specimen in specimens):
        echo("In brackets: 95 % intervals, with what is not known of the machine; -v prints both kinds.")


def _print_exclusion(row: Exclusion) -> None:
    """A trial that was left out, why, and what the specimen's numbers would be with it."""
    where = row.path if row.sheet is None else f"{row.path} [{row.sheet}]"
    echo()
    echo(f"excluded  {where}: {row.because}")
    if row.note:
        echo(f"  {row.note}")
    for one in row.with_it:
        before = with_error(one.without, one.without_stderr)
        after = with_error(one.with_it, one.with_stderr)
        echo(f"  {one.symbol:<6} with it {after} {one.unit} (without: {before})")


def print_reasons(found: Assembled, *, quiet: int) -> None:
    """On stderr: every refused input, and why else the exit code is not 0."""
    for one in found.refused:
        echo(f"refused ({one.code})  {one}", fg="red", err=True)
    told = {str(one) for one in found.refused}
    same: dict[str, list[str]] = {}
    for reason in found.exit.reasons:
        if reason not in told:
            specimen, separator, missing = reason.rpartition(": not identified: ")
            same.setdefault(missing if separator else "", []).append(specimen if separator else reason)
    for reason in same.pop("", []):
        note(reason, quiet=quiet)
    for missing, specimens in same.items():
        # each is named, however many they are
        note(f"{'; '.join(specimens)}: not identified: {missing}", quiet=quiet)


def _print_specimen(fit: Specimen, shared: Sequence[str], *, verbose: int, brief: bool) -> None:
    echo()
    for line in specimen_lines(fit, shared, verbose=verbose, brief=brief):
        echo(line.text, fg=_COLOURS.get(line.kind), bold=line.kind in {"title", "alarm"})
