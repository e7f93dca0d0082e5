"""``tissueid inspect``: a line a recording, tables, and the page that is served."""

from __future__ import annotations

import csv
import io
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

from msgspec import structs

from tissueid.cli.flags import FILE, PATH, PORT, OutputFlags, argument, option, subcommand
from tissueid.cli.output import echo, echo_json, note, progress_bar, write_output
from tissueid.cli.reading import StudyFlags, read_in_order, read_options, segment_options
from tissueid.digits import clock_start, with_error
from tissueid.documents.inspect import Trial, Watch
from tissueid.documents.measured import MeasuredHold, MeasuredPush
from tissueid.errors import exit_code, printable, refuse
from tissueid.flags import FLAGS, harm_rank
from tissueid.report.wording import event_words, took, whole_label
from tissueid.result import Refusal
from tissueid.store.xlsx import Cell, Sheet, xlsx_bytes

if TYPE_CHECKING:
    from tissueid.study.inspected import Inspection

SECONDS_PER_MINUTE = 60.0


class _InspectFlags(StudyFlags, OutputFlags):
    paths: tuple[str, ...] = argument(required=True, type=PATH)
    html: str | None = option(
        "Write a page that draws every recording, with its flags and the lines of study.toml to change it.",
        type=FILE,
    )
    csv: str | None = option("Write what was measured as a table, one row a hold.", type=FILE)
    xlsx: str | None = option("The same table as a workbook.", type=FILE)
    serve: bool = option(
        "Serve that page on this machine: what is corrected on it is written into study.toml."
    )
    no_browser: bool = option("With --serve: print the page's address, open nothing.")
    viewer_port: int | None = option(
        "With --serve: its port. [default: 8765, or a free one]", type=PORT, metavar="N"
    )


@subcommand(
    "inspect",
    "Specimen_RawData_1.csv",
    "lab_data/ --html inspection.html",
    "lab_data/study.toml --html inspection.html",
    "lab_data/ --serve",
    "lab_data/ --json",
    "lab_data/ --csv measured.csv --xlsx measured.xlsx",
    'plain.csv --columns "time=t,displacement=x,force=F"',
)
def command(flags: _InspectFlags) -> int:
    """Say what recordings hold, one line each: peak, depth, speed, forces in the hold, keep it or look.

    -v says how each was read and divided: format, columns, phases, first, last and peak samples, and every
    flag. Nothing is fitted, and nothing is written but what --html, --csv and --xlsx name, and study.toml by
    --serve. `tissueid FILE...` is the same. Exit code 0 if all were read, 7 if some were refused, 3 if all
    were.
    """
    if flags.serve:
        return serve(flags)
    found = inspected(flags, drawn=flags.html is not None)
    if flags.html is not None:
        write_output(flags.html, found.page().encode("utf-8"), quiet=flags.quiet)
    for path, written in ((flags.csv, measured_csv), (flags.xlsx, measured_xlsx)):
        if path is not None:
            write_output(path, written(found.read), quiet=flags.quiet)
    if flags.as_json:
        echo_json(found.printed)
    else:
        print_all(found.described, quiet=flags.quiet, verbose=flags.verbose)
    return exit_code({7 if found.read else 3}) if found.refused else 0


def inspected(flags: _InspectFlags, *, drawn: bool) -> Inspection:
    """Everything that the command line names, by the study file as it stands."""
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


