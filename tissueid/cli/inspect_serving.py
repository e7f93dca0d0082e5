"""``tissueid inspect --serve``: the page on this machine, and study.toml by what is decided on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissueid.cli.output import echo, note
from tissueid.cli.reading import read_options

#: Flags that ask for another output than the page.
_OTHERS = {"as_json": "--json", "html": "--html", "csv": "--csv", "xlsx": "--xlsx", "no_study": "--no-study"}

if TYPE_CHECKING:
    from tissueid.cli.inspect_command import InspectFlags


def serve(flags: InspectFlags, inspected: Callable[[InspectFlags], Any]) -> int:
    """Serve until Ctrl-C what is inspected again after each correction.

    Raises UsageError: another output is asked for too, the study file named is none, or the port is taken.
    """
    from tissueid.cli.viewer_serving import open_browser
    from tissueid.errors import UsageError
    from tissueid.study.corrections import CorrectedInspection
    from tissueid.viewer.page_server import PageServer

    other = next((flag for name, flag in _OTHERS.items() if getattr(flags, name)), None)
    if other is not None:
        msg = f"--serve writes study.toml and shows its page: leave {other} out"
        raise UsageError(msg)
    manifest = _manifest(flags)

    def inspect() -> Any:
        return inspected(replace(flags, study=str(manifest)) if manifest.exists() else flags)

    shown = CorrectedInspection(manifest, inspect, read_options(flags))
    shown.page()
    try:
        with PageServer(shown, flags.viewer_port) as server:
            # what was asked for is told however quiet: nobody guesses a token
            echo(f"page       {server.url}", err=True)
            folder = manifest.parent
            note(
                f"corrections go into {manifest}; `tissueid fit {folder}` follows it; Ctrl-C ends",
                quiet=flags.quiet,
            )
            if not flags.no_browser:
                open_browser(server.url)
            server.run()
    except KeyboardInterrupt:
        pass
    return 0


def _manifest(flags: InspectFlags) -> Path:
    """The study file that is followed and written."""
    from tissueid.ingest.manifest import MANIFEST
    from tissueid.study.inspected import study_folder

    if flags.study is not None:
        named = Path(flags.study)
        return named / MANIFEST if named.is_dir() else named
    stated = [Path(path) for path in flags.paths if path.casefold().endswith(".toml")]
    return stated[0] if stated else study_folder(flags.paths) / MANIFEST
