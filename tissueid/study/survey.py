"""Survey of recordings and their specimens: every file is read once, and nothing is segmented.

A file whose bytes are those that an earlier run saw, read in the same way, is hashed and not parsed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissueid.errors import InputError
from tissueid.ingest import ReadOptions
from tissueid.manifest import Study
from tissueid.result import Refusal
from tissueid.store.files import json_bytes, sha256_of
from tissueid.store.index import RecordingRow
from tissueid.study.partition import StudyParts
from tissueid.study.recordings import read_decided
from tissueid.study.tasks import packed, unpacked, versions
from tissueid.trial import Trial

#: The task of this module.
SURVEY = "tissueid.study.survey:survey_files"
#: Keys of ``[[override]]`` that decide how a file is read.
_READING = ("columns", "units", "axes")


@dataclass(frozen=True, slots=True)
class NamedFile:
    """One file to look into."""

    position: int  # its place in the order of files
    path: str  # as the user named it
    options: ReadOptions  # with the sheet that was named, if one was
    study: Study | None  # what the study says of this file
    known: str | None = None  # SHA-256 it had when it was last read in this way


@dataclass(frozen=True, slots=True)
class Found:
    """Contents of a file: one recording, or the refusal in its place."""

    sheet: str | None
    sha256: str
    specimen: str  # as the file was read
    samples: int
    refusal: Refusal | None = None


def refusal_of(error: InputError) -> Refusal:
    """The refusal that an error of a reader stands for."""
    return Refusal(error.path, error.sheet, error.code, error.message, error.line, error.column)


def found_in(item: Trial | InputError) -> Found:
    """Contents of a file by one item of its reader."""
    if isinstance(item, InputError):
        return Found(item.sheet, "", "", 0, refusal_of(item))
    return Found(item.source.sheet, item.source.sha256, item.specimen, int(item.time_s.size))


def look_into(file: NamedFile, keep: Callable[[Trial], None] | None = None) -> list[Found] | None:
    """Everything a file holds; ``None`` where it is the file that was known.

    ``keep``: told every trial that was read.
    """
    if file.known:
        try:
            if sha256_of(Path(file.path)) == file.known:
                return None
        except OSError:
            # the reader says what is wrong with it
            pass
    found = []
    for item in read_decided(Path(file.path), file.options, file.study):
        found.append(found_in(item))
        if keep is not None and isinstance(item, Trial):
            keep(item)
    return found


def survey_files(payload: bytes) -> bytes:
    """The task: a list of :class:`NamedFile` in, a list of (position, what each holds) out."""
    files: Sequence[NamedFile] = unpacked(payload)
    return packed([(file.position, look_into(file)) for file in files])


def reading_key(options: ReadOptions, study: Study | None) -> str:
    """Hash of everything that decides how a file is read."""
    said: list[Any] = []
    if study is not None:
        said = [
            [entry.sheet, {key: entry.values[key] for key in _READING if key in entry.values}]
            for entry in study.overrides
            if any(key in entry.values for key in _READING)
        ]
    asked = {name: getattr(options, name) for name in sorted(options.__dataclass_fields__)}
    text = json_bytes({"asked": asked, "said": said, "versions": versions()})
    return hashlib.sha256(text).hexdigest()[:32]


def recording_rows(path: str, found: Sequence[Found], parts: StudyParts | None) -> Iterator[RecordingRow]:
    """Rows of a file's contents, with the study's decisions on them."""
    study = None if parts is None else parts.of_file(path)
    for one in found:
        specimen, kind = one.specimen, "trial"
        decision = None if study is None else study.decision(path, one.sheet)
        if one.refusal is not None:
            kind = "refused" if decision is None or decision.excluded is None else "refused_excluded"
        elif study is not None and decision is not None:
            frame = study.calibration.frame
            specimen = str(decision.trial.get("specimen", specimen))
            if decision.excluded is not None or (frame is not None and one.sha256 in frame.sources):
                kind = "excluded"
            elif study.only_listed and not decision.listed:
                kind = "unlisted"
        refusal = None if one.refusal is None else _fields(one.refusal)
        yield RecordingRow(path, one.sheet, one.sha256, one.specimen, one.samples, kind, specimen, refusal)


def found_again(rows: Sequence[RecordingRow]) -> list[Found]:
    """Contents of a file as an earlier run put them down."""
    return [
        Found(
            row.sheet,
            row.sha256,
            row.raw,
            row.samples,
            None if row.refusal is None else Refusal(**row.refusal),
        )
        for row in rows
    ]


def _fields(refusal: Refusal) -> dict[str, Any]:
    return {name: getattr(refusal, name) for name in refusal.__dataclass_fields__}
