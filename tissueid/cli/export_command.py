"""``tissueid export``."""

from __future__ import annotations

from typing import Any

import click

from tissueid.cli.output import echo_json, note, output_options, write_output

__all__ = ["command"]

EPILOG = """\b
Examples:
  tissueid export out
  tissueid export out --format json -o result.json
"""


@click.command("export", epilog=EPILOG)
@click.argument("out", type=click.Path(exists=True))
@click.option("--format", "form", type=click.Choice(["json"]), default="json", show_default=True)
@click.option("-o", "--output", type=click.Path(), help="File to write instead of stdout.")
@output_options
def command(**flags: Any) -> int:
    """Write a finished fit in another format, from its output folder alone."""
    from tissueid.store.files import json_bytes
    from tissueid.store.results import read_results

    document, _ = read_results(flags["out"])
    if flags["output"] is None:
        echo_json(document)
    else:
        write_output(flags["output"], json_bytes(document))
        note(f"wrote {flags['output']}", quiet=flags["quiet"])
    return 0
