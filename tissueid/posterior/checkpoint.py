"""A chain on disk while it is sampled, so that a killed run goes on where it was.

One file holds the walkers' path so far, the proposal that was learnt and the state of the random numbers.
It is written whole beside its name and moved over it, about once a second; what came after the last write is
sampled again, from the same random numbers, and comes out the same.  The file says what it belongs to
(a hash of data, options, seed and versions): one of another run is not used and replaced.
"""

from __future__ import annotations

import hashlib
import io
import time
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.store.files import TEMPORARY_PREFIX, write_file

__all__ = ["Checkpoint", "SavedWalk", "discard"]

FloatArray = NDArray[np.float64]

#: Between two writes [s]: what a kill costs at most, beside the warm-up.
_INTERVAL_S = 1.0

#: Writing takes at most this share of the time: after a slow write the next one waits longer.
_SHARE_OF_TIME = 0.05

#: What numpy and zipfile raise on a file that is cut, overwritten or of another kind.
_DAMAGED = (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, NotImplementedError)


@dataclass(frozen=True, slots=True, eq=False)
class SavedWalk:
    """All that a walk needs to go on.

    Attributes
    ----------
    points : ndarray, shape (steps, walkers, d)
        The path; the last step is where it goes on.
    log_density : ndarray, shape (steps, walkers)
    centre, root : ndarray, shape (d,) and (d, d)
        The independence proposal.
    random_state : tuple
        Of numpy's ``RandomState`` after the last step.
    """

    points: FloatArray
    log_density: FloatArray
    centre: FloatArray
    root: FloatArray
    random_state: tuple[Any, ...]


class Checkpoint:
    """The file of one walk.

    Parameters
    ----------
    path : Path or None
        ``None`` writes and reads nothing.
    identity : str
        Whatever makes two walks the same.
    interval_s : float
        Between two writes [s].
    """

    def __init__(self, path: Path | None, identity: str, *, interval_s: float = _INTERVAL_S) -> None:
        self.path = path
        self.written = False
        self.remark: str | None = None
        self._identity = hashlib.sha256(identity.encode()).hexdigest()
        self._interval = interval_s
        self._due = time.monotonic() + interval_s

    def load(self) -> SavedWalk | None:
        """Read the walk of this identity; ``None`` where there is none that can be used.

        A file that can't be read leaves a sentence in :attr:`remark`.
        """
        if self.path is None or not self.path.is_file():
            return None
        try:
            with np.load(io.BytesIO(self.path.read_bytes()), allow_pickle=False) as file:
                if str(file["identity"]) != self._identity:
                    return None
                walk = _walk_of({name: np.asarray(file[name]) for name in file.files})
        except _DAMAGED as error:
            self.remark = (
                f"{self.path}: the interrupted chain can't be read ({error}); sampled from its start"
            )
            return None
        self.written = True
        return walk

    @property
    def due(self) -> bool:
        """Whether it is time to write."""
        return self.path is not None and time.monotonic() >= self._due

    def save(self, walk: SavedWalk) -> None:
        """Write the walk, whole or not at all.

        A disk that is full or read-only does not stop a chain: it leaves a sentence in :attr:`remark`, and
        the next write tries again.
        """
        if self.path is None:
            return
        began = time.monotonic()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_file(self.path, self._bytes(walk))
            self.written = True
        except OSError as error:
            self.remark = f"{self.path}: the chain can't be kept for a resumed run ({error})"
        now = time.monotonic()
        self._due = now + max(self._interval, (now - began) / _SHARE_OF_TIME)

    def _bytes(self, walk: SavedWalk) -> bytes:
        kind, keys, position, has_gauss, gauss = walk.random_state
        stream = io.BytesIO()
        np.savez(
            stream,
            identity=np.array(self._identity),
            points=walk.points,
            log_density=walk.log_density,
            centre=walk.centre,
            root=walk.root,
            random_kind=np.array(kind),
            random_keys=np.asarray(keys),
            random_counts=np.array([position, has_gauss]),
            random_gauss=np.array(gauss),
        )
        return stream.getvalue()


def discard(path: Path) -> None:
    """Remove a checkpoint that is no longer needed, and its folder where nothing else is in it.

    Parameters
    ----------
    path : Path
        May be missing.
    """
    path.unlink(missing_ok=True)
    path.with_name(TEMPORARY_PREFIX + path.name).unlink(missing_ok=True)
    if path.parent.is_dir() and not any(path.parent.iterdir()):
        path.parent.rmdir()


def _walk_of(arrays: dict[str, NDArray[Any]]) -> SavedWalk:
    points, log_density = arrays["points"], arrays["log_density"]
    steps, walkers, size = points.shape
    shapes = (log_density.shape, arrays["centre"].shape, arrays["root"].shape)
    if steps < 1 or shapes != ((steps, walkers), (size,), (size, size)):
        msg = "its arrays do not fit together"
        raise ValueError(msg)
    position, has_gauss = (int(count) for count in arrays["random_counts"])
    state = (
        str(arrays["random_kind"]),
        arrays["random_keys"].astype(np.uint32),
        position,
        has_gauss,
        float(arrays["random_gauss"]),
    )
    return SavedWalk(points, log_density, arrays["centre"], arrays["root"], state)
