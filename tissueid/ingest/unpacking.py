"""Size of a workbook in memory: told before the parser that builds it is let in.

A sheet is built as a dense rectangle up to its last cell: one stray cell at ``XFD1048576`` asks for seventeen
thousand million cells, which the parser does not survive.
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator
from functools import lru_cache
from typing import IO

#: What a damaged archive raises.
BROKEN_ARCHIVE = (
    zipfile.BadZipFile,
    zlib.error,
    OSError,
    ValueError,
    NotImplementedError,
    RuntimeError,
    EOFError,
)

#: No honest workbook, file of curves or member of an archive unpacks to more [bytes]: a million rows of four
#: cells are 150 MB.
UNPACKED_BYTES = 1 << 29
#: Numbers shrink to a tenth, a bomb to a thousandth; below some size [bytes] the ratio says nothing.
LARGEST_RATIO = 200
RATIO_FROM_BYTES = 1 << 24
#: Cells of one sheet, filled or not: all rows that a sheet can have, in 32 columns.
MOST_CELLS = 1 << 25

_PIECE_BYTES = 1 << 20
#: A reference is shorter; pieces overlap by so much.
_OVERLAP_BYTES = 64
#: Sheets of text may lie anywhere.
_SHEET = re.compile(r"(?i)(?:.*\.(xml)|xl/worksheets/[^/]+\.(bin))")
_FAR_CELL = re.compile(rb"""\sr\s*=\s*["']([A-Z]{2,}\d+|[A-Z]?\d{6,})["']""")
_ROW = re.compile(rb"""<(?:\w+:)?row\b[^>]{0,200}?\sr\s*=\s*["'](\d+)["']""")
#: Record types of a binary sheet: a row, and the cells with a value.
_ROW_RECORD, _CELL_RECORDS = 0, range(1, 12)


@lru_cache(maxsize=1)
def too_much(data: bytes) -> str | None:
    """Why a zipped workbook can't be built in bounded memory, ``None`` where it can."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = archive.infolist()
        unpacked = sum(entry.file_size for entry in entries)
        if unpacked > UNPACKED_BYTES:
            return f"it would unpack to {unpacked / 2**30:.1f} GiB"
        for entry in entries:
            # the parser refuses what unpacks to more than is declared: the declared size may be believed
            if entry.file_size > max(RATIO_FROM_BYTES, LARGEST_RATIO * entry.compress_size):
                ratio = entry.file_size / max(entry.compress_size, 1)
                return f"{entry.filename} would unpack to {ratio:.0f} times its size"
        for entry in entries:
            kind = _SHEET.fullmatch(entry.filename)
            if kind is None:
                continue
            with archive.open(entry) as stream:
                rows, columns = _xml_extent(stream) if kind[1] else _binary_extent(stream)
            if rows * columns > MOST_CELLS:
                return (
                    f"{entry.filename} reaches to row {rows}, column {columns}: delete the stray cells far"
                    " from the table"
                )
    return None


def _pieces(stream: IO[bytes]) -> Iterator[bytes]:
    """A stream in pieces, each with the end of the one before."""
    end = b""
    while piece := stream.read(_PIECE_BYTES):
        yield end + piece
        end = piece[-_OVERLAP_BYTES:]


def _xml_extent(stream: IO[bytes]) -> tuple[int, int]:
    """Rows and columns of a sheet, at least 26 columns: those of one letter are not looked for."""
    rows, columns = 0, 26
    for piece in _pieces(stream):
        rows = max(rows, *map(int, _ROW.findall(piece)), 0)
        for reference in set(_FAR_CELL.findall(piece)):
            letters = reference.rstrip(b"0123456789")
            column = 0
            for letter in letters:
                column = 26 * column + letter - 64
            rows, columns = max(rows, int(reference[len(letters) :])), max(columns, column)
    return rows, columns


def _binary_extent(stream: IO[bytes]) -> tuple[int, int]:
    """Rows and columns of a sheet of binary records: type, size, content."""
    data, at, rows, columns = stream.read(), 0, 0, 0
    while at < len(data):
        kind, at = _varint(data, at, 2)
        size, at = _varint(data, at, 4)
        if kind == _ROW_RECORD and size >= 4 and at + 4 <= len(data):
            rows = max(rows, struct.unpack_from("<I", data, at)[0] + 1)
        elif kind in _CELL_RECORDS and size >= 4 and at + 4 <= len(data):
            columns = max(columns, struct.unpack_from("<I", data, at)[0] + 1)
        at += size
    return rows, columns


def _varint(data: bytes, at: int, most: int) -> tuple[int, int]:
    """A number of seven bits a byte, and where it ends."""
    value = 0
    for shift in range(most):
        if at >= len(data):
            break
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << (7 * shift)
        if byte < 0x80:
            break
    return value, at
