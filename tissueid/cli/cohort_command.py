"""``tissueid cohort``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tissueid.cli.flags import FOLDER_THERE, FROM_0, OutputFlags, argument, option, subcommand
from tissueid.cli.output import echo, echo_json, note, progress_bar
from tissueid.digits import together
from tissueid.documents import plain
from tissueid.errors import NotIdentifiedError
from tissueid.flags import warning_line

if TYPE_CHECKING:
    from tissueid.study.cohort import WrittenPopulation


class _CohortFlags(OutputFlags):
    out: str = argument(type=FOLDER_THERE)
    group_by: str | None = option("Covariate of the study whose groups are compared.", metavar="KEY")
    covariates: tuple[str, ...] = option("Covariate to allow for.", "--covariate", metavar="KEY")
    tails: Literal["t", "normal"] = option(
        "How specimens scatter: t lets the data say how heavy the tails are.", default="t"
    )
    mix_states: bool = option("Pool thawed specimens with fresh ones.")
    seed: int = option("Seed of the chains.", type=FROM_0, default=0)
    no_held_out: bool = option("Leave out the prediction of each specimen from the others.")


@subcommand("cohort", "out", "out --group-by sex --covariate age_years")
def command(flags: _CohortFlags) -> int:
    """Say what specimens have in common and how they differ.

    OUT is the output folder of `tissueid fit` with three specimens or more and their posteriors.  Writes
    population.json, population.h5 and cohort.html into it, all at once or not at all; tissueid render draws
    a specimen from population.h5 and makes it felt.
    """
    from tissueid.population.cohort import CohortOptions
    from tissueid.population.sampler import SamplerOptions
    from tissueid.study.cohort import write_population

    options = CohortOptions(
        group_by=flags.group_by,
        covariates=flags.covariates,
        sampler=SamplerOptions(tails=flags.tails, seed=flags.seed),
        hold_out=not flags.no_held_out,
    )
    with progress_bar(show=not flags.quiet) as progress:
        written = write_population(Path(flags.out), options, progress, mix_states=flags.mix_states)
    if flags.as_json:
        echo_json(plain(written.document))
    else:
        print_population(written, flags.out, quiet=flags.quiet)
    return 0 if written.converged else NotIdentifiedError.exit_status


def print_population(written: WrittenPopulation, out: str, *, quiet: int) -> None:
    """Quantities with their spread, held-out specimens, remarks; specimens that take no part go to stderr."""
    if quiet:
        return
    document = written.document
    found = document.population
    assert found is not None  # noqa: S101  (asked before)
    echo()
    echo(f"population of {len(document.specimens_used)} specimens, to {found.depth_mm:.3g} mm", bold=True)
    for row in found.quantities:
        median, low, high, *wide = together(
            [row.median, *row.ci95, *(row.ci95_total or ())], (row.ci95[1] - row.ci95[0]) / 4.0
        )
        first, last = row.cv_ci95
        total = "" if row.ci95_total is None else f"; with the machine {' to '.join(wide)}"
        unit = "" if row.unit == "1" else f" {row.unit}"
        echo(
            f"  {row.words:<34} {median}{unit} (95 %: {low} to {high}{total}), "
            f"between specimens CV {100 * row.cv:.1f} % ({100 * first:.1f} to {100 * last:.1f})"
        )
    if found.held_out is not None:
        by = found.held_out.nrmsd_range
        echo(
            f"  held-out specimens: NRMSD {100 * by.median:.1f} % of range "
            f"(68 %: {100 * by.low68:.1f} to {100 * by.high68:.1f})"
        )
    for flag in document.flags:
        echo(f"  ! {warning_line(flag.code, flag.message)}", fg="yellow")
    echo()
    if not written.felt:
        echo("No population.h5: specimens drawn from so open a population have no force that is a number")
    echo(f"Report: {out}/cohort.html")
    for one in written.fit.left_out:
        note(f"left out: {one.specimen}: {one.reason}")
