"""The part of a study that speaks of some recordings: small enough to travel, and to be hashed.

A study file of a cohort names every recording.  Whoever reads or fits a few of them needs the tables that
name these, the specimen's own entry and what is said of all; and a result depends on nothing else, so that
a line added for one specimen leaves the results of the others as they are.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from tissueid.manifest import Entry, Study

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
        "frame": None if frame is None else frame.as_json() | {"sources": list(frame.sources)},
        "priors": part.priors.as_json(),
        "specimens": {name: dict(row) for name, row in part.specimens.items()},
        "protocols": {name: dict(row) for name, row in part.protocols.items()},
        **{table: [_plain(entry) for entry in getattr(part, table)] for table in _TABLES},
    }


def _plain(entry: Entry) -> dict[str, Any]:
    # the line moves when tables are added above it, and says nothing of the recording
    return {"files": list(entry.files), **dict(entry.values)}
