"""Files that are recordings: named ones as they are, directories by suffix."""

from __future__ import annotations

import os
import re
import stat
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from hashlib import blake2b
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Literal

from tissueid.errors import InputError, printable, refuse
from tissueid.ingest.archive import PROSE_SUFFIXES, recordings_in
from tissueid.ingest.archive import SUFFIXES as IN_ARCHIVES
from tissueid.ingest.layout import find_layout
from tissueid.ingest.loading import OWN_OUTPUT, remote_bytes, remote_files, url_of
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import HEAD_BYTES, decode_text
from tissueid.ingest.unpacking import BROKEN_ARCHIVE

#: Suffixes taken from a directory.
SUFFIXES = (".zip", *IN_ARCHIVES)
#: Texts that say themselves what they are, wherever their tables begin.
_SIGNED = (b"<Mach-1 File>", b"MTS793|")
#: Refusals of what is no recording at all.
_NO_TABLE = ("not_an_export", "empty_file")


def natural_key(name: str) -> str:
    """Sort key in which ``Specimen_2`` stands before ``Specimen_10``: numbers stand behind their length."""

    def counted(match: re.Match[str]) -> str:
        digits = str(int(match[0]))
        return f"\0{chr(len(digits))}{digits}"

    return re.sub(r"\d+", counted, name.casefold())


def find_inputs(paths: Iterable[str | Path]) -> list[Path]:
    """The recordings among and under some paths; raises the first refusal of :func:`each_input`."""
    found = []
    for item in each_input(paths):
        if isinstance(item, InputError):
            raise item
        found.append(item)
    return found


def each_input(paths: Iterable[str | Path]) -> Iterator[Path | InputError]:
    """The recordings among and under some paths, one by one: one folder is in memory at a time.

    Files are taken as named; directories are searched for known suffixes, without hidden files and tissueid's
    own output.  Each file comes once; a link that leads out of its folder, or in a circle, is refused.
    """
    seen: set[bytes] = set()
    for path in map(Path, paths):
        url = url_of(path)
        below = None if url is None else remote_files(url)
        if below is not None or path.is_dir():
            files: Iterator[Path | InputError] = (
                _recordings(path) if below is None else _remote_recordings(below)
            )
            first: Path | InputError | None = next(files, None)
            if first is None:
                Place(str(path)).refuse(
                    "no_recording",
                    f"the directory holds no recording: no {', '.join(SUFFIXES[: -len(PROSE_SUFFIXES)])} file"
                    f" and no table in a {', '.join(PROSE_SUFFIXES)} file; name the files themselves",
                )
            files = chain([first], files)
        elif url is not None or path.exists():
            files = iter([path])
        else:
            refuse(f"{printable(str(path))}: there is no such file or directory")
        for file in files:
            if isinstance(file, InputError):
                yield file
                continue
            # unlike Path.resolve, realpath bears a link to itself; a digest is shorter than a path
            digest = blake2b(os.fsencode(os.path.realpath(file)), digest_size=16).digest()
            if digest not in seen:
                seen.add(digest)
                yield file


def _recordings(directory: Path) -> Iterator[Path | InputError]:
    """Recordings below a directory, and what can't be looked into, for it to be refused by name."""
    # folders and files still to come, the next one last, each with the folders that it is in
    root = os.path.realpath(directory)
    waiting: list[tuple[Path, str, tuple[str, ...]]] = [(directory, "folder", ())]
    seen = set()
    while waiting:
        path, kind, above = waiting.pop()
        refusal = _leads_astray(path, kind, root, above)
        if refusal is not None:
            yield refusal
            continue
        if kind != "folder":
            # pipes and broken links are refused by name later
            if kind == "other" or _is_recording(path):
                yield path
            continue
        try:
            status = path.stat()
            entries = list(path.iterdir())
        except OSError as error:
            if path == directory:
                Place(str(directory)).refuse(
                    "unreadable_file", f"the directory can't be listed: {error.strerror}; check its rights"
                )
            yield path
            continue
        if (status.st_dev, status.st_ino) in seen or any(entry.name in OWN_OUTPUT for entry in entries):
            continue
        seen.add((status.st_dev, status.st_ino))
        # of a deep folder the system would look at every part of the path
        real = os.path.join(above[-1], path.name) if above and not path.is_symlink() else None  # noqa: PTH118
        inside = (*above, real or os.path.realpath(path))
        waiting += [(entry, of_kind, inside) for entry, of_kind in reversed(_in_order(entries))]


def _leads_astray(path: Path, kind: str, root: str, above: Sequence[str]) -> InputError | None:
    """Why a link is not followed: it leads into a folder that it is in, or out of the one that was named."""
    if not above or kind == "other" or not path.is_symlink():
        return None
    target = os.path.realpath(path)
    if target in above:
        message = f"the link leads in a circle, back to {printable(target)}; remove it"
    elif not Path(target).is_relative_to(root):
        message = f"the link leads out of the folder, to {printable(target)}; name that path itself"
    else:
        return None
    return Place(str(path)).refusal("unreadable_file", message)


def _remote_recordings(files: Iterable[Path]) -> Iterator[Path]:
    """Recordings among the files below a URL, in natural order."""
    for file in sorted(files, key=lambda one: natural_key(str(one))):
        if file.suffix.lower() in SUFFIXES and _is_recording(file):
            yield file


def _in_order(entries: Iterable[Path]) -> list[tuple[Path, str]]:
    """Entries worth a look among those of a folder, each with its kind."""
    found = []
    for entry in entries:
        if entry.name.startswith((".", "~$")):
            continue
        kind = _kind(entry)
        if kind == "folder" or entry.suffix.lower() in SUFFIXES:
            # as the whole paths would be sorted
            key = natural_key(entry.name + "/" * (kind == "folder"))
            found.append((key, entry.name, entry, kind))
    return [(entry, kind) for _, _, entry, kind in sorted(found)]


def _kind(entry: Path) -> Literal["folder", "file", "other"]:
    """Kind of an entry; pipes, devices and broken links are neither, and opening some would wait for ever."""
    try:
        mode = entry.stat().st_mode
    except OSError:
        return "other"
    return "folder" if stat.S_ISDIR(mode) else "file" if stat.S_ISREG(mode) else "other"


def _is_recording(path: Path) -> bool:
    suffix = path.suffix.lower()
    if suffix == ".zip":
        return _holds_unpacked_nowhere(path)
    return suffix not in PROSE_SUFFIXES or _holds_table(path)


def _holds_unpacked_nowhere(path: Path) -> bool:
    """True where an archive holds recordings that do not lie beside it as well: nothing is read twice."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = [PurePosixPath(member.filename).name for member in recordings_in(archive)]
    except BROKEN_ARCHIVE:
        return True  # read later, and refused by name
    beside = (path.parent, path.with_suffix(""))
    return bool(names) and not all(any((folder / name).exists() for folder in beside) for name in names)


def _head(path: Path) -> bytes:
    url = url_of(path)
    if url is not None:
        return remote_bytes(url, HEAD_BYTES)[0]
    with path.open("rb") as stream:
        return stream.read(HEAD_BYTES)


def _holds_table(path: Path) -> bool:
    try:
        head, place = _head(path), Place(str(path))
        if not head.startswith(_SIGNED):
            find_layout(decode_text(head, place), ReadOptions(), place)
    except InputError as error:
        # a table that can't be trusted is refused by name later, not overlooked
        return error.code not in _NO_TABLE
    except OSError:
        return True
    return True
