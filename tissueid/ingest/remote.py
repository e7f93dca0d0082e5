"""Recordings at a URL: read where they lie, by fsspec, which is asked for only when a URL is.

A path of two letters or more before its first colon and slash is a URL, unless such a file exists.  Paths
drop the second slash of ``s3://bucket/logs``; it is put back before fsspec sees it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from tissueid.errors import UsageError, printable

#: One letter would be a drive.
_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+(.*)", re.DOTALL)
#: What a place that can't be reached raises, whichever library reaches for it.
_UNREACHED = (OSError, ValueError, RuntimeError)


def url_of(path: str | Path) -> str | None:
    """The URL that a path names; ``None`` for one of this machine's files.

    Examples
    --------
    >>> from pathlib import Path
    >>> url_of(Path("s3://bucket/logs"))
    's3://bucket/logs'
    """
    found = _URL.fullmatch(str(path))
    if found is None or Path(path).exists():
        return None
    scheme, rest = found[1].lower(), found[2]
    return f"{scheme}:///{rest}" if scheme in {"file", "local"} else f"{scheme}://{rest}"


def _opened(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path there."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        msg = f"{printable(url)}: URLs are read by fsspec ({error}); pip install 'tissueid[remote]'"
        raise UsageError(msg) from error
    try:
        system, path = url_to_fs(url)
    except (ImportError, *_UNREACHED) as error:
        # fsspec says which library a protocol needs
        msg = f"{printable(url)}: this place can't be reached: {error}"
        raise UsageError(msg) from error
    return system, str(path)


def remote_bytes(url: str, limit: int, head: int | None = None) -> tuple[bytes, int]:
    """A file, or its beginning.

    ``limit``: bytes above which it is not fetched; ``head``: bytes that are wanted, where not all.  Returns
    ``data``: empty where the file is larger than ``limit``; ``size``: of the whole file.  Raises OSError: the
    file can't be read; UsageError: no library reads such URLs.
    """
    system, path = _opened(url)
    try:
        size = int(system.size(path) or 0)
        data = system.cat_file(path, end=head) if size <= limit else b""
    except _UNREACHED as error:
        raise OSError(0, f"{error or type(error).__name__}") from error
    return bytes(data), size


def remote_files(url: str) -> Iterator[Path] | None:
    """The files below a URL, folder by folder; ``None`` where it names a file.

    Hidden files and folders are passed over, and folders with a file of the name ``identification.json`` or
    ``.current``: what tissueid has written is no recording.

    Raises UsageError: there is nothing at the URL, or it can't be reached.
    """
    system, path = _opened(url)
    try:
        if system.isfile(path):
            return None
        there = system.isdir(path)
    except _UNREACHED as error:
        msg = f"{printable(url)}: this place can't be reached: {error}"
        raise UsageError(msg) from error
    if not there:
        msg = f"{printable(url)}: there is no such file or directory"
        raise UsageError(msg)
    return _below(system, path)


def _below(system: Any, top: str) -> Iterator[Path]:
    for _, folders, files in system.walk(top, detail=True, topdown=True):
        if files.keys() & {".current", "identification.json"}:
            folders.clear()
            continue
        for name in [name for name in folders if name.startswith(".")]:
            del folders[name]
        for name in files:
            if not name.startswith((".", "~$")) and PurePosixPath(name).suffix:
                yield Path(system.unstrip_protocol(files[name]["name"]))
