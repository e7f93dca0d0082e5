"""``tissueid view``: a recorded session, or one that runs elsewhere, in a browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

from tissueid.cli.flags import argument, option, takes
from tissueid.cli.output import echo, note
from tissueid.cli.viewer_serving import ViewerFlags, open_browser, served
from tissueid.errors import UsageError

EPILOG = """\b
Examples:
  tissueid view out.h5
  tissueid view out/twin/felt.h5 --beside hold-8-1.csv
  tissueid view 192.0.2.7:8765 --token ABC
"""


@dataclass(frozen=True, kw_only=True)
class ViewFlags(ViewerFlags):
    """Flags of ``tissueid view``."""

    # fmt: off
    what: str = argument(metavar="LOG|HOST:PORT")
    beside: Path | None = option(
        "--beside", type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="RECORDING",
        help="A test machine's recording, drawn beside the LOG from contact on.",
    )
    token: str | None = option(
        "--token", metavar="TEXT", help="Of the session elsewhere, as its terminal shows it.",
    )
    # fmt: on


@click.command("view", epilog=EPILOG)
@takes(ViewFlags)
def command(flags: ViewFlags) -> int:
    """Look at a recorded LOG, or at the session that HOST:PORT serves.

    A log is played as it was felt; the session elsewhere must have been started with --viewer and --host.
    """
    what = str(flags.what)
    if Path(what).exists() or not _is_address(what):
        return _play(flags, Path(what))
    if flags.beside is not None:
        msg = "--beside is for a LOG: a session elsewhere is watched as it goes"
        raise UsageError(msg)
    return _open_elsewhere(flags, what)


def _is_address(text: str) -> bool:
    _, colon, port = text.removeprefix("http://").removeprefix("https://").partition("/")[0].rpartition(":")
    return bool(colon) and port.isascii() and port.isdigit()


def _play(flags: ViewFlags, path: Path) -> int:
    """Serve a log until Ctrl-C."""
    from tissueid.errors import DeviceError
    from tissueid.viewer.hello import check_log, recording_beside, show_log

    log = check_log(path)
    beside = None if flags.beside is None else recording_beside(log, flags.beside)
    try:
        with served(flags) as viewer:
            show_log(viewer, log, path, beside)
            note("Ctrl-C: end", quiet=flags.quiet)
            viewer.wait()
    except KeyboardInterrupt:
        return 0
    # it ends with us; before us only where something took it away
    msg = "the viewer's server ended by itself"
    raise DeviceError(msg)


def _open_elsewhere(flags: ViewFlags, what: str) -> int:
    """Open the page of a session that is served already, once it answers."""
    from tissueid.viewer.serving import reach

    url = reach(what, flags.token)
    echo(f"viewer     {url}", err=True)
    if not flags.no_browser:
        open_browser(url)
    return 0
