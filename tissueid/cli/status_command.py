"""``tissueid status``."""

from __future__ import annotations

import time
from pathlib import Path

from tissueid.cli.flags import FOLDER_THERE, OutputFlags, argument, option, subcommand
from tissueid.cli.output import tell
from tissueid.documents import typed
from tissueid.documents.folder import Status

#: Time between two looks [s].
WATCH_S = 2.0
STATES = {
    "running": "running",
    "finished": "finished",
    "interrupted": "interrupted; the same command goes on",
    "stopped": "stopped without an end; the same command goes on",
    "failed": "ended by an error; the same command goes on",
}


class _StatusFlags(OutputFlags):
    out: str = argument(type=FOLDER_THERE)
    watch: bool = option("Look again every two seconds until the run ends.")


@subcommand("status", "out", "out --watch", "out --json")
def command(flags: _StatusFlags) -> int:
    """Say how far the fit of a folder is: specimens done, rate, time left, failures.

    Reads the index of the folder, at any time and without disturbing a run that writes it.  Exit code 7
    where a specimen failed or an input was refused.
    """
    from tissueid.store.index import read_status

    while True:
        read = read_status(Path(flags.out))
        status = typed(read, Status)
        tell(flags, read, _lines(status))
        if not flags.watch or status.state != "running":
            return 7 if status.specimens.failed or status.files.refused else 0
        time.sleep(WATCH_S)


def _lines(status: Status) -> list[str]:
    """The status in words."""
    specimens, files = status.specimens, status.files
    said = STATES[status.state]
    if status.writer is not None:
        said += f" by process {status.writer.pid} on {status.writer.host}"
    lines = [said if status.reason is None else f"{said}: {status.reason}"]
    if files.looked_into < files.total:
        lines.append(f"files      {files.looked_into} of {files.total} looked into")
    known = f", {specimens.known_before} of them known before" if specimens.known_before else ""
    lines.append(f"specimens  {specimens.done} of {specimens.total} done{known}")
    if status.specimens_per_minute is not None:
        left = status.left_s
        ending = "" if left is None else f", {_time(left)} left"
        lines.append(f"rate       {status.specimens_per_minute:.3g} a minute{ending}")
    lines += [f"running    {row.specimen} for {_time(row.seconds)} ({row.worker})" for row in status.running]
    lines += [f"failed     {row.specimen}: {row.reason}" for row in status.failures]
    lines += [f"refused    {said}" for said in status.refusals]
    more = files.refused - len(status.refusals)
    return lines if not more else [*lines, f"refused    {more} more: identification.json has them all"]


def _time(seconds: float) -> str:
    """A span as a person says it: ``1 h 40 min``."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"
