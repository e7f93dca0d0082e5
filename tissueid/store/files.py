"""Whole files or none: atomic writes, hashes, and JSON that has one spelling.

A file is written to a temporary name beside its target, flushed to the disk, and moved over it with
``os.replace``, which is atomic on POSIX and on NTFS.  A reader sees the old file or the new one.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

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


def write_file(path: Path, content: bytes) -> None:
    """Write a whole file or nothing.

    ``path``: its folder must exist.
    """
    temporary = path.with_name(TEMPORARY_PREFIX + path.name)
    try:
        temporary.write_bytes(content)
        replace_file(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def plain_json(value: Any) -> Any:
    """Rewrite a value in plain dicts, lists and Python numbers.

    Mapping proxies, tuples and numpy scalars and arrays come out of frozen result types; JSON and its
    schemas know none of them.

    Raises TypeError: for anything JSON has no word for.
    """
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain_json(child) for key, child in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_json(child) for child in value]
    if isinstance(value, np.ndarray):
        return plain_json(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (int, float)):
        return value
    msg = f"{type(value).__name__} has no place in JSON: {value!r}"
    raise TypeError(msg)


def json_bytes(document: Any) -> bytes:
    """JSON with one spelling for one document: UTF-8, two spaces, shortest round-trip numbers.

    Raises ValueError: for NaN or infinity, which JSON does not have.
    """
    text = json.dumps(plain_json(document), ensure_ascii=False, indent=2, allow_nan=False)
    return (text + "\n").encode("utf-8")
