"""Decisions taken on an inspection's page, each a table of study.toml; every other character of it stays.

Tables that were written here carry :data:`MARK` behind their header; only those are replaced or taken out.
"""

from __future__ import annotations

import math
import re
import threading
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissueid.errors import refuse
from tissueid.ingest import ReadOptions
from tissueid.ingest.manifest import MANIFEST, SCHEMA, lines_of_toml, study_of
from tissueid.manifest import Entry, Study, TomlTable
from tissueid.report.inspect_decisions import toml_value
from tissueid.report.inspect_page import InspectedRecording
from tissueid.store.files import write_file
from tissueid.study.inspected import Inspection, relative_name
from tissueid.study.recordings import read_decided_one

#: Comment behind the header of a table that was written here.
MARK = "# by inspect --serve"
#: What can be corrected: keys of ``[[override]]``, and a table of its own.
CORRECTED = ("contact_mm", "hold_from_s", "end_s", "rupture", "exclude")


@dataclass(frozen=True, slots=True)
class Correction:
    """One decision on one recording."""

    key: str  # of :data:`CORRECTED`
    file: str  # path relative to the folder of study.toml, with forward slashes
    sheet: str | None
    value: float | bool | None  # ``None`` takes the decision back
    because: str = ""  # the reason; needed but where it is taken back

    def __post_init__(self) -> None:
        if self.value is not None and not self.because.strip():
            refuse(f"{self.key} needs a reason: write it beside the number")

    @property
    def where(self) -> dict[str, str]:
        """The keys that name the recording."""
        return {"file": self.file} | ({} if self.sheet is None else {"sheet": self.sheet})

    @property
    def entry(self) -> dict[str, Any]:
        """The whole table."""
        own = {} if self.key == "exclude" else {self.key: self.value}
        return {**self.where, **own, "because": self.because.strip()}

    def made(self, entry: TomlTable) -> bool:
        """True where a table is an earlier one of this decision."""
        keys = {*self.where, "because", *({self.key} - {"exclude"})}
        return set(entry) == keys and all(entry[key] == value for key, value in self.where.items())


def corrected_text(text: str, correction: Correction) -> str:
    """The text of a study file (or of none) with a decision in it, or without it again.

    Raises UsageError: the file is laid out so that a table can't be added to it or taken out of it.
    """
    table = "exclude" if correction.key == "exclude" else "override"
    text = text or f'schema = "{SCHEMA}"\n'
    document = tomllib.loads(text)
    # TOML knows no other end of a line than a line feed
    lines = [line for line in re.split(r"(?<=\n)", text) if line]
    entries = document.get(table, [])
    mine = {
        number: span for number, span in _own_tables(text, table, lines) if correction.made(entries[number])
    }
    for span in reversed(mine.values()):
        # the table and the empty line after it; remarks that somebody put into it stay
        stop = span.stop + (span.stop < len(lines) and not lines[span.stop].strip())
        remarks = [line for line in lines[span.start : stop] if line.lstrip().startswith("#")]
        lines[span.start : stop] = remarks
    wanted = [entry for number, entry in enumerate(entries) if number not in mine]
    if correction.value is not None:
        _append(lines, table, correction.entry, "\r\n" if "\r\n" in text else "\n")
        wanted = [*wanted, correction.entry]
    return _checked("".join(lines), {**document, table: wanted}, table)


def _checked(text: str, wanted: TomlTable, table: str) -> str:
    """A text, once it was seen to say what it should and nothing else."""
    try:
        found = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        found = {}
    if {key: value for key, value in wanted.items() if value != []} != found:
        refuse(
            f"{MANIFEST} can't be changed safely here: write its {table} as [[{table}]] tables of plain lines"
        )
    return text


def _own_tables(text: str, table: str, lines: Sequence[str]) -> list[tuple[int, range]]:
    """Number and lines of each table that was written here."""
    places = lines_of_toml(text)
    found = []
    for path, line in places.items():
        if len(path) == 2 and path[0] == table and isinstance(path[1], int):
            last = max(at for where, at in places.items() if where[:2] == path)
            if lines[line - 1].rstrip().endswith(f"]]  {MARK}"):
                found.append((path[1], range(line - 1, last)))
    return found


def _append(lines: list[str], table: str, entry: TomlTable, end: str) -> None:
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += end
    if lines and lines[-1].strip():
        lines.append(end)
    lines.append(f"[[{table}]]  {MARK}{end}")
    lines += [f"{key} = {toml_value(value)}{end}" for key, value in entry.items()]


