"""``tissueid view``: a recorded session, or one that runs elsewhere, in a browser; serving a viewer."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissueid.cli.flags import FILE_THERE, PORT, OutputFlags, argument, option, subcommand
from tissueid.cli.output import echo, note
from tissueid.errors import DeviceError, refuse

if TYPE_CHECKING:
    from tissueid.rendering.recorder import Recorder
    from tissueid.viewer.serving import ServedViewer


class ViewerFlags(OutputFlags):
    """Flags of a viewer's address and audience."""

    no_browser: bool = option("Print the viewer's address, open nothing.")
    host: str = option(
        "Serve the viewer to other machines, with a token in its address.",
        metavar="ADDRESS",
        default="127.0.0.1",
    )
    viewer_port: int | None = option("Of the viewer. [default: 8765, or a free one]", type=PORT, metavar="N")
    certificate: Path | None = option("Serve the viewer by TLS ...")
    certificate_key: Path | None = option("... with this key.")


class _ViewFlags(ViewerFlags):
    what: str = argument(metavar="LOG|HOST:PORT")
    beside: Path | None = option(
        "A test machine's recording, drawn beside the LOG from contact on.",
        type=FILE_THERE,
        metavar="RECORDING",
    )
    token: str | None = option("Of the session elsewhere, as its terminal shows it.")


@subcommand("view", "out.h5", "out/twin/felt.h5 --beside hold-8-1.csv", "192.0.2.7:8765 --token ABC")
def command(flags: _ViewFlags) -> int:
    """Look at a recorded LOG, or at the session that HOST:PORT serves.

    A log is played as it was felt; the session elsewhere must have been started with --viewer and --host.
    """
    if Path(flags.what).exists() or not _is_address(flags.what):
        return _play(flags, Path(flags.what))
    if flags.beside is not None:
        refuse("--beside is for a LOG: a session elsewhere is watched as it goes")
    from tissueid.viewer.serving import reach

    # served already: the page is opened once it answers
    url = reach(flags.what, flags.token)
    echo(f"viewer     {url}", err=True)
    if not flags.no_browser:
        open_browser(url)
    return 0


def _is_address(text: str) -> bool:
    _, colon, port = text.removeprefix("http://").removeprefix("https://").partition("/")[0].rpartition(":")
    return bool(colon) and port.isascii() and port.isdigit()


def _play(flags: _ViewFlags, path: Path) -> int:
    """Serve a log until Ctrl-C."""
    from tissueid.viewer.hello import check_log, recording_beside, show_log

    log = check_log(path)
    beside = None if flags.beside is None else recording_beside(log, flags.beside)
    try:
        with served(flags) as viewer:
            announce(viewer, flags)
            show_log(viewer, log, path, beside)
            note("Ctrl-C: end", quiet=flags.quiet)
            viewer.wait()
    except KeyboardInterrupt:
        return 0
    # it ends with us; before us only where something took it away
    raise DeviceError("the viewer's server ended by itself")


#: One of these is set where a browser has a screen.
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


def served(flags: ViewerFlags) -> ServedViewer:
    """A viewer that is served from now on."""
    from tissueid.viewer.serving import ServedViewer, ViewerOptions

    return ServedViewer(
        ViewerOptions(flags.host, flags.viewer_port, flags.certificate, flags.certificate_key)
    )


def announce(viewer: ServedViewer, flags: ViewerFlags) -> None:
    """Print the address, and open it."""
    from tissueid.viewer.bundling import BUNDLE

    # what was asked for is told however quiet: nobody guesses a token
    echo(f"viewer     {viewer.url}", err=True)
    if viewer.access.token is not None and not viewer.access.tls:
        note(
            "the picture goes over the network unencrypted: --certificate and --certificate-key encrypt it",
            quiet=flags.quiet,
        )
    if not (BUNDLE / "index.html").is_file():
        note("the viewer's page was not built here: `python -m tissueid.viewer.bundling` builds it")
    elif not flags.no_browser:
        open_browser(viewer.url)


def telling_stop(
    viewer: ServedViewer | None, recorder: Recorder | None, show: Callable[[Any, Any], None]
) -> Callable[[Any, Any], None]:
    """Callback that shows a record, tends the viewer, and says there too that a recording has stopped."""
    told = False

    def shown(record: Any, summary: Any) -> None:
        nonlocal told
        show(record, summary)
        if viewer is not None and viewer.tend():
            note("the viewer has ended; the session goes on unseen, its hand is let go")
        if viewer is not None and recorder is not None and recorder.stopped is not None and not told:
            told = True
            viewer.tell(recording_stopped=recorder.stopped)

    return shown


def open_browser(url: str) -> None:
    """Open the user's browser, where there is a screen for it."""
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in SCREENS):
        return
    import webbrowser

    webbrowser.open(url)