def print_all(described: list[Trial | Refusal], *, quiet: int, verbose: int) -> None:
    """A line a recording, its block with -v, and how many are to be looked at."""
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

    said = reader_words(one)
    echo(f"  {said[0].lower()}{said[1:]}")
    echo(f"  specimen    {one.specimen}")
    if one.excluded is not None:
        echo(f"  excluded    because: {one.excluded}", fg="yellow")
    columns = [f"{key} = {value}" for key, value in structs.asdict(one.columns).items() if value is not None]
    echo(f"  columns     {', '.join(columns)}")
    sign = "positive" if one.compression_sign > 0 else "negative"
    echo(f"  samples     {one.n_samples}, compression is {sign} displacement")
    length, force = one.units.length, one.units.force
    start_s = clock_start(one.first.time_s)
    if start_s:
        echo(f"  clock       times below are from {start_s:.12g} s on")
    for point, label in ((one.first, "first"), (one.peak_force, "peak force"), (one.last, "last")):
        place = f"{point.time_s - start_s:.6g} s, {point.displacement_mm:.6g} {length}"
        echo(f"  {label:<11} {place}, {point.force_N:.6g} {force}")
    contact = one.contact
    if contact is not None:
        echo(f"  contact     {with_error(contact.displacement_mm, contact.sd_mm)} {length}")
    _print_course(one, start_s)
    for cycle in one.cycles:
        told = (
            (cycle.peak_force_N, "peak", f" {force}"),
            (cycle.secant_N_per_mm, "secant", f" {force}/{length}"),
            (cycle.dissipated_mJ, "loop area", f" {force} {length}"),
        )
        parts = [f"{words} {it.value:.4g}{unit}" for it, words, unit in told if it.value is not None]
        echo(f"  loop {cycle.number:<6} to {cycle.peak_depth_mm:.4g} {length}: {', '.join(parts)}")
    for flag in one.flags:
        echo(f"  ! {flag.code}: {flag.message}", fg="yellow")


def _print_course(one: Trial, start_s: float) -> None:
    """Phases, the stops between them, and events."""
    length = one.units.length
    for phase in one.phases:
        line = f"  {phase.kind:<11} {phase.start_s - start_s:.6g} to {phase.end_s - start_s:.6g} s"
        speed = phase.speed_mm_s
        if speed != 0.0:
            line += f", {speed:.4g} {length}/s ({speed * SECONDS_PER_MINUTE:.4g} {length}/min)"
        if phase.peak_s is not None:
            line += f", deepest at {phase.peak_s - start_s:.6g} s"
        echo(line)
    for corner in one.corners:
        line = f"  stop        at {corner.time_s - start_s:.6g} s, {took(corner.duration_s)}"
        if corner.overshoot_mm > 0.0:
            line += f", overshoot {corner.overshoot_mm:.2g} {length}"
        if corner.ringing_swings > 1:
            line += f", rings {corner.ringing_swings} times"
        echo(line)
    for event in one.events:
        words = event_words(event.values, one.units)
        echo(f"  {event.kind.replace('_', ' '):<11} at {event.time_s - start_s:.6g} s: {words}")


#: What a level asks for, and its colour.
WORDS = {"good": "keep", "look": "look", "repeat": "push again"}
COLOURS = {"good": None, "look": "yellow", "repeat": "red", "refused": "red"}
#: Times after the stop that stand in the line [s].
TIMES_S = (1.0, 10.0)
DIGITS = 4
#: Columns of a line, and what goes before its second one.
WIDTH, INDENT = 100, "    "
#: Flags of a batch that are counted.
MOST_SHARED = 5


def names_of(described: Sequence[Trial]) -> list[tuple[str, str]]:
    """Heading, empty but before the first of several sheets of a file, and name of every recording."""
    folders = {os.path.dirname(one.path) for one in described}  # noqa: PTH120 -- paths as they were typed
    apart = len(described) < 2 or "" in folders or len({Path(one).is_absolute() for one in folders}) > 1
    folder = "" if apart else os.path.join(os.path.commonpath(folders), "")  # noqa: PTH118
    sheets = Counter(one.path for one in described)
    found = []
    for before, one in zip([None, *described], described, strict=False):
        if one.sheet is None or sheets[one.path] == 1:
            found.append(("", whole_label(one, folder)))
        else:
            first = before is None or before.path != one.path
            found.append((one.path.removeprefix(folder) * first, f"  {one.sheet}"))
    return found


def recording_lines(one: Trial | Watch, name: str, *, alone: bool = True) -> list[str]:
    """Numbers and verdict of a recording in 100 columns; ``alone``: no summary follows that counts flags."""
    verdict, flags = one.verdict, len(one.flags)
    word = WORDS[verdict.level]
    if one.excluded is not None:
        word = f"excluded ({one.excluded})"
    elif verdict.reason is not None and (alone or verdict.level != "good"):
        word += f": {verdict.reason}"
    if flags and alone:
        word += f"  {flags} flag{'s' * (flags > 1)}"
    lines = [name]
    for part in (_numbers(one), word):
        if len(lines[-1]) + 2 + len(part) <= WIDTH:
            lines[-1] += f"  {part}"
        else:
            lines += wrap(part, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT)
    return lines


