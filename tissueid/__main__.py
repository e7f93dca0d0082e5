"""``tissueid`` and ``python -m tissueid``: the command line, guarded from its first import on."""

from __future__ import annotations

import gc
import os
import sys

#: As :data:`tissueid.errors.EXIT_INTERRUPTED`, which is not imported yet where it is needed.
_INTERRUPTED = 130
#: Objects made between two collections of waste; Python's own 700 are for programs that stay small.
_ALLOCATIONS = 50_000


def start() -> None:
    """Run the command line; an interrupt while it is still being loaded ends as quietly as a later one."""
    # what is imported stays: looking through it for waste takes a tenth of the time that imports take
    gc.set_threshold(_ALLOCATIONS)
    try:
        from tissueid.cli.main import run
    except KeyboardInterrupt:
        sys.stderr.write("\ntissueid: interrupted; nothing was begun\n")
        sys.stderr.flush()
        os._exit(_INTERRUPTED)
    run()


if __name__ == "__main__":
    start()
