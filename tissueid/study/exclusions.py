"""Take a recording out of a study, or back in, in the study file itself; its comments stay."""

from __future__ import annotations

import os
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import tomlkit

from tissueid.errors import refuse
from tissueid.ingest.manifest import MANIFEST, read_study
from tissueid.manifest import Study
from tissueid.store.files import write_file
from tissueid.study.recordings import picked_sheet


def find_manifest(trial: str, named: str | None = None) -> Path:
    """The study file of a recording: named, nearest above it, or of this folder; UsageError without any."""
    if named is not None:
        path = Path(named)
        return path / MANIFEST if path.is_dir() else path
    file = Path(picked_sheet(trial)[0]).absolute()
    folders = (*(file.parents if file.exists() else ()), Path.cwd(), *file.parents)
    found = next((folder / MANIFEST for folder in folders if (folder / MANIFEST).is_file()), None)
    if found is None:
        way_out = "name it with --study, or run `tissueid study init`"
        refuse(f"there is no {MANIFEST} beside or above {trial}: {way_out}")
    return found


def _located(trial: str, manifest: Path) -> tuple[str, str | None]:
    """File relative to the manifest's folder, and sheet; UsageError where there is no such recording."""
    name, sheet = picked_sheet(trial)
    file = next((file for file in (Path(name), manifest.parent / name) if file.is_file()), None)
    if file is None:
        beside = sorted({*_names(Path(name).parent), *_names(manifest.parent)})
        near = get_close_matches(Path(name).name, beside, n=2)
        hint = f"; did you mean {' or '.join(near)}?" if near else ""
        refuse(f"{name}: there is no such recording, here or beside {manifest}{hint}")
    relative = os.path.relpath(os.path.realpath(file), os.path.realpath(manifest.parent))
    return Path(relative).as_posix(), sheet


def _names(folder: Path) -> list[str]:
    """Files of a folder but for the manifest; none where it can't be listed."""
    try:
        return [file.name for file in folder.iterdir() if file.is_file() and file.name != MANIFEST]
    except OSError:
        return []


def _document(manifest: Path) -> tuple[Study, tomlkit.TOMLDocument, bool]:
    """The study, its text to edit, and whether its lines end in CRLF; refused where it is not valid."""
    study = read_study(manifest)
    text = manifest.read_bytes().decode("utf-8-sig")
    return study, tomlkit.parse(text.replace("\r\n", "\n")), "\r\n" in text


def _write(manifest: Path, document: tomlkit.TOMLDocument, *, crlf: bool) -> None:
    text = tomlkit.dumps(document)
    write_file(manifest, (text.replace("\n", "\r\n") if crlf else text).encode("utf-8"))


def _is(entry: Any, file: str, sheet: str | None) -> bool:
    """True for the [[exclude]] table of exactly this recording."""
    return bool(entry.get("file") == file and entry.get("sheet") == sheet)


def _named(file: str, sheet: str | None) -> str:
    return file if sheet is None else f"{file}::{sheet}"


def exclude(trial: str, because: str, *, manifest: Path) -> tuple[str, str | None]:
    """Add ``[[exclude]]`` for ``file`` or ``file::sheet``; its name in the manifest, and the reason before.

    Raises UsageError: no such recording, or no reason; InputError: the manifest is not valid; it is left
    as it was.
    """
    if not because.strip():
        refuse("an exclusion needs a reason: --because TEXT")
    file, sheet = _located(trial, manifest)
    _, document, crlf = _document(manifest)
    known = next((one for one in document.get("exclude", []) if _is(one, file, sheet)), None)
    replaced = None if known is None else str(known["because"])
    if known is not None:
        known["because"] = because
    else:
        place = {"file": file} if sheet is None else {"file": file, "sheet": sheet}
        entry: Any = tomlkit.item({**place, "because": because})
        entry.add(tomlkit.nl())
        if "exclude" not in document:
            document.add(tomlkit.nl())
            document.append("exclude", tomlkit.aot())
        tables: Any = document["exclude"]
        tables.append(entry if isinstance(tables, tomlkit.items.AoT) else entry.unwrap())
    _write(manifest, document, crlf=crlf)
    return _named(file, sheet), replaced


def include(trial: str, *, manifest: Path) -> str:
    """Take a recording's ``[[exclude]]`` out again; its name in the manifest.

    Raises UsageError: it is not excluded, or by a glob or for a whole workbook, which is for people to
    change.
    """
    file, sheet = _located(trial, manifest)
    study, document, crlf = _document(manifest)
    tables: Any = document.get("exclude", [])
    own = [i for i, entry in enumerate(tables) if _is(entry, file, sheet)]
    if not own:
        if study.decision(str(manifest.parent / file), sheet).excluded is None:
            refuse(f"{trial} is not excluded in {manifest}")
        real = study.real_path(str(manifest.parent / file))
        line = next(entry.line for entry in study.exclusions if entry.names(real, sheet))
        refuse(f"{trial} is excluded with others by line {line} of {manifest}: change that table")
    for i in reversed(own):
        del tables[i]
    if not tables:
        document.remove("exclude")
    _write(manifest, document, crlf=crlf)
    return _named(file, sheet)
