"""Which files are recordings: named ones as they are, directories by suffix."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath

from tissueid.errors import InputError, UsageError
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
            msg = f"{path}: there is no such file or directory"
            raise UsageError(msg)
    return list({path.resolve(): path for path in reversed(found)}.values())[::-1]


def _recordings(directory: Path) -> Iterator[Path]:
    try:
        entries = list(directory.iterdir())
    except OSError as error:
        Place(str(directory)).refuse(
            "unreadable_file", f"the directory can't be listed: {error.strerror}; check its rights"
        )
    if any(entry.name in _OWN_OUTPUT for entry in entries):
        return
    for entry in entries:
        if entry.name.startswith((".", "~$")):
            continue
        if entry.is_dir():
            yield from _recordings(entry)
        elif entry.suffix.lower() in SUFFIXES and _is_recording(entry):
            yield entry


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
        return error.code == "ambiguous_decimal"
    except OSError:
        return True
    return True
