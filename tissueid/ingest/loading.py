"""The bytes of a file, once, whole and bounded: no pipe, no device, no folder, nothing that still grows.

A recording of five million rows is some 200 MB.  What is no table is told by its first bytes, so that a
disk image named ``.csv`` costs no more than a page of it.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from tissueid.errors import UsageError, printable
from tissueid.ingest.refusals import Place
from tissueid.ingest.remote import remote_bytes, url_of
from tissueid.ingest.text import HEAD_BYTES, foreign_kind
from tissueid.store.session_log import HDF5_MAGIC, RAW_MAGIC

#: No recording is larger: 50 million rows of 40 characters.
LARGEST_BYTES = 1 << 31
_PIECE_BYTES = 1 << 24
#: What may be opened though it is no text.
_WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
#: ... logs of rendered sessions among them.
_SESSIONS = (RAW_MAGIC, HDF5_MAGIC)


def load_bytes(path: str | Path, place: Place) -> bytes:
    """Read a regular file.

    Raises InputError: ``unreadable_file`` where it is no file, can't be opened, is too large or changes while
    it is read; ``not_an_export`` where its first bytes are those of something else, or of one endless line.
    """
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
        reason = getattr(error, "strerror", None) or "its name holds a NUL"
        place.refuse("unreadable_file", f"the file can't be read: {reason}; check its name and rights")
    try:
        return _read(handle, place)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        place.refuse("unreadable_file", f"the file can't be read: {reason}; check its name and rights")
    except MemoryError:
        place.refuse(
            "unreadable_file", "the file is larger than the memory that is free; split it, or free memory"
        )
    finally:
        os.close(handle)


def _read(handle: int, place: Place) -> bytes:
    before = os.fstat(handle)
    if not stat.S_ISREG(before.st_mode):
        place.refuse(
            "unreadable_file",
            f"this is {_kind(before.st_mode)}, not a file; save the recording to a file first",
        )
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
        data, size = remote_bytes(url, LARGEST_BYTES)
    except UsageError as error:
        place.refuse("unreadable_file", str(error))
    except OSError as error:
        place.refuse(
            "unreadable_file", f"the file can't be read: {error.strerror}; check its name and rights"
        )
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
    if kind is not None:
        place.refuse(
            "not_an_export",
            f"this is {kind}, not the raw data of a test; give the export of the test machine",
        )
    if b"\n" not in head and b"\r" not in head and len(head) == HEAD_BYTES:
        place.refuse("not_an_export", f"the first line is longer than {HEAD_BYTES} bytes: this is no table")


def _kind(mode: int) -> str:
    kinds = (
        (stat.S_ISDIR, "a folder"),
        (stat.S_ISFIFO, "a pipe"),
        (stat.S_ISCHR, "a device"),
        (stat.S_ISBLK, "a device"),
        (stat.S_ISSOCK, "a socket"),
    )
    return next((name for holds, name in kinds if holds(mode)), "something else")
