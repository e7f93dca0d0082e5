"""``tissueid validate``."""

from __future__ import annotations

from typing import Any

import click

from tissueid.cli.output import echo, echo_json, output_options

EPILOG = """\b
Examples:
  tissueid validate out
  tissueid validate kidney.h5 --json
"""


@click.command("validate", epilog=EPILOG)
@click.argument("targets", nargs=-1, required=True, type=click.Path())
@output_options
def command(**flags: Any) -> int:
    """Check output folders or single bundles: whole, of one run, readable, passive.

    An interrupted refresh is finished first. Exit code 6 where something is wrong.
    """
    from pathlib import Path

    from tissueid.errors import BundleError, UsageError
    from tissueid.store.bundle import load_bundle
    from tissueid.store.results import validate_outputs

    results = []
    for target in flags["targets"]:
        if not Path(target).exists():
            msg = f"{target}: no such file or folder"
            raise UsageError(msg)
        problem = None
        try:
            if Path(target).is_dir():
                validate_outputs(target)
            else:
                load_bundle(target)
        except BundleError as error:
            problem = error.message
        results.append({"path": str(target), "valid": problem is None, "problem": problem})
    if flags["as_json"]:
        echo_json(results)
    else:
        for one in results:
            if one["valid"] and not flags["quiet"]:
                echo(f"{one['path']}: valid")
            elif not one["valid"]:
                echo(f"tissueid: {one['problem']}", err=True)
    return 0 if all(one["valid"] for one in results) else 6
