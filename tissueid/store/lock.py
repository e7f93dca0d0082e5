"""One writer at a time in an output folder.

The lock is the operating system's (``flock``, or ``msvcrt.locking`` on Windows) on the file ``.lock``,
so it vanishes with the process that held it, however that died: there are no stale locks to judge by
process numbers, which systems use again.  The file's text names the holder for the message.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from tissueid.errors import BundleError

LOCK_NAME = ".lock"

# One byte far behind the text is locked: Windows forbids others to read a locked range
_LOCKED_BYTE = 1 << 20
_BUSY = {errno.EACCES, errno.EAGAIN, errno.EWOULDBLOCK, errno.EDEADLK}
_POLL_S = 0.05


def _try_lock(stream: IO[bytes]) -> bool:
    """Take the lock if it is free; ``False`` where another holds it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            stream.seek(_LOCKED_BYTE)
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            try:
                from fcntl import LOCK_EX, LOCK_NB, flock
            except ModuleNotFoundError:  # a build of Python without it: locks of the process
                os.lockf(stream.fileno(), os.F_TLOCK, 1)
            else:
                flock(stream, LOCK_EX | LOCK_NB)
    except OSError as error:
        if error.errno in _BUSY:
            return False
        raise
    return True


class FolderLock:
    """A context in which this process alone writes into a folder.

    ``folder``: must exist; ``wait_s``: how long to wait for another writer [s]; 0 refuses at once.  Raises
    BundleError: on entering, where another process holds the lock or the file system knows no locks.
    """

    def __init__(self, folder: Path, *, wait_s: float = 0.0) -> None:
        self._path = folder / LOCK_NAME
        self._wait_s = wait_s
        self._stream: IO[bytes] | None = None

    def __enter__(self) -> Self:
        deadline = time.monotonic() + self._wait_s
        try:
            stream = self._path.open("ab+")
        except OSError as error:
            msg = f"{self._path.parent}: can't be written to ({error.strerror}); choose another output folder"
            raise BundleError(msg) from error
        try:
            locked = _try_lock(stream)
            while not locked and time.monotonic() < deadline:
                time.sleep(_POLL_S)
                locked = _try_lock(stream)
        except OSError as error:
            stream.close()
            msg = (
                f"{self._path.parent}: this file system can't lock files ({error.strerror}); "
                "write to a local folder and copy the result"
            )
            raise BundleError(msg) from error
        if not locked:
            stream.close()
            raise BundleError(self._busy_message())
        holder = json.dumps({"pid": os.getpid(), "host": platform.node()}).encode()
        stream.truncate(0)
        stream.write(holder)
        stream.flush()
        self._stream = stream
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._stream is not None:
            # closing gives the lock back; the file stays, since deleting it would race with the next writer
            self._stream.truncate(0)
            self._stream.close()
            self._stream = None

    def _busy_message(self) -> str:
        try:
            holder = json.loads(self._path.read_bytes())
            who = f"process {holder['pid']} on {holder['host']}"
        except (OSError, ValueError, KeyError, TypeError):
            who = "another process"
        return f"{self._path.parent}: {who} is writing here; wait for it to end or choose another folder"
