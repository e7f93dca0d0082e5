"""``tissueid export``."""

from __future__ import annotations

from typing import Any

import click

from tissueid.cli.output import echo_bytes, echo_json, note, output_options, write_output

__all__ = ["command"]

EPILOG = """\b
Examples:
  tissueid export out
  tissueid export out --format specimens -o specimens.csv
  tissueid export out --format trials -o trials.csv
  tissueid export out --format json -o result.json
"""

#: The tables of :data:`tissueid.store.tidy.TABLES`, named here so that --help loads nothing.
TABLES = ("specimens", "trials", "cycles", "quantities")


@click.command("export", epilog=EPILOG)
@click.argument("out", type=click.Path(exists=True))
@click.option(
    "--format", "form", type=click.Choice(["json", *TABLES]), default="json", show_default=True,
    help="The document, or a CSV table: one row a specimen, a trial, a load-unload loop, a quoted number.",
)  # fmt: skip
@click.option("-o", "--output", type=click.Path(), help="File to write instead of stdout.")
@output_options
def command(**flags: Any) -> int:
    """Write a finished fit as JSON or as a tidy CSV table, from its output folder alone.

    The tables read straight into R (read.csv) and Prism: UTF-8, comma, decimal point, units in the column
    names, an empty cell where nothing is known.
    """
    from tissueid.store.files import json_bytes
    from tissueid.store.results import read_results
    from tissueid.store.tidy import csv_bytes, tidy_table

    document, *_ = read_results(flags["out"])
    as_json = flags["form"] == "json"
    if as_json and flags["output"] is None:
        echo_json(document)
        return 0
    content = json_bytes(document) if as_json else csv_bytes(tidy_table(document, flags["form"]))
    if flags["output"] is not None:
        write_output(flags["output"], content)
        note(f"wrote {flags['output']}", quiet=flags["quiet"])
        return 0
    echo_bytes(content)
    return 0