def _deciding(study: Study, key: str, path: str, sheet: str | None) -> list[Entry]:
    """Tables that decide something of a recording, the one that counts last."""
    real = study.real_path(path)
    if key == "exclude":
        return [entry for entry in study.exclusions if entry.names(real, sheet)]
    return [entry for entry in study.overrides if entry.names(real, sheet) and key in entry.values]


def standing(study: Study | None, path: str, sheet: str | None) -> dict[str, tuple[Any, str]]:
    """Standing decisions on a recording: value and reason, by key of :data:`CORRECTED`."""
    if study is None:
        return {}
    found = {key: _deciding(study, key, path, sheet) for key in CORRECTED}
    return {
        key: (entries[-1].values.get(key, True), str(entries[-1].values["because"]))
        for key, entries in found.items()
        if entries
    }


#: Decisions that are a switch, and what it is switched to.
_SWITCHES = {"rupture": False, "exclude": True}


class CorrectedInspection:
    """Inspection that the page's server corrects, one request at a time; a study file is not needed."""

    def __init__(self, manifest: Path, inspect: Callable[[], Inspection], reading: ReadOptions) -> None:
        self.manifest = manifest
        self._inspect, self._reading = inspect, reading
        self._lock = threading.Lock()
        self._seen: bytes | None = None
        self._inspection: Inspection | None = None

    def page(self) -> str:
        """The page by what study.toml says now; InputError where it is not valid."""
        with self._lock:
            return self._current().page(served=True)

    def decide(self, words: Mapping[str, Any]) -> str:
        """Take a decision, or take it back, by the words that the page sends; what was written.

        Raises UsageError: it makes no sense for this recording; InputError: study.toml is not valid,
        or would not be. The file is then as it was.
        """
        with self._lock:
            inspection = self._current()
            path, sheet, key = words.get("path"), words.get("sheet"), words.get("key")
            place = inspection.place(str(path), sheet)
            if place is None or key not in CORRECTED:
                refuse("no such recording or decision on this page: load it again")
            known = inspection.shown[place].document
            value = _value(str(key), words.get("value"), inspection.shown[place])
            file = relative_name(known.path, self.manifest.parent.resolve())
            correction = Correction(str(key), file, known.sheet, value, str(words.get("because") or ""))
            content = corrected_text((self._seen or b"").decode("utf-8-sig"), correction).encode("utf-8")
            study = study_of(content, self.manifest)
            if value is None and (by_hand := _deciding(study, str(key), known.path, known.sheet)):
                said = f"line {by_hand[-1].line} of {MANIFEST} still says {key}"
                refuse(f"{said}: it was written by hand, so change it there")
            drawn = inspection.remade(read_decided_one(known.path, known.sheet, self._reading, study), study)
            try:
                write_file(self.manifest, content)
            except OSError as error:
                refuse(
                    f"{self.manifest}: can't be written ({error.strerror}); check the rights of the folder"
                )
            inspection.shown[place], inspection.study = drawn, study
            self._seen = content
            done = "taken back in" if value is None else "written into"
            return f"{key} of {file} is {done} {MANIFEST}"

    def _current(self) -> Inspection:
        content = self.manifest.read_bytes() if self.manifest.exists() else b""
        if self._inspection is None or content != self._seen:
            self._inspection, self._seen = self._inspect(), content
        return self._inspection


def _value(key: str, value: Any, recording: InspectedRecording) -> float | bool | None:
    """A value that can be of this recording; ``None`` takes a decision back."""
    if value is None:
        return None
    if key in _SWITCHES:
        return _SWITCHES[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        refuse(f"{key} must be a number")
    low, high, unit = _range(key, recording)
    if not low < value <= high:
        refuse(f"{key} = {value:g} is outside the record: give {low:g} to {high:g} {unit}")
    return float(value)


def _range(key: str, recording: InspectedRecording) -> tuple[float, float, str]:
    """Smallest and largest value: times of the record, and its travel with as much again on either side."""
    first, last = recording.document.first.time_s, recording.document.last.time_s
    if key != "contact_mm":
        return first, last, "s"
    travel = recording.drawn.displacement_mm
    low, high = float(travel.min()), float(travel.max())
    return low - (high - low), high + (high - low), "mm"
