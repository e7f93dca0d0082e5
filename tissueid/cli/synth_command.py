"""``tissueid synth``."""

from __future__ import annotations

from typing import Any

import click

from tissueid.cli.output import echo_json, note, output_options

__all__ = ["command"]

EPILOG = """\b
Examples:
  tissueid synth paper-a-30 -o synthetic --rate 100
  tissueid synth my_recipe.toml -o synthetic --seed 7 --dialect semicolon
"""


@click.command("synth", epilog=EPILOG)
@click.argument("recipe")
@click.option("-o", "--out", required=True, type=click.Path(), help="Folder to write to.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the noise and the scatter.")
@click.option("--rate", type=float, metavar="HZ", help="Sampling rate, where not the recipe's.")
@click.option("--dialect", default="bare", show_default=True, help="How the CSV is written.")
@output_options
def command(**flags: Any) -> int:
    """Write synthetic Bluehill exports with a known truth.

    RECIPE is a name (paper-a-30, paper-a-30-k1, paper-a-22) or a recipe.toml.
    """
    from dataclasses import replace
    from pathlib import Path

    from tissueid.synth import RECIPES, load_recipe, recipe, write_set

    named = flags["recipe"]
    plan = load_recipe(named) if named not in RECIPES and Path(named).suffix == ".toml" else recipe(named)
    if flags["rate"] is not None:
        plan = replace(plan, rate_Hz=flags["rate"])
    files = write_set(plan, flags["out"], seed=flags["seed"], dialect=flags["dialect"])
    if flags["as_json"]:
        echo_json([str(path) for path in files])
    else:
        note(f"wrote {len(files)} files to {flags['out']}", quiet=flags["quiet"])
    return 0
