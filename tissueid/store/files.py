"""Whole files or none, their names on every file system, and JSON that has one spelling.

A file is written beside its target, flushed to the disk and moved over it by ``os.replace``, which is atomic
on POSIX and on NTFS: a reader sees the old file or the new one.  A specimen may be called anything a lab
writes into a header field: with slashes, in Chinese, ``CON``, 400 characters long, or like another but for
its case.  Lists that grow with a cohort are gathered in a :class:`JsonList`, in a temporary file.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import IO, Any

from tissueid.documents import plain

#: Leftovers of killed writers start with this and may be deleted.
TEMPORARY_PREFIX = ".tmp-"


def sha256_of(path: Path) -> str:
    """Hexadecimal SHA-256 of a file's bytes."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def sync_folder(folder: Path) -> None:
    """Make renames inside a folder durable, where the platform can (Windows has no such call)."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except (PermissionError, IsADirectoryError):
        return
    try:
        os.fsync(handle)
    except OSError:
        # some network file systems refuse to sync a folder; the rename itself stays atomic
        return
    finally:
        os.close(handle)


def replace_file(temporary: Path, target: Path) -> None:
    """Flush a finished temporary file to the disk and move it over its target."""
    with temporary.open("rb+") as stream:
        os.fsync(stream.fileno())
    os.replace(temporary, target)  # noqa: PTH105 -- the name of the system call says what is promised
    sync_folder(target.parent)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A name to write to beside a file, moved over it where the context ends well; else nothing stays.

    Raises OSError: what has the name is a device, a pipe or a socket, which no file may take the place of.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise OSError(errno.EINVAL, "it is no file", str(path))
    # not with_name(), which calls a bug what is the folder one stands in
    temporary = path.parent / (TEMPORARY_PREFIX + path.name)
    try:
        yield temporary
        replace_file(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def time_now() -> str:
    """Time at which a page is written, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def write_file(path: Path, content: bytes) -> None:
    """Write a whole file or nothing; into a pipe or a device straight."""
    if path.is_fifo() or path.is_char_device():
        path.write_bytes(content)
        return
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def json_bytes(document: Any) -> bytes:
    """JSON with one spelling: UTF-8, two spaces, shortest round-trip numbers; NaN is a ValueError."""
    return _spelled(document, 0) + b"\n"


#: Public files of a run.
IDENTIFICATION = "identification.json"
CURVES = "curves.h5"
RUPTURE = "rupture.json"
POSTERIORS = "posteriors.h5"
REPORT = "report.html"
ONLY_BUNDLE = "bundle.h5"

# Device names that Windows keeps for itself, whatever their extension
_RESERVED = frozenset(
    {"con", "prn", "aux", "nul", "conin$", "conout$"}
    | {f"{port}{digit}" for port in ("com", "lpt") for digit in "0123456789¹²³"}
)

#: Longest safe name in UTF-8 bytes: most file systems allow 255, and paths are long already.
_LONGEST_BYTES = 80


def safe_name(name: str) -> str:
    """Turn a name into a part of a file name: letters and digits of any script, ``.``, ``_``, ``-``.

    At most 80 bytes of UTF-8, never empty, not reserved, not beginning or ending with a dot.
    """
    composed = unicodedata.normalize("NFC", name)
    kept = "".join(char if char.isalnum() or char in "._-" else "_" for char in composed)
    while len(kept.encode("utf-8")) > _LONGEST_BYTES:
        kept = kept[:-1]
    kept = kept.strip("._ ") or "specimen"
    return f"{kept}_" if kept.split(".")[0].casefold() in _RESERVED else kept


def bundle_names(specimens: Iterable[str]) -> dict[str, str]:
    """Name the bundle file of every specimen: ``{"kidney 3": "bundle-kidney_3.h5"}``."""
    return file_names(specimens, "bundle", ".h5")


def file_names(specimens: Iterable[str], stem: str, suffix: str) -> dict[str, str]:
    """Name a file of every specimen: ``{"kidney 3": "stem-kidney_3.suffix"}``.

    Where two names would meet on a file system that ignores case or composes letters differently,
    each gets eight digits of its own hash, whatever their order.
    """
    specimens = list(specimens)
    plain = {specimen: safe_name(specimen) for specimen in specimens}
    met = Counter(map(_folded, plain.values()))
    names = {}
    for specimen, name in plain.items():
        mark = hashlib.sha256(specimen.encode("utf-8")).hexdigest()[:8]
        own = name if met[_folded(name)] == 1 else f"{name}-{mark}"
        names[specimen] = f"{stem}-{own}{suffix}"
    return names


def _folded(name: str) -> str:
    return unicodedata.normalize("NFKC", name).casefold()


_INDENT = 2
#: A list stays in memory up to this size [bytes].
_SPOOL_BYTES = 1 << 20


def _spelled(value: Any, level: int) -> bytes:
    """A value as it stands ``level`` levels deep in a document; a line break is never inside a string."""
    text = json.dumps(plain(value), ensure_ascii=False, indent=_INDENT, allow_nan=False)
    return text.replace("\n", "\n" + " " * (_INDENT * level)).encode("utf-8")


class JsonList(AbstractContextManager["JsonList"]):
    """A list of a document, written down as it grows; ``level``: how deep its elements stand in it."""

    def __init__(self, level: int) -> None:
        self.level = level
        self.count = 0
        self._file = SpooledTemporaryFile(max_size=_SPOOL_BYTES)  # noqa: SIM115 -- closed by close()

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, value: Any) -> None:
        """Append one element; ValueError for NaN or infinity, which JSON does not have."""
        pad = b" " * (_INDENT * self.level)
        self._file.write((b",\n" if self.count else b"\n") + pad + _spelled(value, self.level))
        self.count += 1

    def copy_into(self, stream: IO[bytes]) -> None:
        """Write the whole list."""
        if self.count == 0:
            stream.write(b"[]")
            return
        stream.write(b"[")
        self._file.seek(0)
        shutil.copyfileobj(self._file, stream)
        stream.write(b"\n" + b" " * (_INDENT * (self.level - 1)) + b"]")


def write_json(stream: IO[bytes], value: Any, *, level: int = 0) -> None:
    """Write a document whose mappings may hold :class:`JsonList` in place of lists."""
    if isinstance(value, JsonList):
        value.copy_into(stream)
    elif isinstance(value, Mapping) and value:
        pad = b" " * (_INDENT * (level + 1))
        for number, (key, child) in enumerate(value.items()):
            stream.write((b",\n" if number else b"{\n") + pad)
            stream.write(json.dumps(str(key), ensure_ascii=False).encode("utf-8") + b": ")
            write_json(stream, child, level=level + 1)
        stream.write(b"\n" + b" " * (_INDENT * level) + b"}")
    else:
        stream.write(_spelled(value, level))
    if level == 0:
        stream.write(b"\n")
