"""New and whole recordings of a folder: by asking again and again, on every system alike.

A file is whole when its size and time stay the same from one look to the next and it can be opened; a machine
that still writes, or a spreadsheet that locks it, delays it and no more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

Fingerprint = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Look:
    """Result of one look at the folder."""

    ready: tuple[Path, ...] = ()  # new or changed, and whole; the oldest first
    gone: tuple[Path, ...] = ()  # seen before and no longer there
    waiting: tuple[Path, ...] = ()  # new, and still being written
    reachable: bool = True  # false where the folder could not be listed: a network drive away is no deletion


@dataclass(slots=True)
class FolderWatch:
    """A folder that is looked at repeatedly."""

    #: Lists the recordings of the folder; an ``OSError`` means that it is not reachable.
    find: Callable[[], Iterable[Path]]
    #: Path -> fingerprint (size, time in ns) of what was handed out already.
    known: dict[Path, Fingerprint] = field(default_factory=dict)
    _growing: dict[Path, Fingerprint] = field(default_factory=dict)

    def look(self) -> Look:
        """Look once; a file is handed out at the second look that finds it the same."""
        try:
            seen = {path: mark for path in self.find() if (mark := fingerprint(path)) is not None}
        except OSError:
            return Look(reachable=False)
        changed = {path: mark for path, mark in seen.items() if self.known.get(path) != mark}
        ready = [path for path, mark in changed.items() if self._growing.get(path) == mark and opens(path)]
        gone = [path for path in self.known if path not in seen]
        self._growing = {path: mark for path, mark in changed.items() if path not in ready}
        self.known |= {path: changed[path] for path in ready}
        for path in gone:
            del self.known[path]
        # the order of testing is that of the files' times
        ready.sort(key=lambda path: (changed[path][1], path.name))
        return Look(tuple(ready), tuple(gone), tuple(self._growing))

    def know(self, paths: Mapping[Path, Fingerprint]) -> None:
        """Take recordings for judged already."""
        self.known |= paths


def fingerprint(path: Path) -> Fingerprint | None:
    """Size and time of a file; ``None`` where it is gone, or empty as yet."""
    try:
        found = path.stat()
    except OSError:
        return None
    return (found.st_size, found.st_mtime_ns) if found.st_size else None


def opens(path: Path) -> bool:
    """True where the file can be read now: Windows refuses what another program still holds."""
    try:
        with path.open("rb") as stream:
            return bool(stream.read(1))
    except OSError:
        return False