def _numbers(one: Trial | Watch) -> str:
    measured = one.measured
    assert measured is not None  # noqa: S101  (what is refused has no such line)
    assert one.units is not None  # noqa: S101
    length, force = one.units.length, one.units.force
    whole = [hold for hold in measured.holds if hold.push is not None and not hold.after_rupture]
    hold = max(whole, key=lambda one: one.push.peak.force_N if one.push else 0.0, default=None)
    push = measured.push if hold is None else hold.push
    if push is None and not measured.loops:
        return "nothing was loaded"
    if push is None:
        last = measured.loops[-1]
        area = "" if last.area_mJ is None else f", area {last.area_mJ:.{DIGITS}g} {force} {length}"
        return f"{len(measured.loops)} loops, the last to {last.depth_mm:.3g}{area}"
    deep = push.travel_mm if push.depth_mm is None else push.depth_mm
    speed = f"{push.speed_mm_s:.3g} {length}/s in {push.ramp_time_s:.3g} s"
    parts = [f"{push.peak.force_N:.{DIGITS}g} {force} at {deep:.3g} {length}, {speed}"]
    if hold is None:
        parts.append("no hold")
    elif hold.control == "force":
        parts.append(f"creeps {hold.creep_mm:.3g} {length} in {hold.end_s - hold.start_s:.3g} s")
    else:
        at = {row.time_s: row.after_stop_N for row in hold.forces}
        known = [f"F({t:g} s) {at[t]:.{DIGITS}g}" for t in TIMES_S if at.get(t) is not None]
        parts.append(f"{', '.join(known)} {force}" if known else f"hold of {hold.end_s - hold.start_s:.3g} s")
    if len(measured.holds) > 1:
        parts.append(f"{len(measured.holds)} holds")
    return "; ".join(parts)


def summary_lines(described: Sequence[Trial], refused: int) -> list[str]:
    """``49 read, 3 to look at, 1 to push again, 2 refused``, and how many share a flag, the worst first."""
    counts: Counter[str] = Counter(one.verdict.level for one in described)
    told = ((counts["look"], "to look at"), (counts["repeat"], "to push again"), (refused, "refused"))
    parts = [f"{len(described)} read", *(f"{count} {words}" for count, words in told if count)]
    shared = Counter(code for one in described for code in {flag.code for flag in one.flags})
    said = [code for code in sorted(shared, key=harm_rank) if shared[code] > 1 and code in FLAGS]
    several = [f"{shared[code]} {FLAGS[code].many}" for code in said[:MOST_SHARED]]
    counted = "; ".join([*several, "-v lists flags"]) if several else ""
    return [", ".join(parts), *wrap(counted, WIDTH, subsequent_indent=INDENT)]


#: Flags that ask for another output than the page.
_OTHERS = {"as_json": "--json", "html": "--html", "csv": "--csv", "xlsx": "--xlsx", "no_study": "--no-study"}


def serve(flags: _InspectFlags) -> int:
    """Serve until Ctrl-C what is inspected again after each correction."""
    from tissueid.cli.view_command import open_browser
    from tissueid.study.corrections import CorrectedInspection
    from tissueid.viewer.page_server import PageServer

    other = next((flag for name, flag in _OTHERS.items() if getattr(flags, name)), None)
    if other is not None:
        refuse(f"--serve writes study.toml and shows its page: leave {other} out")
    manifest = _manifest(flags)

    def inspect() -> Inspection:
        return inspected(replace(flags, study=str(manifest)) if manifest.exists() else flags, drawn=True)

    shown = CorrectedInspection(manifest, inspect, read_options(flags))
    shown.page()
    try:
        with PageServer(shown, flags.viewer_port) as server:
            # what was asked for is told however quiet: nobody guesses a token
            echo(f"page       {server.url}", err=True)
            follows = f"`tissueid fit {manifest.parent}` follows it"
            note(f"corrections go into {manifest}; {follows}; Ctrl-C ends", quiet=flags.quiet)
            if not flags.no_browser:
                open_browser(server.url)
            server.run()
    except KeyboardInterrupt:
        pass
    return 0


