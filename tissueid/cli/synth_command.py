"""``tissueid synth``."""

from __future__ import annotations

from dataclasses import dataclass

import click

from tissueid.cli.completing import dialects, recipes
from tissueid.cli.flags import OutputFlags, argument, option, takes
from tissueid.cli.output import echo, echo_json, note

EPILOG = """\b
Examples:
  tissueid synth paper-a-30 -o synthetic --rate 100
  tissueid synth my_recipe.toml -o synthetic --seed 7 --dialect semicolon
  tissueid synth --dialects
"""


#: No test machine logs faster; a slip of the keyboard must not fill the memory.
HIGHEST_RATE_HZ = 1e5


def _list_dialects(context: click.Context, _option: click.Parameter, value: bool) -> None:
    """Print every dialect with what it is, and leave."""
    if not value or context.resilient_parsing:
        return
    from tissueid.synth import EXPORTS

    width = max(map(len, EXPORTS))
    for name, export in EXPORTS.items():
        echo(f"{name:<{width}}  {export.description} ({export.suffix})")
    context.exit()


@dataclass(frozen=True, kw_only=True)
class SynthFlags(OutputFlags):
    """Flags of ``tissueid synth``."""

    # fmt: off
    recipe: str = argument(shell_complete=recipes)
    out: str = option(
        "-o", "--out", required=True, type=click.Path(file_okay=False), help="Folder to write to.",
    )
    seed: int = option(
        "--seed", type=click.IntRange(min=0), default=0, show_default=True,
        help="Seed of the noise and the scatter.",
    )
    rate: float | None = option(
        "--rate", type=float, metavar="HZ", help="Sampling rate, where not the recipe's.",
    )
    dialect: str = option(
        "--dialect", metavar="NAME", default="bare", show_default=True, shell_complete=dialects,
        help="How each log is written: a locale or option of Bluehill, or another machine's format.",
    )
    # fmt: on


@click.command("synth", epilog=EPILOG)
@click.option(
    "--dialects",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=_list_dialects,
    help="List the dialects and leave.",
)
@takes(SynthFlags)
def command(flags: SynthFlags) -> int:
    """Write synthetic exports with a known truth.

    RECIPE is a name (paper-a-30, paper-a-30-k1, paper-a-22) or a recipe.toml.
    """
    from dataclasses import replace
    from pathlib import Path

    from tissueid.errors import UsageError
    from tissueid.synth import RECIPES, load_recipe, recipe, write_set

    named = flags.recipe
    is_file = named not in RECIPES and Path(named).suffix == ".toml"
    if is_file and not Path(named).exists():
        msg = f"{named}: no such file"
        raise UsageError(msg)
    plan = load_recipe(named) if is_file else recipe(named)
    if flags.rate is not None:
        if not 0.0 < flags.rate <= HIGHEST_RATE_HZ:
            msg = f"--rate is {flags.rate}, must be above 0 and at most {HIGHEST_RATE_HZ:g} Hz"
            raise UsageError(msg)
        plan = replace(plan, rate_Hz=flags.rate)
    try:
        files = write_set(plan, flags.out, seed=flags.seed, dialect=flags.dialect)
    except OSError as error:
        msg = f"{flags.out}: can't be written to ({error.strerror}); choose another folder"
        raise UsageError(msg) from error
    if flags.as_json:
        echo_json([str(path) for path in files])
    else:
        note(f"wrote {len(files)} files to {flags.out}", quiet=flags.quiet)
    return 0
