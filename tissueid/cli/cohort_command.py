"""``tissueid cohort``."""

from __future__ import annotations

from pathlib import Path

import click

from tissueid.cli.flags import FOLDER_THERE, FROM_0, OutputFlags, argument, option, subcommand
from tissueid.cli.output import echo_json, progress_bar

EXAMPLES = """
tissueid cohort out
tissueid cohort out --group-by sex --covariate age_years
"""

NOT_CONVERGED = 4


class _CohortFlags(OutputFlags):
    # fmt: off
    out: str = argument(type=FOLDER_THERE)
    group_by: str | None = option("Covariate of the study whose groups are compared.", metavar="KEY")
    covariates: tuple[str, ...] = option("Covariate to allow for.", "--covariate", metavar="KEY")
    tails: str = option(
        "How specimens scatter: t lets the data say how heavy the tails are.",
        type=click.Choice(["t", "normal"]), default="t",
    )
    mix_states: bool = option("Pool thawed specimens with fresh ones.")
    seed: int = option("Seed of the chains.", type=FROM_0, default=0)
    no_held_out: bool = option("Leave out the prediction of each specimen from the others.")
    # fmt: on


@subcommand("cohort", EXAMPLES)
def command(flags: _CohortFlags) -> int:
    """Say what specimens have in common and how they differ.

    OUT is the output folder of `tissueid fit` with three specimens or more and their posteriors.  Writes
    population.json, population.h5 and cohort.html into it, all at once or not at all; tissueid render draws
    a specimen from population.h5 and makes it felt.
    """
    from tissueid.cli.population_lines import print_population
    from tissueid.study.cohort import PopulationRequest, write_population

    quiet = flags.quiet
    request = PopulationRequest(
        group_by=flags.group_by,
        covariates=flags.covariates,
        tails=flags.tails,
        seed=flags.seed,
        hold_out=not flags.no_held_out,
        mix_states=flags.mix_states,
    )
    with progress_bar(show=not quiet) as progress:
        written = write_population(Path(flags.out), request, progress)
    if flags.as_json:
        echo_json(written.document)
    else:
        print_population(written, flags.out, quiet=quiet)
    return 0 if written.converged else NOT_CONVERGED
