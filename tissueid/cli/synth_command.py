"""``tissueid synth``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from tissueid.cli.completion_command import dialects, recipes
from tissueid.cli.flags import FOLDER, FROM_0, OutputFlags, argument, option, subcommand
from tissueid.cli.output import echo, echo_json, note, refusing
from tissueid.errors import refuse

#: No test machine logs faster; a slip of the keyboard must not fill the memory.
HIGHEST_RATE_HZ = 1e5


def check_rate(rate_Hz: float) -> None:
    """Refuse a rate that no machine samples at."""
    if not 0.0 < rate_Hz <= HIGHEST_RATE_HZ:
        refuse(f"--rate is {rate_Hz}, must be above 0 and at most {HIGHEST_RATE_HZ:g} Hz")


def _list_dialects(context: click.Context, _option: click.Parameter, value: bool) -> None:
    if not value or context.resilient_parsing:
        return
    from tissueid.synth import EXPORTS

    width = max(map(len, EXPORTS))
    for name, export in EXPORTS.items():
        echo(f"{name:<{width}}  {export.description} ({export.suffix})")
    context.exit()


class _SynthFlags(OutputFlags):
    list_dialects: None = option(
        "List the dialects and leave.", "--dialects", is_flag=True, is_eager=True, callback=_list_dialects
    )
    recipe: str = argument(shell_complete=recipes)
    out: str = option("Folder to write to.", "-o", required=True, type=FOLDER)
    seed: int = option("Seed of the noise and the scatter.", type=FROM_0, default=0)
    rate: float | None = option("Sampling rate, where not the recipe's.", metavar="HZ")
    dialect: str = option(
        "How each log is written: a locale or option of Bluehill, or another machine's format.",
        metavar="NAME",
        default="bare",
        shell_complete=dialects,
    )


@subcommand(
    "synth",
    "paper-a-30 -o synthetic --rate 100",
    "my_recipe.toml -o synthetic --seed 7 --dialect semicolon",
    "--dialects",
)
def command(flags: _SynthFlags) -> int:
    """Write synthetic exports with a known truth.

    RECIPE is a name (paper-a-30, paper-a-30-k1, paper-a-22) or a recipe.toml.
    """
    from tissueid.synth import RECIPES, load_recipe, recipe, write_set

    named = flags.recipe
    is_file = named not in RECIPES and Path(named).suffix == ".toml"
    if is_file and not Path(named).exists():
        refuse(f"{named}: no such file")
    plan = load_recipe(named) if is_file else recipe(named)
    if flags.rate is not None:
        check_rate(flags.rate)
        plan = replace(plan, rate_Hz=flags.rate)
    with refusing(flags.out, "written to", "choose another folder"):
        files = write_set(plan, flags.out, seed=flags.seed, dialect=flags.dialect)
    if flags.as_json:
        echo_json([str(path) for path in files])
    else:
        note(f"wrote {len(files)} files to {flags.out}", quiet=flags.quiet)
    return 0
