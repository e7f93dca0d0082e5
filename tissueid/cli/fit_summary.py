"""What ``fit`` says at its end, from the documents it wrote: results of an earlier run print the same."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from tissueid.cli.output import echo, note
from tissueid.cli.quoted_lines import quoted_lines
from tissueid.cli.uncertainty_lines import alarm_lines, parameter_lines, sampling_lines
from tissueid.digits import with_error
from tissueid.errors import printable

if TYPE_CHECKING:
    from tissueid.study.assembly import Assembled

__all__ = ["print_reasons", "print_summary"]

#: Remarks on trials that every other recording has; ``inspect`` and the report show them.
UNREMARKABLE = {
    "starts_in_contact",
    "no_hold",
    "several_steps",
    "event_rows",
    "column_choice",
    "undecoded_text",
}


def print_summary(found: Assembled, out: str, *, quiet: int, verbose: int) -> None:
    """Numbers to stdout, what was left out and what is missing to stderr.

    Parameters
    ----------
    found : Assembled
    out : str
        Output folder as the user named it.
    quiet, verbose : int
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
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=True)
    if found.large:
        console.print(f"{found.fitted} of {found.jobs} specimens fitted", markup=False)
    elif found.fitted:
        for specimen in json.loads(found.document.read_bytes())["specimens"]:
            _print_specimen(console, specimen, verbose=verbose)
    for row in found.exclusions:
        _print_exclusion(console, row)
    if found.fitted:
        console.print(f"\nReport: {out}/report.html", markup=False)


def _print_exclusion(console: Any, row: Mapping[str, Any]) -> None:
    """A trial that was left out, why, and what the specimen's numbers would be with it."""
    where = row["path"] if row["sheet"] is None else f"{row['path']} [{row['sheet']}]"
    console.print(f"\nexcluded  {where}: {row['because']}", markup=False)
    if row["note"]:
        console.print(f"  {row['note']}", markup=False)
    for one in row["with_it"]:
        before = "not identified" if one["without"] is None else f"{one['without']:.4g}"
        after = "not identified" if one["with"] is None else with_error(one["with"], one["with_stderr"])
        console.print(f"  {one['symbol']:<6} with it {after} {one['unit']} (without: {before})", markup=False)


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
        note(printable(reason), quiet=quiet)
    for missing, specimens in same.items():
        # each is named, however many they are
        note(f"{printable('; '.join(specimens))}: not identified: {missing}", quiet=quiet)


def _print_specimen(console: Any, fit: Mapping[str, Any], *, verbose: int) -> None:
    model, trials = fit["model"], fit["trials"]
    plural = "es" if model["branches"] > 1 else ""
    console.print(
        f"\n[bold]{_escaped(fit['specimen'])}[/bold]  {len(trials)} log{'s' * (len(trials) > 1)}, "
        f"{model['branches']} branch{plural}, K of degree {model['stiffness_degree']}, "
        f"{model['static_pooling']} static, NRMSD {100 * fit['nrmsd']['range']:.2f} % of range",
    )
    for line in (*parameter_lines(fit), *sampling_lines(fit), *quoted_lines(fit)):
        console.print(f"  {line}", markup=False)
    for line in alarm_lines(fit):
        console.print(f"  ! {line}", style="bold red", markup=False)
    for flag in fit["flags"]:
        console.print(f"  ! {flag['message']}", style="yellow", markup=False)
    _print_remarks(console, fit)
    if verbose:
        for row in fit["relaxation"]:
            tau = "none" if row["tau_single_s"] is None else f"{row['tau_single_s']:.4g} s"
            window = f"{row['window_s'][0]:g} to {row['window_s'][1]:g} s"
            console.print(f"  hold {window}: one exponential {tau}", markup=False)


def _print_remarks(console: Any, fit: Mapping[str, Any]) -> None:
    """Flags of trials, each kind once."""
    said = {flag["code"] for flag in fit["flags"]} | UNREMARKABLE
    of_code: dict[str, list[tuple[str, str]]] = {}
    for trial in fit["trials"]:
        for flag in trial["flags"]:
            of_code.setdefault(flag["code"], []).append((trial["path"], flag["message"]))
    for code, flags in of_code.items():
        if code in said:
            continue
        path, message = flags[0]
        more = f" (and {len(flags) - 1} more logs)" if len(flags) > 1 else ""
        console.print(f"  ! {path}: {message}{more}", style="yellow", markup=False)


def _escaped(text: str) -> str:
    from rich.markup import escape

    return escape(text)
