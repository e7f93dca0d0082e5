"""Recipe for zip archives of exports: every member is read as if it stood in a folder.

Unpacking is bounded by what comes out, not by what the archive says of itself.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import PurePosixPath

from tissueid.errors import InputError
from tissueid.ingest.header import protocol_of
from tissueid.ingest.recipe import NOT_MINE, Detection, InputFile, Match, Recipe, Table, lay_out, packed_kind
from tissueid.ingest.refusals import Place, moved
from tissueid.ingest.text import ARRAYS, refuse_foreign
from tissueid.ingest.unpacking import BROKEN_ARCHIVE, LARGEST_RATIO, RATIO_FROM_BYTES, UNPACKED_BYTES

#: Largest sum of all members, unpacked [bytes].
ARCHIVE_BYTES = 1 << 30
MOST_MEMBERS = 10_000
#: Suffixes of prose and other data as well: such files are passed over where they hold no table.
PROSE_SUFFIXES = (".asc", ".dat", ".ddf", ".tab", ".txt")
#: Suffixes of recordings, in a folder or an archive.
SUFFIXES = (
    ".csv", ".tsv", ".tra", ".xls", ".xlsx", ".xlsm", ".xlsb", ".ods", ".jpk-force", ".jpk-force-map",
    ".jpk-qi-data", ".lvm", *PROSE_SUFFIXES,
)  # fmt: skip


def recordings_in(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    """Members that may be recordings, in natural order: no folders, hidden files or other kinds."""
    found = []
    for member in archive.infolist():
        path = PurePosixPath(member.filename.replace("\\", "/"))
        parts = [part for part in path.parts if part not in {".", ".."}]
        hidden = any(part.startswith((".", "~$", "__MACOSX")) for part in parts)
        if not member.is_dir() and not hidden and path.suffix.lower() in {*SUFFIXES, ""}:
            found.append(member)
    return found


def detect_archive(file: InputFile) -> Detection:
    """A zip archive that is no workbook."""
    return (1.0, "a zip archive of files") if packed_kind(file.data) == "archive" else NOT_MINE


def archive_recipe(match: Callable[[InputFile], Match]) -> Recipe:
    """The recipe, given how a member's own recipe is found."""
    about = "a zip archive of any of these files, one trial a member"
    return Recipe("zip", about, detect_archive, partial(_read, match=match))


def _read(file: InputFile, match: Callable[[InputFile], Match]) -> Iterator[Table | InputError]:
    place = Place(file.path)
    try:
        archive = zipfile.ZipFile(io.BytesIO(file.data))
    except BROKEN_ARCHIVE as error:
        place.refuse("unreadable_archive", f"the archive can't be opened ({str(error)[:120]}); pack it again")
    with archive:
        members = recordings_in(archive)
        if len(members) > MOST_MEMBERS:
            message = f"the archive has {len(members)} files, more than {MOST_MEMBERS}; unpack it"
            place.refuse("unreadable_archive", message)
        if len({member.header_offset for member in members}) < len(members):
            message = "files of the archive overlap, as in one made to fill the memory; pack it again"
            place.refuse("unreadable_archive", message)
        left, count = ARCHIVE_BYTES, 0
        for member in members:
            try:
                data = _unpacked(archive, member, left, Place(file.path, member.filename))
            except InputError as error:
                yield error
                count += 1
                continue
            left -= len(data)
            for item in _member(file, member.filename, data, match):
                count += 1
                yield item
    if count == 0:
        if archive.namelist() and all(name.endswith(".npy") for name in archive.namelist()):
            refuse_foreign(ARRAYS, place)
        names = ", ".join(map(repr, archive.namelist()[:10])) or "none"
        place.refuse("no_recording", f"the archive holds no recording; its files are {names}")


def _unpacked(archive: zipfile.ZipFile, member: zipfile.ZipInfo, left: int, place: Place) -> bytes:
    """The bytes of a member, as far as they are bounded."""
    limit = min(UNPACKED_BYTES, left)
    if member.compress_size > 0:
        limit = min(limit, max(RATIO_FROM_BYTES, LARGEST_RATIO * member.compress_size))
    if member.flag_bits & 1:
        place.refuse("unreadable_archive", "the file is protected by a password; unpack the archive")
    try:
        with archive.open(member) as stream:
            data = stream.read(limit + 1)
    except BROKEN_ARCHIVE as error:
        place.refuse("unreadable_archive", f"the file can't be unpacked ({str(error)[:120]}); pack it again")
    if len(data) > limit:
        place.refuse(
            "unreadable_archive",
            f"the file unpacks to more than {limit / 2**20:.0f} MiB, beyond any recording packed into"
            f" {member.compress_size} bytes; unpack the archive",
        )
    return data


def _member(
    file: InputFile, name: str, data: bytes, match: Callable[[InputFile], Match]
) -> Iterator[Table | InputError]:
    """The trials of one member, under its name."""
    place = Place(file.path, name)
    if packed_kind(data) == "archive":
        yield place.refusal("unreadable_archive", "an archive in an archive is not opened; unpack it")
        return
    inner = lay_out(name, data, file.options, file.digest)
    try:
        found = match(inner)
    except InputError as error:
        if PurePosixPath(name).suffix.lower() not in (*PROSE_SUFFIXES, ""):
            yield moved(error, path=file.path, sheet=_named(name, error.sheet))
        return
    for item in found.recipe.tables(inner):
        sheet = _named(name, item.sheet)
        if isinstance(item, InputError):
            yield moved(item, path=file.path, sheet=sheet)
        else:
            # the member's folder may say what kind of test it was
            path = f"{file.path}/{name}"
            protocol = item.protocol or protocol_of(item.metadata, path, decimal=item.decimal)
            yield replace(item, sheet=sheet, match=item.match or found, protocol=protocol)


def _named(member: str, sheet: str | None) -> str:
    return member if sheet is None else f"{member}::{sheet}"
