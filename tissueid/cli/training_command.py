"""``tissueid training``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from msgspec.structs import asdict

from tissueid.cli.flags import ABOVE_0, FILE, THERE, OutputFlags, argument, option, subcommand
from tissueid.cli.output import note, tell, write_output
from tissueid.documents import plain
from tissueid.documents.session import Attempt, Learning, Refused, Training
from tissueid.errors import BundleError, exit_code, refuse

#: Measures that practice is looked for in, with their words.
LEARNED: Mapping[Literal["end_error_mm", "angle_deg", "seconds"], str] = {
    "end_error_mm": "end error",
    "angle_deg": "angle",
    "seconds": "time",
}


class _TrainingFlags(OutputFlags):
    logs: tuple[str, ...] = argument(required=True, type=THERE)
    cone_entry: float = option(
        "Height above the bone at which an attempt begins.", type=ABOVE_0, default=40.0, metavar="MM"
    )
    html: str | None = option(
        "Write a page of attempts, their ways, and how practice changed them.", type=FILE
    )


@subcommand("training", "hip-*.h5", "sessions/ --json", "P17-*.h5 --cone-entry 30 --html P17.html")
def command(flags: _TrainingFlags) -> int:
    """Measure guided sessions: error, angle of the track, time, path, force, smoothness, learning.

    LOGS are logs of `tissueid render --scene hip-resurfacing`, or folders of them. A Falcon knows no
    orientation: the angle is that of the chord from the cone's entry to the end of the drilling. Exit code 7
    where a log holds no attempt. For research: no number here says that somebody may operate.
    """
    document, tracks = _measured(flags)
    if not document.attempts and not document.refused:
        refuse("there is no session log (.h5) in what was given; record one with tissueid render --log FILE")
    if flags.html is not None:
        from tissueid.report.training_page import render_training

        write_output(flags.html, render_training(document, tracks).encode(), quiet=flags.quiet)
    tell(flags, plain(document), _lines(document))
    for one in document.refused:
        note(f"{one.file}: {one.reason}")
    return exit_code({7} if document.refused else set())


def _measured(flags: _TrainingFlags) -> tuple[Training, dict[str, Any]]:
    """The document, and the ways of attempts where a page is wanted."""
    from tissueid.store.session_log import read_session_log
    from tissueid.training import measured, track

    rows: list[Attempt] = []
    refused: list[Refused] = []
    tracks: dict[str, Any] = {}
    given = map(Path, flags.logs)
    for path in (file for one in given for file in (sorted(one.glob("*.h5")) if one.is_dir() else [one])):
        try:
            log = read_session_log(path)
            found = measured(log.head, log.records, cone_entry_mm=flags.cone_entry)
        except (BundleError, ValueError) as error:
            reason = getattr(error, "message", str(error)).removeprefix(f"{path}: ")
            refused.append(Refused(str(path), reason))
            continue
        if flags.html is not None:
            way = track(log.head, log.records, cone_entry_mm=flags.cone_entry)
            tracks[str(path)] = [one.tolist() for one in way]
        about = {"file": str(path), "pseudonym": log.head["pseudonym"], "started": log.head["started"]}
        rows.append(Attempt(**asdict(found), **about))
    rows.sort(key=lambda row: (row.pseudonym or "", row.started, row.file))
    return Training(
        "tissueid/training/1", flags.cone_entry, tuple(rows), tuple(_learning(rows)), tuple(refused)
    ), tracks


def _learning(rows: Sequence[Attempt]) -> Iterator[Learning]:
    """A curve for each person and measure, where there are attempts enough."""
    from tissueid.training import learning_curve

    for who in dict.fromkeys(row.pseudonym for row in rows):
        own = [row for row in rows if row.pseudonym == who]
        for measure in LEARNED:
            curve = learning_curve([getattr(row, measure) for row in own])
            if curve is not None:
                yield Learning(**asdict(curve), pseudonym=who, measure=measure)


def _lines(document: Training) -> list[str]:
    head = (
        f"{'who':<8}{'started':<21}{'end error':>10}{'angle':>16}{'time':>9}{'path':>7}{'peak':>8}{'jerk':>7}"
    )
    lines = [head] if document.attempts else []
    for row in document.attempts:
        jerk = "-" if row.log_jerk is None else f"{row.log_jerk:.1f}"
        lines.append(
            f"{row.pseudonym or '-':<8}{row.started[:19]:<21}{row.end_error_mm:>7.2f} mm"
            f"{row.angle_deg:>7.2f} \u00b1 {row.angle_se_deg:.2f} deg{row.seconds:>7.1f} s"
            f"{row.path_over_chord:>7.2f}{row.peak_force_N:>6.2f} N{jerk:>7}"
            + ("" if row.complete else "  not through")
        )
    return lines + [
        f"{curve.pseudonym or 'all'}: {LEARNED[curve.measure]} goes with attempt^"
        f"{curve.exponent:.2f} \u00b1 {curve.exponent_se:.2f} from {curve.first:.3g} at the first "
        f"of {curve.attempts}"
        for curve in document.learning
    ]
