"""Number of processors a computation may take: one of several processes that compute takes one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

_shared = False


def threads(most: int) -> int:
    """Threads that a computation may start.

    ``most``: more would not help it.
    """
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
