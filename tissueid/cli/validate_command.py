"""``tissueid validate``."""

from __future__ import annotations

from pathlib import Path

from tissueid.cli.flags import PATH, OutputFlags, argument, subcommand
from tissueid.cli.output import echo, echo_json
from tissueid.errors import BundleError, refuse


class _ValidateFlags(OutputFlags):
    targets: tuple[str, ...] = argument(required=True, type=PATH)


@subcommand("validate", "out", "kidney.h5 --json")
def command(flags: _ValidateFlags) -> int:
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
