"""``tissueid fit``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.output import echo_json, note, output_options, progress_bar, with_error
from tissueid.cli.quoted_lines import quoted_lines
from tissueid.cli.quoting import quoting_options, quoting_values
from tissueid.cli.reading import (
    READING,
    read_all,
    read_in_order,
    read_options,
    reading_options,
    segment_options,
)
from tissueid.cli.uncertainty_lines import alarm_lines, parameter_lines, sampling_lines
from tissueid.errors import UsageError, printable

if TYPE_CHECKING:
    from tissueid.pipeline import IdentifyOptions
    from tissueid.posterior.specimen import PosteriorOptions
    from tissueid.result import Identification, Refusal, SpecimenFit
    from tissueid.store.sums import StoredSums

__all__ = ["command"]

EPILOG = """\b
Examples:
  tissueid fit lab_data/ -o out
  tissueid fit "session 3/"*.csv --branches 2 --stiffness-degree 1
  tissueid fit lab_data/study.toml -o out
  tissueid fit meat.xlsx --json > meat.json
  tissueid fit odd.csv --columns "time=t,displacement=pos,force=F" --units "force=mN"
"""


#: Remarks on trials that every other recording has; ``inspect`` and the report show them.
UNREMARKABLE = {
    "starts_in_contact",
    "no_hold",
    "several_steps",
    "event_rows",
    "column_choice",
    "undecoded_text",
}
REQUIRED = ["viscosity", "static", "stiffness", "relaxation-time", "none"]


def _count(auto: str) -> click.Choice[str]:
    return click.Choice([*auto, "auto"])


@click.command("fit", epilog=EPILOG)
@click.argument("paths", nargs=-1, required=True, type=click.Path())
@click.option(
    "-o", "--out", type=click.Path(file_okay=False), default="tissueid-out", show_default=True,
    help="Output folder.",
)  # fmt: skip
@click.option(
    "--branches", type=_count("123"), default="auto", show_default=True,
    help="Relaxation branches; auto chooses by held-out data.",
)  # fmt: skip
@click.option(
    "--stiffness-degree", type=_count("012"), default="auto", show_default=True,
    help="Degree of the dynamic stiffness K(x); auto chooses by held-out data.",
)  # fmt: skip
@click.option(
    "--static", type=click.Choice(["partial", "shared", "per-log"]), default="partial", show_default=True,
    help="Static curve of a specimen's logs: one with a gain and contact offset a log, one, or one each.",
)  # fmt: skip
@click.option(
    "--noise", type=click.Choice(["auto", "white", "ar1", "white+ar1"]), default="auto", show_default=True,
    help="Noise of the force; auto takes what the residuals show.",
)  # fmt: skip
@click.option(
    "--sampler", type=click.Choice(["emcee", "exact", "none"]), default="emcee", show_default=True,
    help="How the posterior is sampled; none gives standard errors only.",
)  # fmt: skip
@click.option(
    "--draws", type=click.IntRange(min=100), default=10_000, show_default=True,
    help="Effective posterior draws to go on for.",
)  # fmt: skip
@click.option(
    "--compare", is_flag=True,
    help="Set a chosen model beside others: evidence, held-out logs and speeds (half a minute a specimen).",
)  # fmt: skip
@click.option(
    "--require", multiple=True, type=click.Choice(REQUIRED),
    help="What must be identified for exit code 0. [default: viscosity and static]",
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of everything random."
)
@click.option(
    "--study", type=click.Path(), metavar="FILE",
    help="Study file. [default: study.toml of the folder that is fitted]",
)  # fmt: skip
@click.option("--no-study", is_flag=True, help="Fit without the folder's study.toml.")
@quoting_options
@reading_options
@output_options
def command(**flags: Any) -> int:
    """Identify the tissue behind recordings.

    PATHS are exports, workbooks, folders of them, or a study.toml. Each file or sheet is its own specimen
    unless their headers carry the same specimen label, --specimen-by groups them, or a study does. Writes
    identification.json, one bundle a specimen, curves.h5, posteriors.h5, sums.h5 and report.html to the
    output folder, all at once or not at all.
    """
    from tissueid.fit.compiled import kernels_to_compile
    from tissueid.pipeline import identify
    from tissueid.report import render_report
    from tissueid.store.curves import curves_of_fits
    from tissueid.store.files import plain_json
    from tissueid.store.outputs import OutputSet
    from tissueid.store.posteriors import posteriors_of_fits
    from tissueid.store.results import REPORT, write_results
    from tissueid.study.recordings import locate_study, read_decided_one

    quiet: int = flags["quiet"]
    reading = read_options(flags)
    options = _identify_options(flags)
    study, paths = locate_study(flags["paths"], named=flags["study"], ignore=flags["no_study"])
    items = read_in_order(paths, reading, study)
    _refuse_foreign(Path(flags["out"]))
    missing = kernels_to_compile(posterior=flags["sampler"] != "none")
    if missing:
        note(
            f"First run: compiling {len(missing)} kernels, a minute or two: {', '.join(missing)}",
            quiet=quiet,
        )
    refused: list[Refusal] = []
    sums: list[StoredSums] = []
    with OutputSet(flags["out"]) as run, progress_bar(show=not quiet) as progress:
        identification = identify(
            read_all(items, refused),
            study=study,
            options=options,
            reload=lambda source: read_decided_one(source.path, source.sheet, reading, study),
            refused=refused,
            provenance={"reading": {key: flags[key] for key in READING}},
            progress=progress,
            checkpoint=run.sampling,
            keep_sums=sums.append,
        )
        document: dict[str, Any] = plain_json(identification.as_json())
        if identification.specimens:
            progress("writing the report", 0, 0)
            document = write_results(run, identification, sums)
            curves = curves_of_fits(identification.specimens)
            posteriors = posteriors_of_fits(identification.specimens)
            created = datetime.now(UTC).isoformat(timespec="seconds")
            page = render_report(document, curves, posteriors, created=created)
            run.write(REPORT, page.encode("utf-8"))
            run.commit()
    if flags["as_json"]:
        echo_json(document)
    else:
        _note_unlisted(identification, quiet=quiet)
        if not quiet:
            _print(identification, flags["out"], verbose=flags["verbose"])
        _print_reasons(identification, quiet=quiet)
    return identification.exit.code


def _note_unlisted(identification: Identification, *, quiet: int) -> None:
    """Recordings that the study does not name were read as well: say so."""
    rows = () if identification.study is None else identification.study["trials"]
    beside = sum(not row["listed"] for row in rows)
    if 0 < beside < len(rows):
        note(
            f"{beside} of {len(rows)} trials are not named by the study and were fitted as well "
            "(only_listed = true leaves them out)",
            quiet=quiet,
        )


def _refuse_foreign(out: Path) -> None:
    """Files of our names in a folder that no run of ours made are somebody's: they stay."""
    if (out / ".current").exists() or not out.is_dir():
        return
    names = ("identification.json", "report.html", "curves.h5", "bundle*.h5")
    foreign = sorted(path.name for name in names for path in out.glob(name))
    if foreign:
        msg = (
            f"{out} holds {', '.join(foreign)} that tissueid did not write there: choose another folder "
            "with -o, or move them away"
        )
        raise UsageError(msg)


