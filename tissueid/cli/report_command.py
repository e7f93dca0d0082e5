"""``tissueid report``."""

from __future__ import annotations

from pathlib import Path

from tissueid.cli.flags import PATH, THERE, OutputFlags, argument, option, subcommand
from tissueid.cli.output import echo_json, note, progress_bar, write_output
from tissueid.errors import BundleError


class _ReportFlags(OutputFlags):
    out: str = argument(type=THERE)
    output: str | None = option("File to write instead of OUT/report.html.", "-o", type=PATH)


@subcommand("report", "out", "out -o for-a-colleague.html")
def command(flags: _ReportFlags) -> int:
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
    from tissueid.store.outputs import OutputSet, current_run
    from tissueid.store.results import read_plain, read_results, read_twin
    from tissueid.study.pages import report_page, write_report

    page, committed = b"", current_run(out)
    large = committed is not None and CURVES not in committed.files
    if large and target is not None:
        msg = f"{out}: the report of a large cohort leads to pages in the same folder; leave out -o"
        raise BundleError(msg)
    if not large:
        _, curves, posteriors = read_results(out)
        twin, created = read_twin(out), time_now()
        try:
            text = report_page(read_plain(out), curves, posteriors, twin=twin, created=created)
        except ModelNameError as error:
            msg = f"{out}: {error}"
            raise BundleError(msg) from error
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
