"""Processes of our own: they run the same files as the one that starts them; how many may compute.

``python -m`` puts the folder one stands in before everything installed: beside a checkout another guard would
run than the one the session's owner checked, and a loop would be compiled where nobody looks for it.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import connection, parent_process
from pathlib import Path


def own_process(module: str, *arguments: str) -> list[str]:
    """Command line of a new process of this interpreter that runs a module from where ours come from."""
    places = [place or str(Path.cwd()) for place in sys.path]
    code = (
        f"import runpy, sys; sys.path[:] = {places!r}; "
        f"runpy.run_module({module!r}, run_name='__main__', alter_sys=True)"
    )
    return [sys.executable, "-P", "-c", code, *arguments]


def end_with_parent() -> None:
    """Let this process of :mod:`multiprocessing` end when the one that started it does, however that ended.

    A worker that waits for its next task hears nothing of a parent that was killed: workers hold each other's
    ends of the pipes.
    """
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
    os._exit(1)


_shared = False


def threads(most: int) -> int:
    """Threads that a computation may start."""
    return 1 if _shared else max(min(os.cpu_count() or 1, most), 1)


@contextmanager
def one_processor() -> Iterator[None]:
    """Threads are not started in here: others compute on the other processors, or shall be compared with."""
    global _shared
    before, _shared = _shared, True
    try:
        yield
    finally:
        _shared = before
