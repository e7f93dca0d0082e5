"""An inspection with decisions taken on its page: study.toml is written, the recording segmented anew."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tissueid.documents.inspect import Trial as InspectedTrial
from tissueid.errors import UsageError
from tissueid.ingest import ReadOptions
from tissueid.ingest.manifest import MANIFEST, study_of
from tissueid.manifest import Study
from tissueid.report.inspect_page import InspectedRecording
from tissueid.store.files import write_file
from tissueid.study.corrections import CORRECTED, Correction, corrected_text, stated_by_hand
from tissueid.study.inspected import Inspection, relative_name
from tissueid.study.recordings import read_decided_one
from tissueid.trial import Trial

#: Decisions that are a switch, and what it is switched to.
_SWITCHES = {"rupture": False, "exclude": True}


class CorrectedInspection:
    """Inspection that the page's server corrects; one request at a time.

    ``manifest``: the study file, which need not be there yet; ``inspect``: inspects everything, by the study
    file as it stands; ``reading``: of the run.
    """

    def __init__(self, manifest: Path, inspect: Callable[[], Inspection], reading: ReadOptions) -> None:
        self.manifest = manifest
        self._inspect, self._reading = inspect, reading
        self._lock = threading.Lock()
        self._seen: bytes | None = None
        self._inspection: Inspection | None = None

    def page(self) -> str:
        """The page by what study.toml says now.

        Raises InputError: study.toml is not valid.
        """
        with self._lock:
            return self._current().page(served=True)

    def decide(self, words: Mapping[str, Any]) -> str:
        """Take a decision, or take it back.

        ``words``: ``path``, ``sheet``, ``key``, ``value`` and ``because``, as the page sends them.  Returns
        what was written.  Raises UsageError: it makes no sense for this recording; study.toml is as it was;
        InputError: study.toml is not valid, or would not be.
        """
        with self._lock:
            return self._decide(words)

    def _current(self) -> Inspection:
        content = self._content()
        if self._inspection is None or content != self._seen:
            self._inspection, self._seen = self._inspect(), content
        return self._inspection

    def _content(self) -> bytes:
        return self.manifest.read_bytes() if self.manifest.exists() else b""

    def _decide(self, words: Mapping[str, Any]) -> str:
        inspection = self._current()
        path, sheet, key = words.get("path"), words.get("sheet"), words.get("key")
        place = inspection.place(str(path), sheet)
        if place is None or key not in CORRECTED:
            msg = "no such recording or decision on this page: load it again"
            raise UsageError(msg)
        known = inspection.shown[place].document
        value = _value(str(key), words.get("value"), inspection.shown[place])
        file = relative_name(known.path, self.manifest.parent.resolve())
        correction = Correction(str(key), file, known.sheet, value, str(words.get("because") or ""))
        content = corrected_text((self._seen or b"").decode("utf-8-sig"), correction).encode("utf-8")
        study = study_of(content, self.manifest)
        if value is None:
            _refuse_hand(study, str(key), known)
        drawn = inspection.remade(_read(known, self._reading, study), study)
        self._store(content)
        inspection.put(place, drawn, study)
        self._seen = content
        return _said(correction)

    def _store(self, content: bytes) -> None:
        try:
            write_file(self.manifest, content)
        except OSError as error:
            msg = f"{self.manifest}: can't be written ({error.strerror}); check the rights of the folder"
            raise UsageError(msg) from error


def _read(known: InspectedTrial, reading: ReadOptions, study: Study) -> Trial:
    return read_decided_one(known.path, known.sheet, reading, study)


def _said(correction: Correction) -> str:
    if correction.value is None:
        return f"{correction.key} of {correction.file} is taken back in {MANIFEST}"
    return f"{correction.key} of {correction.file} is written into {MANIFEST}"


def _refuse_hand(study: Study, key: str, known: InspectedTrial) -> None:
    line = stated_by_hand(study, key, known.path, known.sheet)
    if line is not None:
        msg = f"line {line} of {MANIFEST} still says {key}: it was written by hand, so change it there"
        raise UsageError(msg)


def _value(key: str, value: Any, recording: InspectedRecording) -> float | bool | None:
    """A value that can be of this recording; ``None`` takes a decision back."""
    if value is None:
        return None
    if key in _SWITCHES:
        return _SWITCHES[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        msg = f"{key} must be a number"
        raise UsageError(msg)
    low, high, unit = _range(key, recording)
    if not low < value <= high:
        msg = f"{key} = {value:g} is outside the record: give {low:g} to {high:g} {unit}"
        raise UsageError(msg)
    return float(value)


def _range(key: str, recording: InspectedRecording) -> tuple[float, float, str]:
    """Smallest and largest value: times of the record, and its travel with as much again on either side."""
    first, last = recording.document.first.time_s, recording.document.last.time_s
    if key != "contact_mm":
        return first, last, "s"
    travel = recording.drawn.displacement_mm
    low, high = float(travel.min()), float(travel.max())
    return low - (high - low), high + (high - low), "mm"
