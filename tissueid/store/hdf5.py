"""HDF5 files of the store: whole or not at all, equal bytes for equal contents, texts and columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tissueid.errors import BundleError
from tissueid.store.files import replacing

#: Fixed bounds of the format: the bytes must not depend on which HDF5 was installed.
_FORMAT = ("v110", "v110")
#: Raised by libhdf5 and h5py on a file that is cut, overwritten or made by hand.
HDF5_ERRORS = (
    OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError, OverflowError, MemoryError
)  # fmt: skip


@contextmanager
def new_file(target: Path | IO[bytes]) -> Iterator[Any]:
    """A file to be written, moved to its place when it is whole; or written into a buffer."""
    if not isinstance(target, Path):
        with h5py.File(target, "w", libver=_FORMAT) as file:
            yield file
        return
    with replacing(target) as temporary, h5py.File(temporary, "w", libver=_FORMAT) as file:
        yield file


@contextmanager
def open_file(path: Path | IO[bytes], kind: str, way_out: str, missing: str | None = None) -> Iterator[Any]:
    """A file to be read; whatever is said of a damaged one becomes a BundleError.

    ``kind``: what it should be; ``way_out``: what to do where it is none; ``missing``: which fits leave it.
    """
    if missing is not None and isinstance(path, Path) and not path.is_file():
        raise BundleError(f"{path}: there is no such file; `tissueid fit` writes {missing}")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except HDF5_ERRORS as error:
        why = "no HDF5 file" if "signature not found" in str(error) else error
        raise BundleError(f"{path}: cannot be read as {kind} ({why}); {way_out}") from error


def check_format(group: Any, expected: str) -> None:
    """Refuse, by ValueError, a group that states another format."""
    if group.attrs.get("format") != expected:
        raise ValueError(f"its format is {group.attrs.get('format')!r}, not {expected!r}")


def put_text(group: Any, name: str, text: bytes) -> None:
    """Write UTF-8 bytes as a data set."""
    kind = h5py.string_dtype("utf-8", length=len(text))
    group.create_dataset(name, data=np.array(text, dtype=kind), track_times=False)


def get_text(group: Any, name: str) -> bytes:
    """Read what :func:`put_text` wrote."""
    return bytes(group[name][()])


def put_columns(group: Any, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays as packed data sets."""
    for name, values in columns.items():
        packed = {"compression": "gzip", "shuffle": True} if values.size else {}
        group.create_dataset(name, data=values, track_times=False, **packed)


def get_columns(group: Any) -> dict[str, NDArray[Any]]:
    """Read what :func:`put_columns` wrote into a group of its own."""
    return {name: np.asarray(values[()]) for name, values in group.items()}


def offsets_of(sizes: Sequence[int]) -> NDArray[np.int64]:
    """Places where series that stand end to end begin and end, (n + 1,)."""
    return np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)]).astype("<i8")
