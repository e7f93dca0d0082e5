"""Recordings of a study in their order, the options each is read with, and the study's words on some of them.

Files that the manifest names come first; those beside them are read as well, unless it says ``only_listed =
true``.
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tissueid.documents import members, plain
from tissueid.documents.identification import Frame
from tissueid.errors import InputError, refuse
from tissueid.ingest import ReadOptions, each_input, read_each, read_one
from tissueid.ingest.manifest import MANIFEST, READING, read_study
from tissueid.manifest import Entry, Study
from tissueid.result import Refusal
from tissueid.trial import Trial


def locate_study(
    paths: Sequence[str], *, named: str | None = None, ignore: bool = False
) -> tuple[Study | None, tuple[str, ...]]:
    """The study behind some paths, and what is to be read in place of a manifest among them.

    Raises UsageError: two studies at once, or one that is both named and ignored; InputError: the
    manifest is not valid.
    """
    manifests = [path for path in paths if path.casefold().endswith(".toml")]
    if ignore and (named or manifests):
        refuse(f"--no-study, and yet {named or manifests[0]} is named: leave one out")
    if ignore:
        return None, tuple(paths)
    found: dict[str, str] = {}
    for path in () if named else paths:
        name = picked_sheet(path)[0]
        folder = name if Path(name).is_dir() else os.path.dirname(name)  # noqa: PTH120 -- kept as typed
        file = path if path in manifests else os.path.join(folder, MANIFEST)  # noqa: PTH118 -- kept as typed
        if path in manifests or Path(file).is_file():
            found.setdefault(os.path.realpath(file), file)
    if len(found) > 1:
        refuse(
            f"{len(found)} studies at once ({', '.join(sorted(found.values()))}): fit them one by one, "
            "choose one with --study, or use --no-study"
        )
    if not named and not found:
        return None, tuple(paths)
    study = read_study(named or next(iter(found.values()))).of_sheets(_picked(paths))
    return study, _to_read(study, [path for path in paths if path not in manifests], bool(manifests))


def picked_sheet(path: str) -> tuple[str, str | None]:
    """A path as the user typed it, parted where it names a sheet: ``"meat.xlsx::FF1A"``."""
    name, mark, sheet = path.partition("::")
    return (name, sheet) if mark and not os.path.lexists(path) else (path, None)


def _picked(paths: Sequence[str]) -> dict[str, set[str]]:
    """Sheets that are read of the files that are not read whole."""
    if any(path.casefold().endswith(".toml") or Path(path).is_dir() for path in paths):
        return {}
    whole = {os.path.realpath(path) for path in paths if picked_sheet(path)[1] is None}
    picked: dict[str, set[str]] = {}
    for name, sheet in map(picked_sheet, paths):
        if sheet is not None and os.path.realpath(name) not in whole:
            picked.setdefault(os.path.realpath(name), set()).add(sheet)
    return picked


def _to_read(study: Study, paths: Sequence[str], manifest_named: bool) -> tuple[str, ...]:
    """Listed files before the folder they are in; the folder itself unless only listed files count."""
    folder = str(Path(study.path).parent)
    others = [path for path in paths if os.path.realpath(path) != os.path.realpath(folder)]
    if not manifest_named and len(others) == len(paths):
        return tuple(paths)
    listed = listed_files(study)
    if study.only_listed or not _holds_recordings(folder):
        return tuple(dict.fromkeys([*listed, *others]))
    return tuple(dict.fromkeys([*listed, folder, *others]))


def _holds_recordings(folder: str) -> bool:
    try:
        return any(isinstance(item, Path) for item in each_input([folder]))
    except InputError:
        return False


def listed_files(study: Study) -> list[str]:
    """Files that the study names, in its order, as seen from where the study was named."""
    folder = Path(study.path).parent
    real = os.path.realpath(folder)
    names = [file for entry in study.entries for file in entry.files]
    return [os.path.normpath(folder / os.path.relpath(name, real)) for name in dict.fromkeys(names)]


def options_for(study: Study | None, base: ReadOptions, path: str, sheet: str | None) -> ReadOptions:
    """Options of one file, or of one sheet of it: the run's options with the study's columns and units."""
    if study is None:
        return base
    override = study.decision(path, sheet).override
    said: dict[str, Any] = {
        key: {**getattr(base, key), **override[key]} for key in READING if key in override
    }
    return replace(base, **said) if said else base


def read_decided(path: Path, base: ReadOptions, study: Study | None) -> Iterator[Trial | InputError]:
    """Every trial of a file, read as the study says; a sheet with columns of its own is read again."""
    general = options_for(study, base, str(path), None)
    for item in read_each(path, general):
        sheet = item.sheet if isinstance(item, InputError) else item.source.sheet
        own = options_for(study, base, str(path), sheet)
        if sheet is None or own == general:
            yield item
            continue
        try:
            yield read_one(path, sheet, own)
        except InputError as error:
            yield error


def read_decided_one(path: str, sheet: str | None, base: ReadOptions, study: Study | None) -> Trial:
    """One trial again, read as the study says."""
    return read_one(path, sheet, options_for(study, base, path, sheet))


_TABLES = ("trials", "overrides", "exclusions")


class StudyParts:
    """Gives parts of a study without looking through all of it each time."""

    def __init__(self, study: Study) -> None:
        self.study = study
        # table -> file -> the entries that name it, each with the file's place among those it names
        self._naming: dict[str, dict[str, list[tuple[int, int]]]] = {table: {} for table in _TABLES}
        for table in _TABLES:
            for number, entry in enumerate(getattr(study, table)):
                for place, file in enumerate(entry.files):
                    self._naming[table].setdefault(file, []).append((number, place))

    def of_file(self, path: str) -> Study:
        """Remarks on one file, all its sheets included."""
        return self._part({self.study.real_path(path)}, None, ())

    def of_specimen(self, specimen: str, recordings: Iterable[tuple[str, str | None]]) -> Study:
        """Remarks on one specimen (by its name as shown) and of its recordings (path and sheet)."""
        own = [(self.study.real_path(path), sheet) for path, sheet in recordings]
        return self._part({path for path, _ in own}, own, (specimen,))

    def _part(
        self, files: set[str], own: list[tuple[str, str | None]] | None, specimens: tuple[str, ...]
    ) -> Study:
        tables: dict[str, Any] = {}
        for table in _TABLES:
            entries: tuple[Entry, ...] = getattr(self.study, table)
            named: dict[int, list[tuple[int, str]]] = {}
            for file in files:
                for number, place in self._naming[table].get(file, ()):
                    named.setdefault(number, []).append((place, file))
            parts = [
                replace(entries[number], files=tuple(file for _, file in sorted(named[number])))
                for number in sorted(named)
            ]
            tables[table] = tuple(
                part for part in parts if own is None or any(part.names(*one) for one in own)
            )
        rows = {name: self.study.specimens[name] for name in specimens if name in self.study.specimens}
        return replace(self.study, specimens=rows, **tables)


def facts_of(part: Study) -> dict[str, Any]:
    """Everything in a part of a study that may change a number or a remark, as JSON; not its path or hash."""
    frame = part.calibration.frame
    return {
        "tip": dict(part.tip),
        "calibration": dict(part.calibration.values),
        "frame": None if frame is None else plain(members(frame, Frame)) | {"sources": list(frame.sources)},
        "priors": part.priors.as_json(),
        "specimens": {name: dict(row) for name, row in part.specimens.items()},
        "protocols": {name: dict(row) for name, row in part.protocols.items()},
        # the line moves when tables are added above it, and says nothing of the recording
        **{
            table: [{"files": list(one.files), **one.values} for one in getattr(part, table)]
            for table in _TABLES
        },
    }


#: A file, and the sheet that the user named with it.
Named = tuple[Path, str | None]


class FileList:
    """Paths in one block of bytes, 8 beside each; sheets and refusals, which are few, in tables."""

    def __init__(self, items: Iterable[Named | Refusal] = ()) -> None:
        self._text = bytearray()
        self._end = array("Q", [0])
        self._sheets: dict[int, str] = {}
        self._refusals: dict[int, Refusal] = {}
        for item in items:
            self.add(item)

    def add(self, item: Named | Refusal) -> None:
        """Put a file, or the refusal in its place, at the end."""
        number = len(self)
        if isinstance(item, Refusal):
            self._refusals[number] = item
        else:
            path, sheet = item
            self._text += os.fsencode(path)
            if sheet is not None:
                self._sheets[number] = sheet
        self._end.append(len(self._text))

    def __len__(self) -> int:
        return len(self._end) - 1

    def __getitem__(self, number: int) -> Named | Refusal:
        if number in self._refusals:
            return self._refusals[number]
        name = bytes(self._text[self._end[number] : self._end[number + 1]])
        return Path(os.fsdecode(name)), self._sheets.get(number)

    def __iter__(self) -> Iterator[Named | Refusal]:
        return (self[number] for number in range(len(self)))
