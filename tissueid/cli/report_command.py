"""``tissueid report``."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import click

from tissueid.cli.output import echo_json, note, output_options, write_output

__all__ = ["command"]

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

    from tissueid.report import render_report
    from tissueid.store.outputs import OutputSet
    from tissueid.store.results import REPORT, read_results

    document, curves, posteriors = read_results(flags["out"])
    created = datetime.now(UTC).isoformat(timespec="seconds")
    page = render_report(document, curves, posteriors, created=created).encode("utf-8")
    target = flags["output"]
    if target is not None:
        write_output(target, page)
    else:
        with OutputSet(flags["out"]) as run:
            run.carry_over()
            run.write(REPORT, page)
            run.commit()
        target = str(Path(flags["out"]) / REPORT)
    if flags["as_json"]:
        echo_json({"report": str(target), "bytes": len(page)})
    else:
        note(f"wrote {target}", quiet=flags["quiet"])
    return 0
