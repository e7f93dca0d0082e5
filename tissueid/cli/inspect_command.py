"""``tissueid inspect``."""

from __future__ import annotations

from typing import Any

import click

from tissueid.cli.output import echo_json, output_options, progress_bar
from tissueid.cli.reading import read_in_order, read_options, reading_options, segment_options

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
    from tissueid.inspection import describe_trial
    from tissueid.result import Refusal

    reading = read_options(
        columns=flags["columns"],
        units=flags["units"],
        axes=flags["axes"],
        specimen_by=flags["specimen_by"],
        recipe=flags["recipe"],
    )
    segmenting = segment_options(compression=flags["compression"], contact=flags["contact"])
    described: list[dict[str, Any] | Refusal] = []
    with progress_bar(show=not flags["quiet"] and not flags["as_json"]) as progress:
        for item in read_in_order(flags["paths"], reading):
            progress(item.path if isinstance(item, Refusal) else item.name, len(described), 0)
            described.append(item if isinstance(item, Refusal) else describe_trial(item, options=segmenting))
    refused = [one for one in described if isinstance(one, Refusal)]
    if flags["as_json"]:
        echo_json([one.as_json() if isinstance(one, Refusal) else one for one in described])
    else:
        for one in described:
            if isinstance(one, Refusal):
                click.secho(f"refused ({one.code})  {one}", fg="red", err=True)
            elif not flags["quiet"]:
                _print(one)
    return exit_code({7 if len(refused) < len(described) else 3}) if refused else 0


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
