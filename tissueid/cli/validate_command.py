"""``tissueid validate``."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from tissueid.cli.flags import PATH, OutputFlags, argument, subcommand
from tissueid.cli.output import echo, echo_json

EXAMPLES = """
tissueid validate out
tissueid validate kidney.h5 --json
"""


@dataclass(frozen=True, slots=True)
class Validated:
    """A target, and what is wrong with it."""

    path: str
    valid: bool
    problem: str | None


class _ValidateFlags(OutputFlags):
    targets: tuple[str, ...] = argument(required=True, type=PATH)


@subcommand("validate", EXAMPLES)
def command(flags: _ValidateFlags) -> int:
    """Check output folders or single bundles: whole, of one run, readable, passive.

    An interrupted refresh is finished first. Exit code 6 where something is wrong.
    """
    from pathlib import Path

    from tissueid.errors import BundleError, UsageError
    from tissueid.store.bundle import load_bundle
    from tissueid.store.results import validate_outputs

    results: list[Validated] = []
    for target in flags.targets:
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
        results.append(Validated(str(target), problem is None, problem))
    if flags.as_json:
        echo_json([asdict(one) for one in results])
    else:
        for one in results:
            if one.valid and not flags.quiet:
                echo(f"{one.path}: valid")
            elif not one.valid:
                echo(f"tissueid: {one.problem}", err=True)
    return 0 if all(one.valid for one in results) else 6
