"""Files written and read in one line each."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import openpyxl

from tissueid.errors import InputError
from tissueid.ingest import ReadOptions, read_each
from tissueid.trial import Trial


def put(path: Path, content: str | bytes, encoding: str = "utf-8") -> Path:
    path.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
    return path


def zipped(parts: Mapping[str, bytes | str]) -> bytes:
    """An archive of these members."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return out.getvalue()


def workbook(path: Path, sheets: dict[str, Iterable[Sequence[object]]]) -> Path:
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def read(path: Path, options: ReadOptions | None = None) -> Trial:
    """The one trial of a file."""
    (item,) = read_each(path, options)
    assert isinstance(item, Trial), item
    return item


def refusal(path: Path, options: ReadOptions | None = None) -> InputError:
    """The one refusal of a file."""
    (item,) = read_each(path, options)
    assert isinstance(item, InputError)
    return item


def codes(trial: Trial) -> list[str]:
    return [flag.code for flag in trial.flags]
