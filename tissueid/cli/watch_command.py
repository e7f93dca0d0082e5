"""``tissueid watch``."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.output import draw, echo, echo_json_text, note, output_options
from tissueid.cli.reading import read_options, reading_options, segment_options
from tissueid.digits import with_error
from tissueid.errors import UsageError

if TYPE_CHECKING:
    from tissueid.errors import InputError
    from tissueid.ingest import ReadOptions
    from tissueid.manifest import Study
    from tissueid.measures import Measured
    from tissueid.segment import SegmentOptions
    from tissueid.trial import Trial
    from tissueid.watch.session import Happening, WatchSession
    from tissueid.watch.verdict import Verdict

__all__ = ["command"]

EPILOG = """\b
Examples:
  tissueid watch "D:/session 3" -o verdicts
  tissueid watch lab_data/ --same-specimen --bell
  tissueid watch lab_data/ --once --json
"""

COLOURS = {"good": "green", "look": "yellow", "repeat": "red", "refused": "red"}
SHORTEST_INTERVAL_S = 0.05
#: Looks after which a file that does not change is whole.
LOOKS = 2


@click.command("watch", epilog=EPILOG)
@click.argument("folder", type=click.Path())
@click.option(
    "-o",
    "--out",
    type=click.Path(file_okay=False),
    help="Folder for watch.jsonl, from which a later watch goes on.",
)
@click.option(
    "--interval", type=click.FloatRange(min=SHORTEST_INTERVAL_S), default=1.0, show_default=True, metavar="S",
    help="Seconds between two looks; a file is judged when two looks find it the same.",
)  # fmt: skip
@click.option("--once", is_flag=True, help="Judge what is there, and end.")
@click.option("--new-only", is_flag=True, help="Pass over the recordings that are there at the start.")
@click.option("--same-specimen", is_flag=True, help="All recordings of the folder are of one specimen.")
@click.option("--no-fit", is_flag=True, help="Leave out the quick fit of each test.")
@click.option(
    "--bell", is_flag=True, help="Ring the terminal's bell after each test, twice where it must be repeated."
)
@click.option(
    "--study", type=click.Path(), metavar="FILE",
    help="Study file whose decisions are followed. [default: study.toml of the folder]",
)  # fmt: skip
@click.option("--no-study", is_flag=True, help="Leave the folder's study.toml aside.")
@reading_options
@output_options
def command(**flags: Any) -> int:
    """Watch a folder beside the machine, and give a verdict after each test.

    A new recording has its line, what was measured and keep it or push again, as soon as it is whole. Then it
    is judged: contact, length of the hold, whether the relaxation time
    can be told, flags, a quick fit, how the force compares with earlier tests of the specimen, and whether to
    repeat the test. With --json each verdict is one line. Ctrl-C ends with a summary.
    """
    session = _session(flags)
    if not flags["no_fit"]:
        _announce_compiling(flags["quiet"])
    looks = range(LOOKS) if flags["once"] else iter(int, 1)
    try:
        for number, _ in enumerate(looks):
            if number:
                time.sleep(flags["interval"])
            for happening in session.step():
                _tell(happening, flags)
            if number == LOOKS - 1 and flags["once"] is False:
                note("waiting for the next test; Ctrl-C ends", quiet=flags["quiet"])
    except KeyboardInterrupt:
        note("", quiet=flags["quiet"])
    if not flags["as_json"] and not flags["quiet"]:
        _summary(session)
    return _exit_code(session) if flags["once"] else 0


def _announce_compiling(quiet: int) -> None:
    from tissueid.fit.compiled import first_run_words

    words = first_run_words(posterior=False)
    if words is not None:
        note(words, quiet=quiet)


def _session(flags: dict[str, Any]) -> WatchSession:
    from tissueid.study.recordings import locate_study
    from tissueid.watch import FolderWatch
    from tissueid.watch.folder import fingerprint
    from tissueid.watch.session import LOG, WatchSession, load_log

    folder = Path(flags["folder"])
    if not folder.is_dir():
        msg = f"{folder}: there is no such folder to watch"
        raise UsageError(msg)
    reading = read_options(flags)
    segmenting = segment_options(flags)
    log = None
    if flags["out"] is not None:
        log = Path(flags["out"]) / LOG
        try:
            log.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            msg = f"{log.parent}: can't be made a folder ({error.strerror}); choose another"
            raise UsageError(msg) from error
    study, _ = locate_study([flags["folder"]], named=flags["study"], ignore=flags["no_study"])
    specimen = folder.resolve().name if flags["same_specimen"] else None
    say = None if flags["as_json"] or flags["quiet"] else _FirstWord()
    watch = FolderWatch(lambda: _recordings(folder))
    if flags["new_only"]:
        there = {path: mark for path in _recordings(folder) if (mark := fingerprint(path)) is not None}
        watch.know(there)
    return WatchSession(
        watch,
        lambda path: _trials(path, reading, study, specimen),
        lambda trial, earlier: _judged(trial, earlier, segmenting, study, say, fit=not flags["no_fit"]),
        log,
        [] if log is None else load_log(log),
    )


def _recordings(folder: Path) -> list[Path]:
    """The recordings of the folder now; an ``OSError`` where it can't be listed."""
    from tissueid.errors import InputError
    from tissueid.ingest import each_input

    try:
        return [item for item in each_input([folder]) if isinstance(item, Path)]
    except InputError as error:
        if error.code == "no_recording":
            return []
        raise OSError(error.message) from error
    except UsageError as error:
        raise OSError(str(error)) from error


