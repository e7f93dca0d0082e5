"""A study as an RO-Crate 1.1 (doi 10.5281/zenodo.4541002), with names of people and places or without.

A header may hold anything, so that recordings without names are written anew, every digit kept.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import mimetypes
import os
import re
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

import tomlkit

from tissueid.errors import refuse
from tissueid.ingest.manifest import MANIFEST, SCHEMA
from tissueid.manifest import Study
from tissueid.store.files import json_bytes, write_file
from tissueid.trial import Trial

#: Name of the salt's file beside the manifest; it is never exported.
SALT_FILE = ".study-salt"
_SALT_BYTES = 32
#: Hexadecimal digits of a hash: 40 bits, no clash among thousands of specimens.
_DIGITS = 10
#: Keys that name people, places or days, or are free text about them.
REMOVED = ("authors", "laboratory", "operator", "date", "ethics", "doi", "description", "notes")
_HASHED = {"specimen": "S", "name": "S", "donor": "D"}
#: Removed names shorter than this are not looked for in other text: they would blacken words.
_SHORTEST_NAME = 3
_BLACKENED = "[removed]"


def read_salt(folder: Path) -> bytes:
    """The salt of a study, made where there is none."""
    file = folder / SALT_FILE
    if not file.is_file():
        write_file(file, secrets.token_hex(_SALT_BYTES).encode("ascii") + b"\n")
    return file.read_bytes().strip()


def recording_text(trial: Trial) -> str:
    """A recording as plain CSV, shortest numbers that read back equal."""
    columns = (trial.time_s.tolist(), trial.displacement_mm.tolist(), trial.force_N.tolist())
    rows = (",".join(map(repr, row)) for row in zip(*columns, strict=True))
    head = f"(s),({trial.axes.length}),({trial.axes.force})"
    return "\n".join(["Time,Displacement,Force", head, *rows, ""])


class Anonymiser:
    """Takes names out of one study: specimens and donors become keyed hashes, other names are blackened."""

    def __init__(self, study: Study, specimens: Iterable[str], salt: bytes) -> None:
        self._salt = salt
        names = set(_names(study)) | {name for name in specimens if len(name) >= _SHORTEST_NAME}
        longest_first = sorted(names, key=len, reverse=True)
        self._names = re.compile("|".join(map(re.escape, longest_first)), re.IGNORECASE) if names else None

    def hashed(self, name: str, letter: str = "S") -> str:
        """A name as its keyed hash: ``"S-3fa9c1b2d4"``."""
        digest = hmac.new(self._salt, name.encode("utf-8"), hashlib.sha256).hexdigest()
        return f"{letter}-{digest[:_DIGITS]}"

    def text(self, text: str) -> str:
        """Text without the names that were taken out."""
        return text if self._names is None else self._names.sub(_BLACKENED, text)

    def table(self, table: Mapping[str, Any], *, named: bool = False) -> dict[str, Any]:
        """A table without what identifies; ``named`` where its ``name`` is a specimen's."""
        kept: dict[str, Any] = {}
        for key, value in table.items():
            if key in REMOVED:
                continue
            if key in _HASHED and (key != "name" or named):
                kept[key] = self.hashed(str(value), _HASHED[key])
            elif isinstance(value, str):
                kept[key] = self.text(value)
            else:
                kept[key] = value
        return kept


def _names(study: Study) -> Iterable[str]:
    """Every name in the study that must not turn up elsewhere."""
    for table in (study.about, *study.specimens.values()):
        for key in ("operator", "laboratory", "donor", "name", "ethics"):
            if len(str(table.get(key, ""))) >= _SHORTEST_NAME:
                yield str(table[key])
        for author in table.get("authors", ()):
            yield from (part for part in (author, *author.split()) if len(part) >= _SHORTEST_NAME)
    operator = str(study.about.get("operator", ""))
    yield from (part for part in operator.split() if len(part) >= _SHORTEST_NAME)


METADATA = "ro-crate-metadata.json"
_CONTEXT = "https://w3id.org/ro/crate/1.1/context"
_PROFILE = "https://w3id.org/ro/crate/1.1"
_FRAME = "frame.json"
#: The context of 1.1 has no word for a hash.
_TERMS = {"sha256": "https://schema.org/sha256"}
_MEDIA = {".toml": "application/toml", ".tra": "text/plain", ".csv": "text/csv"}


@dataclass(frozen=True, slots=True)
class CrateFile:
    """One file of a crate: its name inside, its bytes, and what it is."""

    name: str
    content: bytes
    description: str


def crate_files(
    study: Study, trials: Sequence[Trial], anonymiser: Anonymiser | None = None
) -> list[CrateFile]:
    """Files of a crate beside its metadata; an anonymiser has recordings written anew under numbers."""
    if anonymiser is None:
        return _as_they_are(study, trials)
    names = {trial: f"trial-{i:03d}.csv" for i, trial in enumerate(map(_key, trials), start=1)}
    files = [
        CrateFile(
            names[_key(trial)], recording_text(trial).encode("utf-8"), "recording: time, displacement, force"
        )
        for trial in trials
    ]
    frame = _frame_file(study)
    if frame is not None:
        # without the names of the recordings behind it
        document = json.loads(Path(frame).read_bytes())
        for i, source in enumerate(document["sources"], start=1):
            source["path"], source["sheet"] = f"rigid-{i}", None
        files.insert(0, CrateFile(_FRAME, json_bytes(document), _ABOUT[_FRAME]))
    text = _anonymous_manifest(study, trials, names, anonymiser)
    return [CrateFile(MANIFEST, text.encode("utf-8"), _ABOUT[MANIFEST]), *files]


