"""``tissueid report``."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import click

from tissueid.cli.output import echo_json, note, output_options, write_output

EPILOG = """\b
Examples:
  tissueid report out
  tissueid report out -o for-a-colleague.html
"""


@click.command("report", epilog=EPILOG)
@click.argument("out", type=click.Path(exists=True))
@click.option("-o", "--output", type=click.Path(), help="File to write instead of OUT/report.html.")
@output_options
def command(**flags: Any) -> int:
    """Write the HTML report of a finished fit again, from its output folder alone."""
    from pathlib import Path

    from tissueid.errors import BundleError
    from tissueid.store.files import CURVES, REPORT
    from tissueid.store.outputs import OutputSet, current_run
    from tissueid.store.results import read_results
    from tissueid.study.pages import report_page, write_report

    target, out = flags["output"], Path(flags["out"])
    committed = current_run(out)
    large = committed is not None and CURVES not in committed.files
    if target is None and large:
        with OutputSet(out) as run:
            run.carry_over()
            write_report(run)
            run.commit()
        target = out / REPORT
        page = target.read_bytes()
    else:
        if large:
            msg = f"{out}: the report of a large cohort leads to pages in the same folder; leave out -o"
            raise BundleError(msg)
        document, curves, posteriors = read_results(out)
        created = datetime.now(UTC).isoformat(timespec="seconds")
        page = report_page(document, curves, posteriors, created=created).encode("utf-8")
        if target is not None:
            write_output(target, page)
        else:
            with OutputSet(out) as run:
                run.carry_over()
                run.write(REPORT, page)
                run.commit()
            target = str(out / REPORT)
    if flags["as_json"]:
        echo_json({"report": str(target), "bytes": len(page)})
    else:
        note(f"wrote {target}", quiet=flags["quiet"])
    return 0
