"""``tissueid cohort``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

from tissueid.cli.flags import OutputFlags, argument, option, takes
from tissueid.cli.output import echo_json, progress_bar

EPILOG = """\b
Examples:
  tissueid cohort out
  tissueid cohort out --group-by sex --covariate age_years
"""

NOT_CONVERGED = 4


@dataclass(frozen=True, kw_only=True)
class CohortFlags(OutputFlags):
    """Flags of ``tissueid cohort``."""

    # fmt: off
    out: str = argument(type=click.Path(exists=True, file_okay=False))
    group_by: str | None = option(
        "--group-by", metavar="KEY", help="Covariate of the study whose groups are compared.",
    )
    covariates: tuple[str, ...] = option(
        "--covariate", multiple=True, metavar="KEY", help="Covariate to allow for.",
    )
    tails: str = option(
        "--tails", type=click.Choice(["t", "normal"]), default="t", show_default=True,
        help="How specimens scatter: t lets the data say how heavy the tails are.",
    )
    mix_states: bool = option("--mix-states", is_flag=True, help="Pool thawed specimens with fresh ones.")
    seed: int = option(
        "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the chains.",
    )
    no_held_out: bool = option(
        "--no-held-out", is_flag=True, help="Leave out the prediction of each specimen from the others.",
    )
    # fmt: on


@click.command("cohort", epilog=EPILOG)
@takes(CohortFlags)
def command(flags: CohortFlags) -> int:
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
