"""Readers: a recipe says how sure it is of a file, and reads it into tables.

A recipe looks at an :class:`InputFile`, which was opened, hashed and laid out once for all of them, and gives
a confidence from 0 (not mine) to 1 (certainly mine) with its reason.  The surest recipe reads.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from tissueid.arrays import FloatArray
from tissueid.errors import InputError
from tissueid.flags import Flag
from tissueid.ingest.layout import Layout, find_layout, results_flag
from tissueid.ingest.loading import load_bytes
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import Text, decode_text
from tissueid.ingest.unpacking import BROKEN_ARCHIVE
from tissueid.ingest.vocabulary import Channel
from tissueid.trial import Protocol

_ZIP_MAGIC = b"PK\x03\x04"
_WORKBOOK_MAGIC = (_ZIP_MAGIC, b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")
#: A member of every archive that a force microscope saves ends so.
_SEGMENT_HEADER = "/segment-header.properties"
#: A zip archive with a member that begins so is an .xlsx, .xlsb or .ods.
_WORKBOOK_PARTS = ("xl/", "[Content_Types]", "mimetype", "content.xml")
#: Below this a hash is faster than a thread.
_THREAD_FROM_BYTES = 1 << 24

Detection = tuple[float, str]
#: No confidence: a reason is told of the surest recipe alone.
NOT_MINE: Detection = (0.0, "not mine")


@dataclass(frozen=True, slots=True)
class InputFile:
    """A file in memory, with what every recipe needs to know of it."""

    path: str  # as the user named it
    data: bytes
    options: ReadOptions
    digest: Future[str] | str
    text: Text | None = None  # the decoded file; ``None`` for a workbook and for what is no text
    layout: Layout | None = None  # where the table stands in the text
    fault: InputError | None = None  # why there is no layout

    def decoded(self) -> Text:
        """The text; refused where the file is none."""
        if self.text is None:
            message = "this is no text; give the raw data export of the test machine"
            Place(self.path).refuse("not_an_export", message)
        return self.text

    def laid_out(self) -> tuple[Text, Layout]:
        """The text and its layout; refused where there is none."""
        if self.fault is not None:
            raise self.fault
        text = self.decoded()
        assert self.layout is not None  # noqa: S101 -- a text without a layout has its fault
        return text, self.layout

    @property
    def sha256(self) -> str:
        """Hash of the bytes; waits for it where it is still being computed."""
        return self.digest if isinstance(self.digest, str) else self.digest.result()

    @property
    def suffix(self) -> str:
        """Lower-case suffix of the file's name."""
        return Path(self.path).suffix.lower()


@dataclass(frozen=True, slots=True)
class Table:
    """One recording as read: channels of shape (n,) in s, mm, N, and what stood around them."""

    time_s: FloatArray
    displacement_mm: FloatArray
    force_N: FloatArray
    columns: Mapping[Channel, str]  # channel -> name as printed
    sheet: str | None = None
    encoding: str | None = None
    delimiter: str | None = None
    decimal: str | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)  # header entries
    specimen: str | None = None  # what the file itself calls the specimen
    flags: tuple[Flag, ...] = ()
    protocol: Protocol | None = None  # where the recipe knows more of it than the header entries say
    match: Match | None = None  # how the table was recognised, where the file is an archive of others
    axes: Mapping[str, str] = field(default_factory=dict)  # ``{"displacement": "strain"}`` and the like


@dataclass(frozen=True, slots=True)
class Recipe:
    """A reader."""

    key: str  # stable name, as in ``Source.recipe``
    description: str
    detect: Callable[[InputFile], Detection]  # confidence and reason
    #: A table, or the refusal in its place, for each trial; a refusal that is raised is the last.
    read: Callable[[InputFile], Iterator[Table | InputError]]

    def tables(self, file: InputFile) -> Iterator[Table | InputError]:
        """Every table of a file, or the refusal in its place."""
        try:
            yield from self.read(file)
        except InputError as error:
            yield error


@dataclass(frozen=True, slots=True)
class Match:
    """Recipe that reads a file, with its certainty and reason."""

    recipe: Recipe
    confidence: float
    reason: str


def packed_kind(data: bytes) -> Literal["workbook", "archive", "force curves"] | None:
    """Kind of what is packed: a workbook, an archive of files, or one of force curves; else ``None``."""
    if not data.startswith(_ZIP_MAGIC):
        return "workbook" if data.startswith(_WORKBOOK_MAGIC) else None
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
    except BROKEN_ARCHIVE:
        return "workbook"  # refused by the reader of workbooks
    if "header.properties" in names and any(name.endswith(_SEGMENT_HEADER) for name in names):
        return "force curves"
    return "workbook" if any(name.startswith(_WORKBOOK_PARTS) for name in names) else "archive"


def open_input(path: str | Path, options: ReadOptions) -> InputFile:
    """Read a file, start its hash beside the parsing, and lay out its text."""
    name = str(path)
    data = load_bytes(path, Place(name))
    return lay_out(name, data, options, _start_digest(data))


def lay_out(path: str, data: bytes, options: ReadOptions, digest: Future[str] | str) -> InputFile:
    """Bytes as every recipe wants to see them: decoded and laid out where they are text."""
    if data.startswith(_WORKBOOK_MAGIC):
        return InputFile(path, data, options, digest)
    place = Place(path)
    text = None
    try:
        text = decode_text(data, place)
        layout = find_layout(text, options, place)
    except InputError as error:
        return InputFile(path, data, options, digest, text, None, error)
    if layout.stop is not None:
        # the table of results below the rows is left out, and that is said
        first = text.data.count(b"\n", 0, layout.stop) + 1
        last = first + text.data[layout.stop :].rstrip().count(b"\n")
        said = (*text.flags, results_flag(first, last))
        text = replace(text, data=text.data[: layout.stop], flags=said)
    return InputFile(path, data, options, digest, text, layout)


def _start_digest(data: bytes) -> Future[str] | str:
    """SHA-256 of the bytes; hashlib releases the interpreter: a large file is hashed while parsed."""
    if len(data) < _THREAD_FROM_BYTES:
        return hashlib.sha256(data).hexdigest()
    pool = ThreadPoolExecutor(1, thread_name_prefix="sha256")
    try:
        return pool.submit(lambda: hashlib.sha256(data).hexdigest())
    finally:
        pool.shutdown(wait=False)