def _trials(
    path: Path, reading: ReadOptions, study: Study | None, specimen: str | None
) -> Iterator[Trial | InputError]:
    from tissueid.study.recordings import read_decided
    from tissueid.trial import Trial

    for item in read_decided(path, reading, study):
        yield replace(item, specimen=specimen) if specimen is not None and isinstance(item, Trial) else item


class _FirstWord:
    """One line on a recording as soon as it is measured: the fit that follows may take longer."""

    def __init__(self) -> None:
        self._earlier: dict[str, list[Measured]] = {}

    def __call__(
        self, trial: Trial, options: SegmentOptions, study: Study | None, excluded: str | None
    ) -> None:
        """Say what ``inspect`` says of it."""
        from tissueid.cli.inspect_lines import COLOURS, recording_line
        from tissueid.inspection import describe_segmented, measured_of, segmented
        from tissueid.result import Refusal

        divided = segmented(trial, options=options)
        if isinstance(divided, Refusal):
            return
        measured = measured_of(trial, divided, study)
        before = self._earlier.setdefault(trial.specimen, [])
        one = describe_segmented(trial, divided, excluded=excluded, measured=measured, earlier=before)
        before.append(measured)
        echo(recording_line(one), fg=COLOURS[one["verdict"]["level"]])


def _judged(
    trial: Trial,
    earlier: Iterable[Verdict],
    options: SegmentOptions,
    study: Study | None,
    say: _FirstWord | None,
    *,
    fit: bool,
) -> Verdict:
    """The verdict after what the study says of the trial; an excluded one is not asked for again."""
    from tissueid.inspection import as_decided
    from tissueid.watch import judge

    trial, options, excluded = as_decided(trial, options, study)
    if say is not None:
        say(trial, options, study, excluded)
    verdict = judge(trial, earlier, options=options, fit=fit)
    if excluded is not None:
        told = f"this test is taken out, because: {excluded}"
        verdict |= {"level": "look", "advice": [told], "ramp": None}
    return verdict


def _exit_code(session: WatchSession) -> int:
    refused = [one for one in session.verdicts if one["level"] == "refused"]
    if not refused:
        return 0
    return 7 if len(refused) < len(session.verdicts) else 3


def _tell(happening: Happening, flags: dict[str, Any]) -> None:
    verdict = happening.verdict
    if verdict is None:
        note(happening.text, quiet=flags["quiet"])
        return
    if flags["as_json"]:
        echo_json_text(json.dumps(verdict, ensure_ascii=False, allow_nan=False))
    elif flags["quiet"] < 1 or verdict["level"] in {"repeat", "refused"}:
        _print(verdict, again=happening.kind == "replaced")
    if flags["bell"]:
        draw("\a\a" if verdict["level"] in {"repeat", "refused"} else "\a")


def _print(one: dict[str, Any], *, again: bool) -> None:
    name = one["path"] if one["sheet"] is None else f"{one['path']} [{one['sheet']}]"
    echo()
    echo(f"{name}{'  (changed: judged again)' if again else ''}", bold=True)
    echo(f"  {one['level'].upper()}", fg=COLOURS[one["level"]], bold=True)
    for line in _lines(one):
        echo(f"  {line}")
    for text in one["advice"]:
        echo(f"  > {text}", fg=COLOURS[one["level"]])
    codes = ", ".join(dict.fromkeys(flag["code"] for flag in one["flags"]))
    if codes:
        echo(f"  flags       {codes}")


def _lines(one: dict[str, Any]) -> Iterator[str]:
    """The numbers of a verdict, a line each."""
    if one["contact"] is not None:
        yield f"contact     {with_error(one['contact']['displacement_mm'], one['contact']['sd_mm'])} mm"
        speed = "" if one["speed_mm_s"] is None else f" at {one['speed_mm_s']:.4g} mm/s"
        yield f"reached     {one['depth_mm']:.4g} mm{speed}, {one['peak_force_N']:.4g} N"
        yield "hold        " + ("none" if one["hold_s"] is None else f"{one['hold_s']:.4g} s")
    tau = one["tau"]
    if tau["value_s"] is not None:
        known = "" if tau["resolvable"] else ", not resolvable"
        yield f"tau         about {tau['value_s']:.3g} s in a window of {tau['window_s']:.3g} s{known}"
    if tau["why"] is not None:
        yield f"            {tau['why']}"
    if one["fit"] is not None:
        found = {entry["name"]: entry for entry in one["fit"]["parameters"]}
        for key, label in (("static_1_N_per_mm", "static"), ("viscosity_N_s_per_mm", "viscosity")):
            if key in found:
                yield f"{label:<11} {_estimate(found[key])} (this test alone)"
    if one["drift"] is not None:
        drift = one["drift"]
        first, last = (100.0 * drift[key] for key in ("from_first", "from_last"))
        yield (
            f"earlier     force {first:+.1f} % against the first of {drift['tests']} equal tests,"
            f" {last:+.1f} % against the last; contact {drift['contact_moved_mm']:+.3g} mm"
        )


def _estimate(entry: dict[str, Any]) -> str:
    if entry["value"] is None:
        return "not identified"
    return f"{with_error(entry['value'], entry['stderr'])} {entry['unit']}"


def _summary(session: WatchSession) -> None:
    count = {level: sum(one["level"] == level for one in session.verdicts) for level in COLOURS}
    words = {"good": "good", "look": "to look at", "repeat": "to repeat", "refused": "refused"}
    told = ", ".join(f"{number} {words[level]}" for level, number in count.items() if number)
    note(f"{len(session.verdicts)} tests: {told}" if told else "no test was seen")
    for one in session.verdicts:
        if one["level"] in {"repeat", "refused"}:
            note(
                f"  {one['level']}: {one['path']}{'' if one['sheet'] is None else ' [' + one['sheet'] + ']'}"
            )
