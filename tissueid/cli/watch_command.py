"""``tissueid watch``."""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tissueid.cli.flags import FOLDER, PATH, OutputFlags, argument, option, subcommand
from tissueid.cli.inspect_command import COLOURS, recording_lines
from tissueid.cli.output import draw, echo, echo_json_text, made_folder, note
from tissueid.cli.reading import StudyFlags, read_options, segment_options
from tissueid.digits import with_error
from tissueid.documents import plain
from tissueid.documents.inspect import Watch
from tissueid.errors import InputError, UsageError, refuse
from tissueid.report.wording import whole_label

if TYPE_CHECKING:
    from tissueid.ingest import ReadOptions
    from tissueid.manifest import Study
    from tissueid.trial import Trial
    from tissueid.watch import Happening, WatchSession

SHORTEST_INTERVAL_S = 0.05
#: Looks after which a file that does not change is whole.
LOOKS = 2


class _WatchFlags(StudyFlags, OutputFlags):
    # fmt: off
    folder: str = argument(type=PATH)
    out: str | None = option("Folder for watch.jsonl, from which a later watch goes on.", "-o", type=FOLDER)
    interval: float = option(
        "Seconds between two looks; a file is judged when two looks find it the same.",
        type=click.FloatRange(min=SHORTEST_INTERVAL_S), default=0.5, metavar="S",
    )
    once: bool = option("Judge what is there, and end.")
    new_only: bool = option("Pass over the recordings that are there at the start.")
    same_specimen: bool = option("All recordings of the folder are of one specimen.")
    fit: bool = option(
        "Fit each test alone as well, after its line; with --json the line comes again. [default: no-fit]",
        "--fit/--no-fit", default=False,
    )
    bell: bool = option("Ring the terminal's bell after each test, twice where it must be repeated.")
    # fmt: on


@subcommand(
    "watch", '"D:/session 3" -o verdicts', "lab_data/ --same-specimen --bell", "lab_data/ --once --json"
)
def command(flags: _WatchFlags) -> int:
    """Watch a folder beside the machine, and give a verdict after each test.

    A recording has its line within three seconds of being whole: what was measured, and keep it, look or push
    again with one reason, as `tissueid inspect` says it, beside earlier pushes into the specimen. With --json
    each is one line. Ctrl-C ends with a summary.
    """
    session = _session(flags)
    try:
        for number in range(LOOKS) if flags.once else count():
            if number:
                time.sleep(flags.interval)
            for happening in session.step():
                _tell(happening, flags)
            if number == LOOKS - 1 and not flags.once:
                note("waiting for the next test; Ctrl-C ends", quiet=flags.quiet)
    except KeyboardInterrupt:
        note("", quiet=flags.quiet)
    if not flags.as_json and not flags.quiet:
        _summary(session)
    refused = [one.verdict.level == "refused" for one in session.verdicts]
    return (3 if all(refused) else 7) if flags.once and any(refused) else 0


def _session(flags: _WatchFlags) -> WatchSession:
    # readers load it at their first table, which would be waited for with a specimen on the machine
    import_module("pandas")
    from tissueid.study.recordings import locate_study
    from tissueid.watch import LOG, FolderWatch, WatchSession, fingerprint, judge, load_log, quick_fit

    folder = Path(flags.folder)
    if not folder.is_dir():
        refuse(f"{folder}: there is no such folder to watch")
    reading = read_options(flags)
    segmenting = segment_options(flags)
    log = None if flags.out is None else made_folder(flags.out) / LOG
    study, _ = locate_study([flags.folder], named=flags.study, ignore=flags.no_study)
    specimen = folder.resolve().name if flags.same_specimen else None
    watch = FolderWatch(lambda: _recordings(folder))
    if flags.new_only:
        watch.known = {path: mark for path in _recordings(folder) if (mark := fingerprint(path)) is not None}
    return WatchSession(
        watch,
        lambda path: _trials(path, reading, study, specimen),
        lambda trial, earlier: judge(trial, earlier, options=segmenting, study=study),
        log,
        [] if log is None else load_log(log),
        fit=(lambda trial: quick_fit(trial, segmenting, study)) if flags.fit else None,
    )


def _recordings(folder: Path) -> list[Path]:
    """The recordings of the folder now; an ``OSError`` where it can't be listed."""
    from tissueid.ingest import each_input

    try:
        return [item for item in each_input([folder]) if isinstance(item, Path)]
    except (InputError, UsageError) as error:
        if isinstance(error, InputError) and error.code == "no_recording":
            return []
        raise OSError(error.message) from error


def _trials(
    path: Path, reading: ReadOptions, study: Study | None, specimen: str | None
) -> Iterator[Trial | InputError]:
    from tissueid.study.recordings import read_decided
    from tissueid.trial import Trial

    for item in read_decided(path, reading, study):
        yield replace(item, specimen=specimen) if specimen is not None and isinstance(item, Trial) else item


def _tell(happening: Happening, flags: _WatchFlags) -> None:
    verdict = happening.verdict
    if verdict is None:
        note(happening.text, quiet=flags.quiet)
        return
    level = verdict.verdict.level
    if flags.as_json:
        echo_json_text(json.dumps(plain(verdict), ensure_ascii=False, allow_nan=False))
    elif not flags.quiet or level in {"repeat", "refused"}:
        if happening.kind == "fitted":
            _print_fit(verdict)
        else:
            _print(verdict, flags, again=happening.kind == "replaced")
    if flags.bell and happening.kind != "fitted":
        draw("\a\a" if level in {"repeat", "refused"} else "\a")


def _print(one: Watch, flags: _WatchFlags, *, again: bool) -> None:
    """The line of ``inspect``: what was measured, and what to do."""
    changed = "changed, judged again: " if again else ""
    if one.error is not None:
        lines = [f"{changed}refused ({one.error.code})  {one.verdict.reason}"]
    else:
        lines = recording_lines(one, changed + whole_label(one, os.path.join(flags.folder, "")))  # noqa: PTH118
    for line in lines:
        echo(line, fg=COLOURS[one.verdict.level])


def _print_fit(one: Watch) -> None:
    found = {} if one.fit is None else {entry.name: entry for entry in one.fit.parameters}
    known = [
        f"{label} {with_error(entry.value, entry.stderr)}{'' if entry.value is None else f' {entry.unit}'}"
        for key, label in (("static_1_N_per_mm", "static"), ("viscosity_N_s_per_mm", "viscosity"))
        if (entry := found.get(key)) is not None
    ]
    echo(f"    this test alone: {', '.join(known) or 'could not be fitted'}")


def _summary(session: WatchSession) -> None:
    words = {"good": "good", "look": "to look at", "repeat": "to repeat", "refused": "refused"}
    often: Counter[str] = Counter(one.verdict.level for one in session.verdicts)
    told = ", ".join(f"{often[level]} {said}" for level, said in words.items() if often[level])
    many = "s" * (len(session.verdicts) > 1)
    note(f"{len(session.verdicts)} test{many}: {told}" if told else "no test was seen")
    for one in session.verdicts:
        level = one.verdict.level
        if level in {"repeat", "refused"}:
            note(f"  {words[level]}: {whole_label(one)}")