def _posterior_options(flags: dict[str, Any]) -> PosteriorOptions | None:
    from tissueid.posterior.specimen import PosteriorOptions

    if flags["sampler"] == "none":
        return None
    return PosteriorOptions(
        sampler=flags["sampler"],
        draws=flags["draws"],
        seed=flags["seed"],
        workers=os.cpu_count() or 1,
        compare=flags["compare"],
    )


def _identify_options(flags: dict[str, Any]) -> IdentifyOptions:
    from tissueid.fit.specimen import FitOptions
    from tissueid.pipeline import DEFAULT_REQUIRED, IdentifyOptions

    required = tuple(name for name in flags["require"] if name != "none")
    return IdentifyOptions(
        fit=FitOptions(
            branches=None if flags["branches"] == "auto" else int(flags["branches"]),
            stiffness_degree=None if flags["stiffness_degree"] == "auto" else int(flags["stiffness_degree"]),
            static=flags["static"],
            noise=flags["noise"],
            **quoting_values(flags),
        ),
        segment=segment_options(compression=flags["compression"], contact=flags["contact"]),
        posterior=_posterior_options(flags),
        required=required if flags["require"] else DEFAULT_REQUIRED,
        seed=flags["seed"],
    )


def _print(identification: Identification, out: str, *, verbose: int) -> None:
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=True)
    for fit in identification.specimens:
        _print_specimen(console, fit, verbose=verbose)
    for row in (identification.study or {}).get("exclusions", ()):
        _print_exclusion(console, row)
    if identification.specimens:
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


def _print_reasons(identification: Identification, *, quiet: int) -> None:
    """On stderr: every refused input, and why else the exit code is not 0."""
    for one in identification.refused:
        click.secho(f"refused ({one.code})  {one}", fg="red", err=True)
    told = {str(one) for one in identification.refused}
    same: dict[str, list[str]] = {}
    for reason in identification.exit.reasons:
        if reason not in told:
            specimen, separator, missing = reason.rpartition(": not identified: ")
            same.setdefault(missing if separator else "", []).append(specimen if separator else reason)
    for reason in same.pop("", []):
        note(printable(reason), quiet=quiet)
    for missing, specimens in same.items():
        # each is named, however many they are
        note(f"{printable('; '.join(specimens))}: not identified: {missing}", quiet=quiet)


def _print_specimen(console: Any, fit: SpecimenFit, *, verbose: int) -> None:
    model = fit.model
    plural = "es" if model.branches > 1 else ""
    console.print(
        f"\n[bold]{_escaped(fit.specimen)}[/bold]  {len(fit.trials)} log{'s' * (len(fit.trials) > 1)}, "
        f"{model.branches} branch{plural}, K of degree {model.stiffness_degree}, "
        f"{model.static_pooling} static, NRMSD {100 * fit.nrmsd.range:.2f} % of range",
    )
    for line in (*parameter_lines(fit), *sampling_lines(fit), *quoted_lines(fit)):
        console.print(f"  {line}", markup=False)
    for line in alarm_lines(fit):
        console.print(f"  ! {line}", style="bold red", markup=False)
    for flag in fit.flags:
        console.print(f"  ! {flag.message}", style="yellow", markup=False)
    said = {flag.code for flag in fit.flags} | UNREMARKABLE
    for code in dict.fromkeys(flag.code for trial in fit.trials for flag in trial.flags):
        if code in said:
            continue
        of_code = [(trial, flag) for trial in fit.trials for flag in trial.flags if flag.code == code]
        trial, flag = of_code[0]
        more = f" (and {len(of_code) - 1} more logs)" if len(of_code) > 1 else ""
        console.print(f"  ! {trial.path}: {flag.message}{more}", style="yellow", markup=False)
    if verbose:
        for row in fit.relaxation:
            tau = "none" if row.tau_single_s is None else f"{row.tau_single_s:.4g} s"
            window = f"{row.window_s[0]:g} to {row.window_s[1]:g} s"
            console.print(f"  hold {window}: one exponential {tau}", markup=False)


def _escaped(text: str) -> str:
    from rich.markup import escape

    return escape(text)
