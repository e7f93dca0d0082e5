"""``tissueid export``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.output import echo_bytes, echo_json, note, output_options, write_output

if TYPE_CHECKING:
    from tissueid.store.posteriors import StoredPosterior

__all__ = ["command"]

EPILOG = """\b
Examples:
  tissueid export out
  tissueid export out --format specimens -o specimens.csv
  tissueid export out --format trials -o trials.csv
  tissueid export out --format json -o result.json
  tissueid export out --format netcdf -o chains.nc
"""

#: The tables of :data:`tissueid.store.tidy.TABLES`, named here so that --help loads nothing.
TABLES = ("specimens", "trials", "cycles", "quantities")


@click.command("export", epilog=EPILOG)
@click.argument("out", type=click.Path(exists=True))
@click.option(
    "--format", "form", type=click.Choice(["json", *TABLES, "netcdf"]), default="json", show_default=True,
    help="The document; a CSV table with one row a specimen, a trial, a load-unload loop, a quoted number; "
    "or the posterior's draws for arviz, one file a specimen.",
)  # fmt: skip
@click.option("-o", "--output", type=click.Path(), help="File to write instead of stdout.")
@output_options
def command(**flags: Any) -> int:
    """Write a finished fit as JSON, a tidy CSV table or draws for arviz, from its output folder alone.

    The tables read straight into R (read.csv) and Prism: UTF-8, comma, decimal point, units in the column
    names, an empty cell where nothing is known.  NetCDF needs arviz (pip install 'tissueid[arviz]'); where a
    fit has several specimens, each gets a file: chains-SPECIMEN.nc.
    """
    from tissueid.store.files import json_bytes
    from tissueid.store.results import read_results
    from tissueid.store.tidy import csv_bytes, tidy_table

    document, _, posteriors = read_results(flags["out"])
    if flags["form"] == "netcdf":
        return _write_netcdf(posteriors, flags)
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


def _write_netcdf(posteriors: Sequence[StoredPosterior], flags: dict[str, Any]) -> int:
    from pathlib import Path

    from tissueid.errors import UsageError
    from tissueid.exchange import netcdf_bytes
    from tissueid.store.names import file_names

    if flags["output"] is None:
        msg = "netcdf is no text for a terminal: name a file with -o, as -o chains.nc"
        raise UsageError(msg)
    if not posteriors:
        msg = f"{flags['out']}: no posterior was sampled; run `tissueid fit` again without --sampler none"
        raise UsageError(msg)
    first = Path(flags["output"])
    names = file_names((one.specimen for one in posteriors), first.stem, first.suffix)
    for one in posteriors:
        path = first if len(posteriors) == 1 else first.with_name(names[one.specimen])
        write_output(str(path), netcdf_bytes(one.to_arviz()))
        note(f"wrote {path}", quiet=flags["quiet"])
    return 0
