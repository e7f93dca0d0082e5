"""Importance draws on their way, in a file that a killed run goes on from."""

from __future__ import annotations

import contextlib
import io
import json
import time
import zipfile
from pathlib import Path

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.store.files import write_file

#: Seconds between two writes.
EVERY_S = 1.0


class Checkpoint:
    """Points and weights so far in one file, written apart and renamed.

    ``path``: ``None`` keeps nothing; ``key``: of everything the draws depend on; a file with another key is
    not used.
    """

    def __init__(self, path: Path | None, key: str) -> None:
        self.path, self.key = path, key
        self._last = time.monotonic()

    def resume(self, rng: np.random.Generator, size: int) -> tuple[FloatArray, FloatArray]:
        """Points and their log weights so far; the generator stands where it stood."""
        nothing = np.empty((0, size)), np.empty(0)
        if self.path is None or not self.path.is_file():
            return nothing
        try:
            with np.load(io.BytesIO(self.path.read_bytes()), allow_pickle=False) as found:
                if str(found["key"]) != self.key or found["points"].shape[1] != size:
                    return nothing
                state = json.loads(str(found["generator"]))
                points, log_weight = found["points"], found["log_weight"]
        except (OSError, ValueError, KeyError, TypeError, IndexError, EOFError, zipfile.BadZipFile):
            return nothing
        rng.bit_generator.state = state
        return points, log_weight

    def write(self, rng: np.random.Generator, points: FloatArray, log_weight: FloatArray) -> None:
        """Keep what there is, once in a while; a disk that is full or read-only stops nothing."""
        if self.path is None or time.monotonic() - self._last < EVERY_S:
            return
        buffer = io.BytesIO()
        np.savez(
            buffer,
            key=np.array(self.key),
            generator=np.array(json.dumps(rng.bit_generator.state)),
            points=points,
            log_weight=log_weight,
        )
        # without the file a run that is killed begins anew
        with contextlib.suppress(OSError):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_file(self.path, buffer.getvalue())
        self._last = time.monotonic()
