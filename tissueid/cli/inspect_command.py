"""``tissueid inspect``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import structs

from tissueid.cli.flags import FILE, PATH, PORT, OutputFlags, argument, option, subcommand
from tissueid.cli.output import echo, echo_json, note, progress_bar, write_output
from tissueid.cli.reading import ReadingFlags, read_in_order, read_options, segment_options
from tissueid.digits import with_error
from tissueid.documents.inspect import Trial

if TYPE_CHECKING:
    from tissueid.result import Refusal
    from tissueid.study.inspected import Inspection

EXAMPLES = """
tissueid inspect Specimen_RawData_1.csv
tissueid inspect lab_data/ --html inspection.html
tissueid inspect lab_data/study.toml --html inspection.html
tissueid inspect lab_data/ --serve
tissueid inspect lab_data/ --json
tissueid inspect lab_data/ --csv measured.csv --xlsx measured.xlsx
tissueid inspect plain.csv --columns "time=t,displacement=x,force=F"
"""

SECONDS_PER_MINUTE = 60.0


class _InspectFlags(ReadingFlags, OutputFlags):
    # fmt: off
    paths: tuple[str, ...] = argument(required=True, type=PATH)
    html: str | None = option(
        "Write a page that draws every recording, with its flags and the lines of study.toml to change it.",
        type=FILE, metavar="FILE",
    )
    csv: str | None = option("Write what was measured as a table, one row a hold.", type=FILE, metavar="FILE")
    xlsx: str | None = option("The same table as a workbook.", type=FILE, metavar="FILE")
    study: str | None = option(
        "Study file whose decisions are followed. [default: study.toml of the folder that is inspected]",
        type=PATH, metavar="FILE",
    )
    no_study: bool = option("Leave the folder's study.toml aside.")
    serve: bool = option(
        "Serve that page on this machine: what is corrected on it is written into study.toml."
    )
    no_browser: bool = option("With --serve: print the page's address, open nothing.")
    viewer_port: int | None = option(
        "With --serve: its port. [default: 8765, or a free one]", type=PORT, metavar="N"
    )
    # fmt: on


@subcommand("inspect", EXAMPLES)
def command(flags: _InspectFlags) -> int:
    """Say what recordings hold, one line each: peak, depth, speed, forces in the hold, keep it or look.

    -v says how each was read and divided: format, columns, phases, first, last and peak samples, and every
    flag. Nothing is fitted, and nothing is written but what --html, --csv and --xlsx name, and study.toml by
    --serve. `tissueid FILE...` is the same. Exit code 0 if all were read, 7 if some were refused, 3 if all
    were.
    """
    from tissueid.errors import exit_code

    if flags.serve:
        from tissueid.cli.inspect_serving import serve

        return serve(flags, lambda asked: inspected(asked, drawn=True))
    found = inspected(flags, drawn=flags.html is not None)
    if flags.html is not None:
        write_output(flags.html, found.page().encode("utf-8"))
        note(f"wrote {flags.html}", quiet=flags.quiet)
    _write_tables(found.read, flags)
    if flags.as_json:
        echo_json(found.printed)
    else:
        print_all(found.described, quiet=flags.quiet, verbose=flags.verbose)
    return exit_code({7 if found.read else 3}) if found.refused else 0


def inspected(flags: _InspectFlags, *, drawn: bool) -> Inspection:
    """Everything that the command line names, by the study file as it stands."""
    from tissueid.result import Refusal
    from tissueid.study.inspected import Inspection, study_folder
    from tissueid.study.recordings import locate_study

    study, paths = locate_study(flags.paths, named=flags.study, ignore=flags.no_study)
    root = study_folder(flags.paths) if study is None else Path(study.path).resolve().parent
    found = Inspection(segment_options(flags), study, root, drawn=drawn)
    with progress_bar(show=not flags.quiet and not flags.as_json) as progress:
        for item in read_in_order(paths, read_options(flags), study):
            progress(item.path if isinstance(item, Refusal) else item.name, len(found.described), 0)
            found.add(item)
    return found


def _write_tables(read: list[Trial], flags: _InspectFlags) -> None:
    from tissueid.cli.inspect_table import measured_csv, measured_xlsx

    for path, written in ((flags.csv, measured_csv), (flags.xlsx, measured_xlsx)):
        if path is not None:
            write_output(path, written(read))
            note(f"wrote {path}", quiet=flags.quiet)


def print_all(described: list[Trial | Refusal], *, quiet: int, verbose: int) -> None:
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
            echo(line, fg=COLOURS[one.verdict.level], bold=bool(verbose))
        if verbose:
            _print(one)
    if len(described) > 1 and not quiet:
        for line in summary_lines(read, len(described) - len(read)):
            echo(line, bold=True)


def _print(one: Trial) -> None:
    from tissueid.study.inspected import reader_words

    echo(f"  {reader_words(one)[0].lower()}{reader_words(one)[1:]}")
    echo(f"  specimen    {one.specimen}")
    if one.excluded is not None:
        echo(f"  excluded    because: {one.excluded}", fg="yellow")
    echo(
        "  columns     "
        + ", ".join(
            f"{key} = {value}" for key, value in structs.asdict(one.columns).items() if value is not None
        )
    )
    sign = "positive" if one.compression_sign > 0 else "negative"
    echo(f"  samples     {one.n_samples}, compression is {sign} displacement")
    length, force = one.units.length, one.units.force
    for point, label in ((one.first, "first"), (one.peak_force, "peak force"), (one.last, "last")):
        place = f"{point.time_s:.6g} s, {point.displacement_mm:.6g} {length}"
        echo(f"  {label:<11} {place}, {point.force_N:.6g} {force}")
    contact = one.contact
    if contact is not None:
        echo(f"  contact     {with_error(contact.displacement_mm, contact.sd_mm)} {length}")
    _print_phases(one, length)
    _print_corners(one, length)
    _print_cycles(one)
    for flag in one.flags:
        echo(f"  ! {flag.code}: {flag.message}", fg="yellow")


def _print_phases(one: Trial, length: str) -> None:
    for phase in one.phases:
        line = f"  {phase.kind:<11} {phase.start_s:.6g} to {phase.end_s:.6g} s"
        speed = phase.speed_mm_s
        if speed != 0.0:
            line += f", {speed:.4g} {length}/s ({speed * SECONDS_PER_MINUTE:.4g} {length}/min)"
        if phase.peak_s is not None:
            line += f", deepest at {phase.peak_s:.6g} s"
        echo(line)


def _print_corners(one: Trial, length: str) -> None:
    from tissueid.report.wording import event_words, took

    for corner in one.corners:
        line = f"  stop        at {corner.time_s:.6g} s, {took(corner.duration_s)}"
        if corner.overshoot_mm > 0.0:
            line += f", overshoot {corner.overshoot_mm:.2g} {length}"
        if corner.ringing_swings > 1:
            line += f", rings {corner.ringing_swings} times"
        echo(line)
    for event in one.events:
        words = event_words(event.values, one.units)
        echo(f"  {event.kind.replace('_', ' '):<11} at {event.time_s:.6g} s: {words}")


def _print_cycles(one: Trial) -> None:
    length, force = one.units.length, one.units.force
    for cycle in one.cycles:
        parts = [
            f"{words} {measure.value:.4g}{unit}"
            for measure, words, unit in (
                (cycle.peak_force_N, "peak", f" {force}"),
                (cycle.secant_N_per_mm, "secant", f" {force}/{length}"),
                (cycle.dissipated_mJ, "loop area", f" {force} {length}"),
            )
            if measure.value is not None
        ]
        echo(f"  loop {cycle.number:<6} to {cycle.peak_depth_mm:.4g} {length}: {', '.join(parts)}")
