"""``tissueid cohort``."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.output import echo_json, note, output_options, progress_bar
from tissueid.errors import NotIdentifiedError, printable

if TYPE_CHECKING:
    from tissueid.population.cohort import CohortOptions

__all__ = ["command"]

EPILOG = """\b
Examples:
  tissueid cohort out
  tissueid cohort out --group-by sex --covariate age_years
  tissueid render out/population.h5 --draw-specimen 7
"""

#: What is written into the output folder.
DOCUMENT, BUNDLE, PAGE = "population.json", "population.h5", "cohort.html"
NOT_CONVERGED = 4


@click.command("cohort", epilog=EPILOG)
@click.argument("out", type=click.Path(exists=True, file_okay=False))
@click.option("--group-by", metavar="KEY", help="Covariate of the study whose groups are compared.")
@click.option("--covariate", "covariates", multiple=True, metavar="KEY", help="Covariate to allow for.")
@click.option(
    "--tails", type=click.Choice(["t", "normal"]), default="t", show_default=True,
    help="How specimens scatter: t lets the data say how heavy the tails are.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the chains.")
@click.option(
    "--no-held-out", is_flag=True, help="Leave out the prediction of each specimen from the others."
)
@output_options
def command(**flags: Any) -> int:
    """Say what specimens have in common and how they differ.

    OUT is the output folder of `tissueid fit` with three specimens or more and their posteriors.  Writes
    population.json, population.h5 and cohort.html into it, all at once or not at all.
    """
    from tissueid.population.cohort import cohort
    from tissueid.population.document import as_document, members_of, population_bundle
    from tissueid.report.population_page import render_population
    from tissueid.store.bundle import write_bundle
    from tissueid.store.files import json_bytes, plain_json, sha256_of
    from tissueid.store.outputs import OutputSet
    from tissueid.store.results import IDENTIFICATION, read_results
    from tissueid.store.schema import check

    out, quiet = Path(flags["out"]), flags["quiet"]
    with OutputSet(out) as run, progress_bar(show=not quiet) as progress:
        identification, curves, posteriors = read_results(out)
        options = _options(flags, identification)
        members = members_of(identification, curves, posteriors)
        fit = cohort(members, options, lambda text: progress(text, 0, 0))
        source = sha256_of(out / IDENTIFICATION)
        document: dict[str, Any] = plain_json(as_document(fit, options, source=source))
        if fit.population is None:
            raise NotIdentifiedError(_no_population(document))
        check(document, "population", where=DOCUMENT)
        progress("writing the report", 0, 0)
        run.carry_over(name for name in run.previous_names if name not in {DOCUMENT, BUNDLE, PAGE})
        run.write(DOCUMENT, json_bytes(document))
        bundle = population_bundle(fit, document)
        if bundle is not None:
            write_bundle(bundle, run.path(BUNDLE))
        created = datetime.now(UTC).isoformat(timespec="seconds")
        run.write(PAGE, render_population(document, bundle, created=created).encode("utf-8"))
        run.commit()
    if flags["as_json"]:
        echo_json(document)
    elif not quiet:
        _print(document, str(out))
    for one in fit.left_out:
        note(f"left out: {printable(one.specimen)}: {one.reason}", quiet=quiet)
    converged = document["population"]["sampler"]["converged"]
    return 0 if converged else NOT_CONVERGED


def _options(flags: dict[str, Any], identification: dict[str, Any]) -> CohortOptions:
    from tissueid.population.cohort import CohortOptions
    from tissueid.population.document import population_priors
    from tissueid.population.sampler import SamplerOptions

    return CohortOptions(
        group_by=flags["group_by"],
        covariates=flags["covariates"],
        priors=population_priors(identification),
        sampler=SamplerOptions(tails=flags["tails"], seed=flags["seed"]),
        hold_out=not flags["no_held_out"],
    )


def _no_population(document: dict[str, Any]) -> str:
    """Why there is none, and each specimen that takes no part."""
    left = "".join(f"; {printable(row['specimen'])}: {row['reason']}" for row in document["left_out"])
    return f"no population: {document['reason']}{left}"


def _print(document: dict[str, Any], out: str) -> None:
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=True)
    found = document["population"]
    count = len(document["specimens_used"])
    console.print(f"\n[bold]population of {count} specimens[/bold], to {found['depth_mm']:.3g} mm")
    for row in found["quantities"]:
        low, high = row["ci95"]
        first, last = row["cv_ci95"]
        total = (
            ""
            if row["ci95_total"] is None
            else "; with the machine {:.4g} to {:.4g}".format(*row["ci95_total"])
        )
        console.print(
            f"  {row['words']:<34} {row['median']:.4g} {row['unit']} (95 %: {low:.4g} to {high:.4g}{total}), "
            f"between specimens CV {100 * row['cv']:.1f} % ({100 * first:.1f} to {100 * last:.1f})",
            markup=False,
        )
    if found["held_out"] is not None:
        by = found["held_out"]["nrmsd_range"]
        console.print(
            f"  held-out specimens: NRMSD {100 * by['median']:.1f} % of range "
            f"(68 %: {100 * by['low68']:.1f} to {100 * by['high68']:.1f})",
            markup=False,
        )
    for flag in document["flags"]:
        console.print(f"  ! {flag['message']}", style="yellow", markup=False)
    console.print(f"\nReport: {out}/{PAGE}", markup=False)


def _total(ends: list[float] | None) -> str:
    """The interval that knows the machine, in words."""
    return "" if ends is None else f"; with the machine {ends[0]:.4g} to {ends[1]:.4g}"
