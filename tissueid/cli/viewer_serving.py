"""The viewer for sub-commands: its options, its address in the terminal, a browser that opens it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.flags import PORT, OutputFlags, option
from tissueid.cli.output import echo, note

if TYPE_CHECKING:
    from tissueid.rendering.recorder import Recorder
    from tissueid.viewer.serving import ServedViewer

_FILE = click.Path(dir_okay=False, path_type=Path)
#: One of these is set where a browser has a screen.
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


class ViewerFlags(OutputFlags):
    """Flags of a viewer's address and audience."""

    # fmt: off
    no_browser: bool = option("Print the viewer's address, open nothing.")
    host: str = option(
        "Serve the viewer to other machines, with a token in its address.",
        metavar="ADDRESS", default="127.0.0.1",
    )
    viewer_port: int | None = option("Of the viewer. [default: 8765, or a free one]", type=PORT, metavar="N")
    certificate: Path | None = option("Serve the viewer by TLS ...", metavar="FILE")
    certificate_key: Path | None = option("... with this key.", metavar="FILE")
    # fmt: on


@contextmanager
def served(flags: ViewerFlags) -> Iterator[ServedViewer]:
    """A viewer that is served from now on; its address is printed."""
    from tissueid.viewer.bundling import BUNDLE
    from tissueid.viewer.serving import ServedViewer, ViewerOptions

    options = ViewerOptions(flags.host, flags.viewer_port, flags.certificate, flags.certificate_key)
    with ServedViewer(options) as viewer:
        # what was asked for is told however quiet: nobody guesses a token
        echo(f"viewer     {viewer.url}", err=True)
        if viewer.access.token is not None and not viewer.access.tls:
            note(
                "the picture goes over the network unencrypted: --certificate and --certificate-key "
                "encrypt it",
                quiet=flags.quiet,
            )
        if not (BUNDLE / "index.html").is_file():
            note("the viewer's page was not built here: `python -m tissueid.viewer.bundling` builds it")
        elif not flags.no_browser:
            open_browser(viewer.url)
        yield viewer


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
