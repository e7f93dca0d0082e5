"""Which files are recordings: named ones as they are, directories by suffix."""

from __future__ import annotations

import os
import re
import stat
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import Literal

from tissueid.errors import InputError, UsageError, printable
from tissueid.ingest.archive import recordings_in
from tissueid.ingest.layout import find_layout
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import HEAD_BYTES, decode_text

__all__ = ["SUFFIXES", "find_inputs", "natural_key"]

#: Suffixes taken from a directory.
SUFFIXES = (".csv", ".tsv", ".tra", ".xls", ".xlsx", ".xlsm", ".xlsb", ".ods", ".zip", ".dat", ".txt")
#: Suffixes of prose and other data as well: taken from a directory only where the head holds a table.
_PROSE_SUFFIXES = (".txt", ".dat")
#: Texts that say themselves what they are, wherever their tables begin.
_SIGNED = (b"<Mach-1 File>", b"MTS793|")
#: Refusals of what is no recording at all.
_NO_TABLE = ("not_an_export", "empty_file")
#: What only a directory written by tissueid holds.
_OWN_OUTPUT = (".current", "identification.json")


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Sort key in which ``Specimen_2`` stands before ``Specimen_10``."""
    pieces = re.split(r"(\d+)", path.as_posix().casefold())
    return tuple((0, int(piece), "") if piece.isdecimal() else (1, 0, piece) for piece in pieces)


def find_inputs(paths: Iterable[str | Path]) -> list[Path]:
    """The recordings among and under some paths.

    Parameters
    ----------
    paths : iterable of str or Path
        Files are taken as named, whatever their suffix.  Directories are searched through: known
        suffixes, natural order, without hidden files, lock files and tissueid's own output.

    Returns
    -------
    list of Path
        Without repetitions.

    Raises
    ------
    UsageError
        A path does not exist.
    InputError
        A directory holds no recording (``no_recording``).
    """
    found: dict[Path, None] = {}
    for path in map(Path, paths):
        if path.is_dir():
            inside = sorted(_recordings(path), key=natural_key)
            if not inside:
                Place(str(path)).refuse(
                    "no_recording",
                    f"the directory holds no recording: no {', '.join(SUFFIXES[:-1])} file and no table"
                    f" in a .txt"
                    " file; name the files themselves",
                )
            found.update(dict.fromkeys(inside))
        elif path.exists():
            found[path] = None
        else:
            msg = f"{printable(str(path))}: there is no such file or directory"
            raise UsageError(msg)
    # unlike Path.resolve, realpath bears a link to itself
    return list({os.path.realpath(path): path for path in reversed(found)}.values())[::-1]


def _recordings(directory: Path) -> Iterator[Path]:
    """Recordings below a directory, and what can't be looked into, for it to be refused by name."""
    waiting, seen = [directory], set()
    while waiting:
        folder = waiting.pop()
        try:
            status = folder.stat()
            entries = list(folder.iterdir())
        except OSError as error:
            if folder == directory:
                Place(str(directory)).refuse(
                    "unreadable_file", f"the directory can't be listed: {error.strerror}; check its rights"
                )
            yield folder
            continue
        # links may lead in circles
        if (status.st_dev, status.st_ino) in seen or any(entry.name in _OWN_OUTPUT for entry in entries):
            continue
        seen.add((status.st_dev, status.st_ino))
        for entry in entries:
            if entry.name.startswith((".", "~$")):
                continue
            kind = _kind(entry)
            if kind == "folder":
                waiting.append(entry)
            elif entry.suffix.lower() in SUFFIXES and (kind != "file" or _is_recording(entry)):
                yield entry


def _kind(entry: Path) -> Literal["folder", "file", "other"]:
    """What an entry is; pipes, devices and broken links are neither, and opening some would wait for ever."""
    try:
        mode = entry.stat().st_mode
    except OSError:
        return "other"
    return "folder" if stat.S_ISDIR(mode) else "file" if stat.S_ISREG(mode) else "other"


def _is_recording(path: Path) -> bool:
    suffix = path.suffix.lower()
    if suffix == ".zip":
        return _holds_unpacked_nowhere(path)
    return suffix not in _PROSE_SUFFIXES or _holds_table(path)


def _holds_unpacked_nowhere(path: Path) -> bool:
    """Whether an archive holds recordings that do not lie beside it as well: nothing is read twice."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = [PurePosixPath(member.filename).name for member in recordings_in(archive)]
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return True  # read later, and refused by name
    beside = (path.parent, path.with_suffix(""))
    return bool(names) and not all(any((folder / name).exists() for folder in beside) for name in names)


def _holds_table(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
        place = Place(str(path))
        if head.startswith(_SIGNED):
            return True
        find_layout(decode_text(head, place), ReadOptions(), place)
    except InputError as error:
        # a table that can't be trusted is refused by name later, not overlooked
        return error.code not in _NO_TABLE
    except OSError:
        return True
    return True
