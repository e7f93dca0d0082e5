"""The recorder: every tick of the ring to a file that a killed process leaves whole.

Records are appended to ``<log>.part`` and become ``<log>`` (HDF5) at the end.  A disk that is full, or any
other failure to write, stops the recording and nothing else: the session goes on, says so and ends with
exit code 7; what was recorded until then is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UsageError
from tissueid.haptics.ring import RECORD
from tissueid.store.session_log import convert_session_log, raw_head

#: Added to the log's name while the session runs.
PART_SUFFIX = ".part"


class Recorder:
    """Writes one log.

    ``path``: of the finished log; ``head``: see ``schemas/session.schema.json``; ``record`` and ``schema``
    are added.  Raises UsageError: the file exists, or can't be written there.
    """

    def __init__(self, path: Path, head: Mapping[str, Any]) -> None:
        self.path = path
        self.part = path.with_name(path.name + PART_SUFFIX)
        #: Records written.
        self.written = 0
        #: Why the recording ended before the session; None while it runs.
        self.stopped: str | None = None
        if path.exists():
            msg = f"{path}: exists already; recordings are not overwritten, choose another name"
            raise UsageError(msg)
        try:
            # no buffer: what was written survives this process
            self._stream = self.part.open("xb", buffering=0)
        except FileExistsError as error:
            msg = (
                f"{self.part}: left by a session that was killed; read it with `tissueid inspect "
                f"{self.part}`, then move it away"
            )
            raise UsageError(msg) from error
        except OSError as error:
            msg = f"{self.part}: can't be written ({error.strerror}); choose another place"
            raise UsageError(msg) from error
        if not self._write(raw_head(head, RECORD)):
            self._close()
            self.part.unlink(missing_ok=True)
            msg = f"{self.stopped}; choose another place for the log"
            raise UsageError(msg)

    def append(self, records: NDArray[Any]) -> None:
        """Append records; after a failure to write nothing more is tried.

        ``records`` (n,).
        """
        if self.stopped is None and records.size and self._write(np.ascontiguousarray(records).tobytes()):
            self.written += records.size

    def finish(self, summary: Mapping[str, Any]) -> Path:
        """Close the log and turn it into HDF5.

        ``summary``: of the session.  Returns where the log is: the HDF5 file, or the part where there was no
        room for it; then :attr:`stopped` says why.
        """
        self._close()
        try:
            convert_session_log(self.part, self.path, {**summary, "recording_stopped": self.stopped})
        except OSError as error:
            self.stopped = self.stopped or f"the log could not be finished: {error.strerror or error}"
            return self.part
        self.part.unlink(missing_ok=True)
        return self.path

    def _write(self, data: bytes) -> bool:
        view = memoryview(data)
        try:
            while view:
                view = view[self._stream.write(view) :]
        except OSError as error:
            self.stopped = f"{self.part}: {error.strerror or error}"
            return False
        return True

    def _close(self) -> None:
        try:
            self._stream.close()
        except OSError as error:
            self.stopped = self.stopped or f"{self.part}: {error.strerror or error}"
