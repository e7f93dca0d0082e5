"""The bytes of a file, once, whole and bounded: no pipe, no device, no folder, nothing that still grows.

Recordings at a URL are read where they lie, by fsspec.  Paths drop the second slash of ``s3://bucket/logs``;
it is put back before fsspec sees it.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any, NoReturn

from tissueid.errors import UsageError, printable, refuse
from tissueid.ingest.markup import holds_rows
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import HEAD_BYTES, MARKUP, foreign_kind, refuse_foreign
from tissueid.store.session_log import HDF5_MAGIC, RAW_MAGIC

#: One letter would be a drive.
_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+(.*)", re.DOTALL)
#: What a place that can't be reached raises, whichever library reaches for it.
_UNREACHED = (OSError, ValueError, RuntimeError)


def url_of(path: str | Path) -> str | None:
    """The URL that a path names; ``None`` for one of this machine's files.

    >>> url_of(Path("s3://bucket/logs"))
    's3://bucket/logs'
    """
    found = _URL.fullmatch(str(path))
    if found is None or Path(path).exists():
        return None
    scheme, rest = found[1].lower(), found[2]
    return f"{scheme}:///{rest}" if scheme in {"file", "local"} else f"{scheme}://{rest}"


def _opened(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path there; asks for fsspec only now."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        refuse(f"{printable(url)}: URLs are read by fsspec ({error}); pip install 'tissueid[remote]'")
    try:
        system, path = url_to_fs(url)
    except (ImportError, *_UNREACHED) as error:
        raise _unreached(url, error) from error  # fsspec says which library a protocol needs
    return system, str(path)


def _unreached(url: str, error: Exception) -> UsageError:
    return UsageError(f"{printable(url)}: this place can't be reached: {error}")


def remote_bytes(url: str, head: int | None = None) -> tuple[bytes, int]:
    """A file, or its beginning, and its size; no bytes of one larger than :data:`LARGEST_BYTES`."""
    system, path = _opened(url)
    try:
        size = int(system.size(path) or 0)
        data = system.cat_file(path, end=head) if size <= LARGEST_BYTES else b""
    except _UNREACHED as error:
        raise OSError(0, f"{error or type(error).__name__}") from error
    return bytes(data), size


def remote_files(url: str) -> Iterator[Path] | None:
    """The files below a URL, folder by folder; ``None`` where it names a file."""
    system, path = _opened(url)
    try:
        if system.isfile(path):
            return None
        there = system.isdir(path)
    except _UNREACHED as error:
        raise _unreached(url, error) from error
    if not there:
        refuse(f"{printable(url)}: there is no such file or directory")
    return _below(system, path)


#: What only a directory written by tissueid holds.
OWN_OUTPUT = {".current", "identification.json"}


def _below(system: Any, top: str) -> Iterator[Path]:
    for _, folders, files in system.walk(top, detail=True, topdown=True):
        if files.keys() & OWN_OUTPUT:
            folders.clear()
            continue
        for name in [name for name in folders if name.startswith(".")]:
            del folders[name]
        for name in files:
            if not name.startswith((".", "~$")) and PurePosixPath(name).suffix:
                yield Path(system.unstrip_protocol(files[name]["name"]))


#: No recording is larger: 50 million rows of 40 characters.
LARGEST_BYTES = 1 << 31
#: No program saves so much of it as a page.
LARGEST_MARKUP = 1 << 28
_PIECE_BYTES = 1 << 24
#: What may be opened though it is no text.
_WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
#: ... logs of rendered sessions among them.
_SESSIONS = (RAW_MAGIC, HDF5_MAGIC)


def load_bytes(path: str | Path, place: Place) -> bytes:
    """Read a regular file."""
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        # it could be neither printed nor written to a JSON document
        Place(printable(str(path)), place.sheet).refuse(
            "unreadable_file", "the name of the file, or of a folder above it, is not UTF-8; rename it"
        )
    url = url_of(path)
    if url is not None:
        return _fetched(url, place)
    try:
        # a pipe without a writer would wait for ever
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (OSError, ValueError) as error:
        _refuse_unreadable(getattr(error, "strerror", None) or "its name holds a NUL", place)
    try:
        return _read(handle, place)
    except OSError as error:
        _refuse_unreadable(error.strerror or type(error).__name__, place)
    except MemoryError:
        place.refuse(
            "unreadable_file", "the file is larger than the memory that is free; split it, or free memory"
        )
    finally:
        os.close(handle)


def _refuse_unreadable(reason: str, place: Place) -> NoReturn:
    place.refuse("unreadable_file", f"the file can't be read: {reason}; check its name and rights")


def _read(handle: int, place: Place) -> bytes:
    before = os.fstat(handle)
    if not stat.S_ISREG(before.st_mode):
        message = f"this is {_kind(before.st_mode)}, not a file; save the recording to a file first"
        place.refuse("unreadable_file", message)
    _refuse_large(before.st_size, place)
    pieces = [os.read(handle, HEAD_BYTES)]
    _refuse_foreign(pieces[0], before.st_size, place)
    while pieces[-1]:
        pieces.append(os.read(handle, _PIECE_BYTES))
    data = b"".join(pieces)
    after = os.fstat(handle)
    same = (after.st_size, after.st_mtime_ns) == (before.st_size, before.st_mtime_ns)
    if not same or len(data) != after.st_size:
        place.refuse(
            "unreadable_file", "the file changed while it was read; try again when the test machine is done"
        )
    return data


def _fetched(url: str, place: Place) -> bytes:
    """A file at a URL."""
    try:
        data, size = remote_bytes(url)
    except UsageError as error:
        place.refuse("unreadable_file", str(error))
    except OSError as error:
        _refuse_unreadable(str(error.strerror), place)
    _refuse_large(size, place)
    _refuse_foreign(data[:HEAD_BYTES], size, place)
    return data


def _refuse_large(size: int, place: Place) -> None:
    if size > LARGEST_BYTES:
        place.refuse(
            "unreadable_file",
            f"the file has {size / 2**30:.1f} GiB, more than any recording"
            f" ({LARGEST_BYTES / 2**30:.0f} GiB); export one test a file",
        )


def _refuse_foreign(head: bytes, size: int, place: Place) -> None:
    """Refuse by the first bytes what would be refused after all of them."""
    if size <= HEAD_BYTES or head.startswith((*_WORKBOOKS, *_SESSIONS)):
        return
    kind = foreign_kind(head)
    if kind == MARKUP and size <= LARGEST_MARKUP and holds_rows(head):
        return
    if kind is not None:
        refuse_foreign(kind, place)
    if b"\n" not in head and b"\r" not in head and len(head) == HEAD_BYTES:
        place.refuse("not_an_export", f"the first line is longer than {HEAD_BYTES} bytes: this is no table")


def _kind(mode: int) -> str:
    kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
    kinds |= dict.fromkeys((stat.S_IFCHR, stat.S_IFBLK), "a device")
    return kinds.get(stat.S_IFMT(mode), "something else")
