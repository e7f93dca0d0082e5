"""Commands on the folder of a fit: ``tissueid status``, ``validate``, ``migrate`` and ``report``."""

from __future__ import annotations

import time
from pathlib import Path

from tissueid.cli.flags import FOLDER_THERE, PATH, THERE, OutputFlags, argument, option, subcommand
from tissueid.cli.output import echo, echo_json, note, progress_bar, tell, write_output
from tissueid.documents import typed
from tissueid.documents.folder import Status
from tissueid.errors import BundleError, refuse

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
def status(flags: _StatusFlags) -> int:
    """Say how far the fit of a folder is: specimens done, rate, time left, failures.

    Reads the index of the folder, at any time and without disturbing a run that writes it.  Exit code 7
    where a specimen failed or an input was refused.
    """
    from tissueid.store.index import read_status

    while True:
        read = read_status(Path(flags.out))
        found = typed(read, Status)
        tell(flags, read, _status_lines(found))
        if not flags.watch or found.state != "running":
            return 7 if found.specimens.failed or found.files.refused else 0
        time.sleep(WATCH_S)


def _status_lines(status: Status) -> list[str]:
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


class _ValidateFlags(OutputFlags):
    targets: tuple[str, ...] = argument(required=True, type=PATH)


@subcommand("validate", "out", "kidney.h5 --json")
def validate(flags: _ValidateFlags) -> int:
    """Check output folders or single bundles: whole, of one run, readable, passive.

    An interrupted refresh is finished first. Exit code 6 where something is wrong.
    """
    from tissueid.store.bundle import load_bundle
    from tissueid.store.results import validate_outputs

    results: list[dict[str, str | bool | None]] = []
    for target in flags.targets:
        if not Path(target).exists():
            refuse(f"{target}: no such file or folder")
        problem = None
        try:
            if Path(target).is_dir():
                validate_outputs(target)
            else:
                load_bundle(target)
        except BundleError as error:
            problem = error.message
        results.append({"path": target, "valid": problem is None, "problem": problem})
    if flags.as_json:
        echo_json(results)
    for one in [] if flags.as_json else results:
        if one["problem"] is not None:
            echo(f"tissueid: {one['problem']}", err=True)
        elif not flags.quiet:
            echo(f"{one['path']}: valid")
    return 0 if all(one["valid"] for one in results) else 6


class _MigrateFlags(OutputFlags):
    targets: tuple[str, ...] = argument(required=True, type=THERE)


@subcommand("migrate", "out", "kidney.h5")
def migrate(flags: _MigrateFlags) -> int:
    """Bring output folders or bundles that an earlier tissueid wrote to the version of this one.

    A file is replaced by its new version once that was read back whole. What is of this version already is
    not touched.
    """
    from tissueid.store.migrate import migrate_bundle, migrate_folder

    targets = map(Path, flags.targets)
    every = (migrate_folder(one) if one.is_dir() else [migrate_bundle(one)] for one in targets)
    found = [one for changed in every for one in changed if one is not None]
    if flags.as_json:
        echo_json([{"path": str(one.path), "from_version": one.version} for one in found])
        return 0
    for one in found:
        note(f"{one.path}: migrated from version {one.version}", quiet=flags.quiet)
    if not found:
        note("everything is of this version already", quiet=flags.quiet)
    return 0


class _ReportFlags(OutputFlags):
    out: str = argument(type=FOLDER_THERE)
    output: str | None = option("File to write instead of OUT/report.html.", "-o", type=PATH)


@subcommand("report", "out", "out -o for-a-colleague.html")
def report(flags: _ReportFlags) -> int:
    """Write the HTML report of a finished fit again, from its output folder alone."""
    with progress_bar(show=not flags.quiet) as progress:
        progress("writing the report", 0, 0)
        target, page = _written(flags.output, Path(flags.out))
    if flags.as_json:
        echo_json({"report": target, "bytes": len(page)})
    else:
        note(f"wrote {target}", quiet=flags.quiet)
    return 0


def _written(target: str | None, out: Path) -> tuple[str, bytes]:
    """Write the report; its place and content."""
    from tissueid.model.grammar import ModelNameError
    from tissueid.store.files import CURVES, REPORT, time_now
    from tissueid.store.outputs import OutputSet
    from tissueid.store.results import committed_fit, read_plain, read_results, read_twin
    from tissueid.study.pages import report_page, write_report

    page, large = b"", CURVES not in committed_fit(out).files
    if large and target is not None:
        msg = f"{out}: the report of a large cohort leads to pages in the same folder; leave out -o"
        raise BundleError(msg)
    if not large:
        _, curves, posteriors = read_results(out)
        twin, created = read_twin(out), time_now()
        try:
            text = report_page(read_plain(out), curves, posteriors, twin=twin, created=created)
        except ModelNameError as error:
            raise BundleError(f"{out}: {error}") from error
        page = text.encode("utf-8")
    if target is not None:
        write_output(target, page)
        return target, page
    with OutputSet(out) as run:
        run.carry_over()
        if large:
            write_report(run)
        else:
            run.write(REPORT, page)
        run.commit()
    return str(out / REPORT), (out / REPORT).read_bytes()
