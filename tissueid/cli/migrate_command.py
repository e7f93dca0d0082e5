"""``tissueid migrate``."""

from __future__ import annotations

from pathlib import Path

from tissueid.cli.flags import THERE, OutputFlags, argument, subcommand
from tissueid.cli.output import echo_json, note


class _MigrateFlags(OutputFlags):
    targets: tuple[str, ...] = argument(required=True, type=THERE)


@subcommand("migrate", "out", "kidney.h5")
def command(flags: _MigrateFlags) -> int:
    """Bring output folders or bundles that an earlier tissueid wrote to the version of this one.

    A file is replaced by its new version once that was read back whole. What is of this version already is
    not touched.
    """
    from tissueid.store.migrate import migrate_bundle, migrate_folder

    found = []
    for target in map(Path, flags.targets):
        if target.is_dir():
            found += migrate_folder(target)
        else:
            one = migrate_bundle(target)
            found += [] if one is None else [one]
    if flags.as_json:
        echo_json([{"path": str(one.path), "from_version": one.version} for one in found])
        return 0
    for one in found:
        note(f"{one.path}: migrated from version {one.version}", quiet=flags.quiet)
    if not found:
        note("everything is of this version already", quiet=flags.quiet)
    return 0
