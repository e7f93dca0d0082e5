"""``tissueid inspect``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.output import echo, echo_json, note, output_options, progress_bar, write_output
from tissueid.cli.reading import read_in_order, read_options, reading_options, segment_options
from tissueid.digits import with_error

if TYPE_CHECKING:
    from tissueid.result import Refusal
    from tissueid.study.inspected import Inspection

EPILOG = """\b
Examples:
  tissueid inspect Specimen_RawData_1.csv
  tissueid inspect lab_data/ --html inspection.html
  tissueid inspect lab_data/study.toml --html inspection.html
  tissueid inspect lab_data/ --serve
  tissueid inspect lab_data/ --json
  tissueid inspect lab_data/ --csv measured.csv --xlsx measured.xlsx
  tissueid inspect plain.csv --columns "time=t,displacement=x,force=F"
"""

SECONDS_PER_MINUTE = 60.0


@click.command("inspect", epilog=EPILOG)
@click.argument("paths", nargs=-1, required=True, type=click.Path())
@click.option(
    "--html", type=click.Path(dir_okay=False), metavar="FILE",
    help="Write a page that draws every recording, with its flags and the lines of study.toml to change it.",
)  # fmt: skip
@click.option(
    "--csv", type=click.Path(dir_okay=False), metavar="FILE",
    help="Write what was measured as a table, one row a hold.",
)  # fmt: skip
@click.option(
    "--xlsx", type=click.Path(dir_okay=False), metavar="FILE", help="The same table as a workbook.",
)  # fmt: skip
@click.option(
    "--study", type=click.Path(), metavar="FILE",
    help="Study file whose decisions are followed. [default: study.toml of the folder that is inspected]",
)  # fmt: skip
@click.option("--no-study", is_flag=True, help="Leave the folder's study.toml aside.")
@click.option(
    "--serve", is_flag=True,
    help="Serve that page on this machine: what is corrected on it is written into study.toml.",
)  # fmt: skip
@click.option("--no-browser", is_flag=True, help="With --serve: print the page's address, open nothing.")
@click.option(
    "--viewer-port", type=click.IntRange(1, 65535), metavar="N",
    help="With --serve: its port. [default: 8765, or a free one]",
)  # fmt: skip
@reading_options
@output_options
def command(**flags: Any) -> int:
    """Say what recordings hold, one line each: peak, depth, speed, forces in the hold, keep it or look.

    -v says how each was read and divided: format, columns, phases, first, last and peak samples, and every
    flag. Nothing is fitted, and nothing is written but what --html, --csv and --xlsx name, and study.toml by
    --serve. `tissueid FILE...` is the same. Exit code 0 if all were read, 7 if some were refused, 3 if all
    were.
    """
    from tissueid.errors import exit_code
    from tissueid.result import Refusal

    if flags["serve"]:
        from tissueid.cli.inspect_serving import serve

        return serve(flags, lambda asked: inspected(asked, drawn=True))
    found = inspected(flags, drawn=flags["html"] is not None)
    if flags["html"] is not None:
        write_output(flags["html"], found.page().encode("utf-8"))
        note(f"wrote {flags['html']}", quiet=flags["quiet"])
    _write_tables(found.read, flags)
    if flags["as_json"]:
        echo_json([one.as_json() if isinstance(one, Refusal) else one for one in found.described])
    else:
        print_all(found.described, quiet=flags["quiet"], verbose=flags["verbose"])
    return exit_code({7 if found.read else 3}) if found.refused else 0


def inspected(flags: dict[str, Any], *, drawn: bool) -> Inspection:
    """Everything that the command line names, by the study file as it stands."""
    from tissueid.result import Refusal
    from tissueid.study.inspected import Inspection, study_folder
    from tissueid.study.recordings import locate_study

    study, paths = locate_study(flags["paths"], named=flags["study"], ignore=flags["no_study"])
    root = study_folder(flags["paths"]) if study is None else Path(study.path).resolve().parent
    found = Inspection(segment_options(flags), study, root, drawn=drawn)
    with progress_bar(show=not flags["quiet"] and not flags["as_json"]) as progress:
        for item in read_in_order(paths, read_options(flags), study):
            progress(item.path if isinstance(item, Refusal) else item.name, len(found.described), 0)
            found.add(item)
    return found


def _write_tables(read: list[dict[str, Any]], flags: dict[str, Any]) -> None:
    from tissueid.cli.inspect_table import measured_csv, measured_xlsx

    for name, written in (("csv", measured_csv), ("xlsx", measured_xlsx)):
        if flags[name] is not None:
            write_output(flags[name], written(read))
            note(f"wrote {flags[name]}", quiet=flags["quiet"])


def print_all(described: list[dict[str, Any] | Refusal], *, quiet: int, verbose: int) -> None:
    """A line a recording, its block with -v, and how many are to be looked at."""
    from tissueid.cli.inspect_lines import COLOURS, names_of, recording_lines, summary_lines
    from tissueid.result import Refusal

    read = [one for one in described if not isinstance(one, Refusal)]
    named = iter(names_of(read))
    for one in described:
        if isinstance(one, Refusal):
            echo(f"refused ({one.code})  {one}", fg="red", err=True)
            continue
        heading, name = next(named)
        if quiet:
            continue
        if heading:
            echo(heading)
        for line in recording_lines(one, name, alone=len(described) == 1):
            echo(line, fg=COLOURS[one["verdict"]["level"]], bold=bool(verbose))
        if verbose:
            _print(one)
    if len(described) > 1 and not quiet:
        for line in summary_lines(read, len(described) - len(read)):
            echo(line, bold=True)


def _print(one: dict[str, Any]) -> None:
    from tissueid.study.inspected import reader_words

    echo(f"  {reader_words(one)[0].lower()}{reader_words(one)[1:]}")
    echo(f"  specimen    {one['specimen']}")
    if one["excluded"] is not None:
        echo(f"  excluded    because: {one['excluded']}", fg="yellow")
    echo("  columns     " + ", ".join(f"{key} = {value}" for key, value in one["columns"].items()))
    sign = "positive" if one["compression_sign"] > 0 else "negative"
    echo(f"  samples     {one['n_samples']}, compression is {sign} displacement")
    length, force = (one["units"][key] for key in ("length", "force"))
    for key, label in (("first", "first"), ("peak_force", "peak force"), ("last", "last")):
        point = one[key]
        place = f"{point['time_s']:.6g} s, {point['displacement_mm']:.6g} {length}"
        echo(f"  {label:<11} {place}, {point['force_N']:.6g} {force}")
    contact = one["contact"]
    if contact is not None:
        echo(f"  contact     {with_error(contact['displacement_mm'], contact['sd_mm'])} {length}")
    _print_phases(one, length)
    _print_corners(one, length)
    _print_cycles(one)
    for flag in one["flags"]:
        echo(f"  ! {flag['code']}: {flag['message']}", fg="yellow")


def _print_phases(one: dict[str, Any], length: str) -> None:
    for phase in one["phases"]:
        line = f"  {phase['kind']:<11} {phase['start_s']:.6g} to {phase['end_s']:.6g} s"
        speed = phase["speed_mm_s"]
        if speed != 0.0:
            line += f", {speed:.4g} {length}/s ({speed * SECONDS_PER_MINUTE:.4g} {length}/min)"
        if phase["peak_s"] is not None:
            line += f", deepest at {phase['peak_s']:.6g} s"
        echo(line)


def _print_corners(one: dict[str, Any], length: str) -> None:
    from tissueid.report.wording import event_words, took

    for corner in one["corners"]:
        line = f"  stop        at {corner['time_s']:.6g} s, {took(corner['duration_s'])}"
        if corner["overshoot_mm"] > 0.0:
            line += f", overshoot {corner['overshoot_mm']:.2g} {length}"
        if corner["ringing_swings"] > 1:
            line += f", rings {corner['ringing_swings']} times"
        echo(line)
    for event in one["events"]:
        words = event_words(event["values"], one["units"])
        echo(f"  {event['kind'].replace('_', ' '):<11} at {event['time_s']:.6g} s: {words}")


def _print_cycles(one: dict[str, Any]) -> None:
    length, force = (one["units"][key] for key in ("length", "force"))
    for cycle in one["cycles"]:
        parts = [
            f"{words} {cycle[key]['value']:.4g}{unit}"
            for key, words, unit in (
                ("peak_force_N", "peak", f" {force}"),
                ("secant_N_per_mm", "secant", f" {force}/{length}"),
                ("dissipated_mJ", "loop area", f" {force} {length}"),
            )
            if cycle[key]["value"] is not None
        ]
        echo(f"  loop {cycle['number']:<6} to {cycle['peak_depth_mm']:.4g} {length}: {', '.join(parts)}")