_ABOUT = {
    MANIFEST: "study file: specimens, protocols, calibration",
    _FRAME: "deflection of the machine's frame",
}


def _frame_file(study: Study) -> str | None:
    return None if study.calibration.frame is None else study.calibration.frame.path


def _key(trial: Trial) -> tuple[str, str | None]:
    return trial.source.path, trial.source.sheet


def _as_they_are(study: Study, trials: Sequence[Trial]) -> list[CrateFile]:
    """The study file, the frame file and the recordings, byte for byte."""
    root = Path(study.path).parent
    paths = {study.path: _ABOUT[MANIFEST]}
    frame = _frame_file(study)
    if frame is not None:
        paths[frame] = _ABOUT[_FRAME]
    for trial in trials:
        paths.setdefault(trial.source.path, f"recording, read as {trial.source.recipe}")
    files = []
    for path, about in paths.items():
        name = PurePosixPath(Path(os.path.relpath(os.path.realpath(path), os.path.realpath(root))).as_posix())
        if ".." in name.parts or name.is_absolute():
            refuse(f"{path} lies outside {root}: move it into the study's folder, or export with --anonymise")
        files.append(CrateFile(str(name), Path(path).read_bytes(), about))
    return files


def _anonymous_manifest(
    study: Study, trials: Sequence[Trial], names: Mapping[tuple[str, str | None], str], anonymiser: Anonymiser
) -> str:
    """The study file of the renamed recordings; globs are written out, one table a recording."""
    document = tomlkit.document()
    document["schema"] = SCHEMA
    document["study"] = anonymiser.table(study.about)
    calibration = dict(study.calibration.values)
    if _frame_file(study) is not None:
        calibration["frame"] = _FRAME
    document["calibration"] = calibration
    document["tip"] = anonymiser.table(study.tip)
    of_trial = [study.decision(*_key(one)).trial.get("specimen", one.specimen) for one in trials]
    used = dict.fromkeys([*study.specimens, *of_trial])
    specimens = [{"name": name, **study.specimens.get(name, {})} for name in used]
    document["specimen"] = [anonymiser.table(row, named=True) for row in specimens]
    document["protocol"] = [anonymiser.table(row) for row in study.protocols.values()]
    rows: dict[str, list[dict[str, Any]]] = {"trial": [], "override": [], "exclude": []}
    for trial in trials:
        file = {"file": names[_key(trial)]}
        decision = study.decision(*_key(trial))
        said = {**decision.trial, "specimen": decision.trial.get("specimen", trial.specimen)}
        rows["trial"].append(file | anonymiser.table(said))
        # columns and units were applied when the recording was read
        override = {key: value for key, value in decision.override.items() if not isinstance(value, Mapping)}
        if set(override) - {"because"}:
            rows["override"].append(file | anonymiser.table(override))
        if decision.excluded is not None:
            rows["exclude"].append(file | {"because": anonymiser.text(decision.excluded)})
    document.update({key: value for key, value in rows.items() if value})
    return tomlkit.dumps(document)


def _media_type(name: str) -> str:
    suffix = PurePosixPath(name).suffix.lower()
    return _MEDIA.get(suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"


def crate_metadata(
    study: Study, files: Sequence[CrateFile], *, published: str, anonymiser: Anonymiser | None = None
) -> dict[str, Any]:
    """The document of ``ro-crate-metadata.json``; UsageError where the study has no licence."""
    about = dict(study.about) if anonymiser is None else anonymiser.table(study.about)
    if "licence" not in about:
        refuse(f'{study.path}: a crate needs a licence: write licence = "CC-BY-4.0" (or yours) under [study]')
    text = about["licence"]
    # its address, or that of its SPDX name
    address = text if "://" in text else f"https://spdx.org/licenses/{quote(text)}"
    licence = {"@id": address, "@type": "CreativeWork", "name": text}
    authors = [
        {"@id": f"#author-{i}", "@type": "Person", "name": name}
        for i, name in enumerate(about.get("authors", ()), start=1)
    ]
    entries = [
        {
            "@id": quote(file.name),
            "@type": "File",
            "name": file.name,
            "description": file.description,
            "contentSize": str(len(file.content)),
            "encodingFormat": _media_type(file.name),
            "sha256": hashlib.sha256(file.content).hexdigest(),
        }
        for file in files
    ]
    title = about.get("title", "Indentation of soft tissue")
    root: dict[str, Any] = {
        "@id": "./",
        "@type": "Dataset",
        "name": title,
        "description": about.get(
            "description", f"{title}: force and displacement of a tool pressed into tissue."
        ),
        "datePublished": published,
        "license": {"@id": licence["@id"]},
        "hasPart": [{"@id": entry["@id"]} for entry in entries],
    }
    if authors:
        root["author"] = [{"@id": author["@id"]} for author in authors]
    if "doi" in about:
        root["identifier"] = f"https://doi.org/{about['doi'].removeprefix('https://doi.org/')}"
    itself = {
        "@id": METADATA,
        "@type": "CreativeWork",
        "conformsTo": {"@id": _PROFILE},
        "about": {"@id": "./"},
    }
    return {"@context": [_CONTEXT, _TERMS], "@graph": [itself, root, licence, *authors, *entries]}


def write_crate(out: Path, files: Sequence[CrateFile], metadata: Mapping[str, Any]) -> None:
    """Write a crate into a folder that is empty or not there, the metadata last; else UsageError."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        refuse(f"{out} is not an empty folder: choose another")
    for file in files:
        target = out / file.name
        target.parent.mkdir(parents=True, exist_ok=True)
        write_file(target, file.content)
    write_file(out / METADATA, json_bytes(metadata))
