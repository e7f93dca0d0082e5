"""``tissueid view``: a recorded session, or one that runs elsewhere, in a browser."""

from __future__ import annotations

from pathlib import Path

import click

from tissueid.cli.flags import argument, option, subcommand
from tissueid.cli.output import echo, note
from tissueid.cli.viewer_serving import ViewerFlags, open_browser, served
from tissueid.errors import UsageError

EXAMPLES = """
tissueid view out.h5
tissueid view out/twin/felt.h5 --beside hold-8-1.csv
tissueid view 192.0.2.7:8765 --token ABC
"""


class _ViewFlags(ViewerFlags):
    # fmt: off
    what: str = argument(metavar="LOG|HOST:PORT")
    beside: Path | None = option(
        "A test machine's recording, drawn beside the LOG from contact on.",
        type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="RECORDING",
    )
    token: str | None = option("Of the session elsewhere, as its terminal shows it.", metavar="TEXT")
    # fmt: on


@subcommand("view", EXAMPLES)
def command(flags: _ViewFlags) -> int:
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


def _play(flags: _ViewFlags, path: Path) -> int:
    """Serve a log until Ctrl-C."""
    from tissueid.errors import DeviceError
    from tissueid.viewer.showing import check_log, recording_beside, show_log

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


def _open_elsewhere(flags: _ViewFlags, what: str) -> int:
    """Open the page of a session that is served already, once it answers."""
    from tissueid.viewer.serving import reach

    url = reach(what, flags.token)
    echo(f"viewer     {url}", err=True)
    if not flags.no_browser:
        open_browser(url)
    return 0
