"""``tissueid inspect``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.output import echo_json, output_options, progress_bar
from tissueid.cli.reading import read_all, read_options, reading_options, segment_options

if TYPE_CHECKING:
    from tissueid.result import Refusal

__all__ = ["command"]

EPILOG = """\b
Examples:
  tissueid inspect Specimen_RawData_1.csv
  tissueid inspect lab_data/ --json
  tissueid inspect plain.csv --columns "time=t,displacement=x,force=F"
"""


@click.command("inspect", epilog=EPILOG)
@click.argument("paths", nargs=-1, required=True, type=click.Path())
@reading_options
@output_options
def command(**flags: Any) -> int:
    """Say what recordings hold: format, columns, phases, first, last and peak samples, and warnings.

    Nothing is fitted and nothing is written. Exit code 0 if all were read, 7 if some were refused, 3 if
    all were.
    """
    from tissueid.errors import exit_code
    from tissueid.pipeline import describe_trial

    reading = read_options(
        columns=flags["columns"],
        units=flags["units"],
        specimen_by=flags["specimen_by"],
        recipe=flags["recipe"],
    )
    segmenting = segment_options(compression=flags["compression"], contact=flags["contact"])
    refused: list[Refusal] = []
    described: list[dict[str, Any]] = []
    with progress_bar(show=not flags["quiet"] and not flags["as_json"]) as progress:
        for trial in read_all(flags["paths"], reading, refused):
            progress(trial.name, len(described), 0)
            described.append(describe_trial(trial, options=segmenting))
    if flags["as_json"]:
        echo_json([*described, *(one.as_json() for one in refused)])
    else:
        if not flags["quiet"]:
            for one in described:
                _print(one)
        for refusal in refused:
            where = refusal.path if refusal.sheet is None else f"{refusal.path} [{refusal.sheet}]"
            line = "" if refusal.line is None else f", line {refusal.line}"
            column = "" if refusal.column is None else f", column {refusal.column}"
            text = f"{where}{line}{column}: refused ({refusal.code}): {refusal.message}"
            click.secho(text, fg="red", err=True)
    if refused:
        return exit_code({7 if described else 3})
    return 0


def _print(one: dict[str, Any]) -> None:
    name = one["path"] if one["sheet"] is None else f"{one['path']} [{one['sheet']}]"
    click.secho(f"\n{name}", bold=True)
    text = ", ".join(str(one[key]) for key in ("recipe", "encoding") if one[key])
    click.echo(f"  read as     {text}; specimen {one['specimen']}")
    click.echo("  columns     " + ", ".join(f"{key} = {value}" for key, value in one["columns"].items()))
    sign = "positive" if one["compression_sign"] > 0 else "negative"
    click.echo(f"  samples     {one['n_samples']}, compression is {sign} displacement")
    for key, label in (("first", "first"), ("peak_force", "peak force"), ("last", "last")):
        point = one[key]
        values = f"{point['time_s']:.6g} s, {point['displacement_mm']:.6g} mm, {point['force_N']:.6g} N"
        click.echo(f"  {label:<11} {values}")
    contact = one["contact"]
    if contact is not None:
        click.echo(f"  contact     {contact['displacement_mm']:.4f} ± {contact['sd_mm']:.4f} mm")
    for phase in one["phases"]:
        click.echo(
            f"  {phase['kind']:<11} {phase['start_s']:.6g} to {phase['end_s']:.6g} s, "
            f"{phase['speed_mm_s']:.4g} mm/s"
        )
    for flag in one["flags"]:
        click.secho(f"  ! {flag['code']}: {flag['message']}", fg="yellow")
