"""``tissueid`` and ``python -m tissueid``: the command line, guarded from its first import on."""

from __future__ import annotations

import os
import sys

#: As :data:`tissueid.errors.EXIT_INTERRUPTED`, which is not imported yet where it is needed.
_INTERRUPTED = 130


def start() -> None:
    """Run the command line; an interrupt while it is still being loaded ends as quietly as a later one."""
    try:
        from tissueid.cli.main import run
    except KeyboardInterrupt:
        sys.stderr.write("\ntissueid: interrupted; nothing was begun\n")
        sys.stderr.flush()
        os._exit(_INTERRUPTED)
    run()


if __name__ == "__main__":
    start()