def _manifest(flags: _InspectFlags) -> Path:
    """The study file that is followed and written."""
    from tissueid.ingest.manifest import MANIFEST
    from tissueid.study.inspected import study_folder

    stated = [path for path in flags.paths if path.casefold().endswith(".toml")]
    named = Path(flags.study or (stated[0] if stated else study_folder(flags.paths)))
    return named / MANIFEST if named.is_dir() else named


TABLE_TIMES_S = (0.1, 1.0, 10.0, 100.0)
_PUSH = ("ramp_time_s", "speed_mm_s", "travel_mm", "depth_mm", "braking_s")
_MODULUS = ("formula", "loading_kPa", "held_kPa", "refused")

HEAD = (
    "path", "sheet", "specimen", "excluded", "verdict", "reason", "hold", "control", "start_s", "end_s",
    *_PUSH, "peak_N", "peak_time_s", "base_N", "base_source",
    *(f"force_{time:g}s_N" for time in TABLE_TIMES_S),
    *(f"force_{time:g}s_over_10s" for time in TABLE_TIMES_S if time != 10.0),
    *(f"force_{time:g}s_after_peak_N" for time in TABLE_TIMES_S),
    *(f"force_{time:g}s_over_peak_depends_on_ramp" for time in TABLE_TIMES_S),
    "relaxation_time_s", "relaxation_window_start_s", "relaxation_window_end_s",
    *(f"modulus_{name}" for name in _MODULUS),
    "loop_areas_mJ", "force_unit", "length_unit", "flags",
)  # fmt: skip


def measured_rows(described: Sequence[Trial]) -> list[list[Cell]]:
    """Rows in the order of :data:`HEAD`."""
    return [[row.get(name) for name in HEAD] for one in described for row in _rows(one)]


def _rows(one: Trial) -> Iterator[dict[str, Cell]]:
    measured = one.measured
    areas = [loop.area_mJ for loop in measured.loops if loop.area_mJ is not None]
    common: dict[str, Cell] = {
        "path": one.path,
        "sheet": one.sheet,
        "specimen": one.specimen,
        "excluded": one.excluded,
        "verdict": one.verdict.level,
        "reason": one.verdict.reason,
        "base_N": measured.base.recorded_N,
        "base_source": measured.base.source,
        "loop_areas_mJ": "; ".join(f"{area:.6g}" for area in areas) or None,
        "force_unit": one.units.force,
        "length_unit": one.units.length,
        "flags": " ".join(dict.fromkeys(flag.code for flag in one.flags)) or None,
    }
    for number, hold in enumerate(measured.holds, start=1):
        yield common | {"hold": number} | _of_hold(hold) | _of_push(hold.push)
    if not measured.holds:
        yield common | _of_push(measured.push)


def _of_push(push: MeasuredPush | None) -> dict[str, Cell]:
    if push is None:
        return {}
    row: dict[str, Cell] = {name: getattr(push, name) for name in _PUSH}
    row |= {"peak_N": push.peak.force_N, "peak_time_s": push.peak.time_s}
    return row | {f"modulus_{name}": getattr(push.modulus, name, None) for name in _MODULUS}


def _of_hold(hold: MeasuredHold) -> dict[str, Cell]:
    row: dict[str, Cell] = {"control": hold.control, "start_s": hold.start_s, "end_s": hold.end_s}
    for force in hold.forces:
        at = f"force_{force.time_s:g}s"
        row |= {
            f"{at}_N": force.after_stop_N,
            f"{at}_over_10s": force.over_10s,
            f"{at}_after_peak_N": force.after_peak_N,
            f"{at}_over_peak_depends_on_ramp": force.over_peak,
        }
    tau = hold.tau
    if tau is not None:
        row["relaxation_time_s"] = tau.single_s
        row["relaxation_window_start_s"], row["relaxation_window_end_s"] = tau.window_s
    return row


def measured_csv(described: Sequence[Trial]) -> bytes:
    """The table as CSV in UTF-8: numbers to their last digit, text without what could steer a reader."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(HEAD)
    for row in measured_rows(described):
        writer.writerow([printable(cell) if isinstance(cell, str) else cell for cell in row])
    return stream.getvalue().encode("utf-8")


def measured_xlsx(described: Sequence[Trial]) -> bytes:
    """The table as a workbook."""
    return xlsx_bytes([Sheet("measured", HEAD, measured_rows(described))])
