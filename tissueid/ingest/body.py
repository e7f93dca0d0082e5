"""The fast path through the rows: pieces of some megabytes, made plain, through pandas' C parser.

The parser is given the strictest settings it has, so that every short, long or odd row is an error; then, and
only then, the slow reader takes over.  Pieces are parsed by as many threads as there are processors.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import ByteArray, FloatArray
from tissueid.flags import Flag
from tissueid.ingest.broken_rows import lost_marks, refuse_broken
from tissueid.ingest.columns import Channels, ColumnChoice
from tissueid.ingest.layout import Layout
from tissueid.ingest.refusals import Place
from tissueid.ingest.rows import RowReader
from tissueid.ingest.text import Text
from tissueid.ingest.vocabulary import CHANNELS
from tissueid.own_process import threads

# "1.424,86200";"-2,04726" becomes 1424.86200;-2.04726.  A C parser told about quotes and thousands also reads
# 2,11,0828 and "1"5, and takes twice the time; so the marks are proved here, on the bits of the bytes, 64 to
# a word, and taken out.  The parity of the quotes says which bytes stand inside a pair, as a prefix
# exclusive-or of the bits of a word (x ^= x << 1, << 2, ... << 32); a thousands separator is a mark between
# two digits, in groups of 1-3 digits, not 0 first, then threes, then the decimal mark.
Mask = NDArray[np.bool_]
Words = NDArray[np.uint64]

_QUOTE, _TAB, _SPACE, _ZERO = 0x22, 0x09, 0x20, 0x30
#: Thousands separators as single bytes; typographic ones are first made an apostrophe.
_MARKS = (b",", b".", b"'", b" ")
_WIDE_MARKS = (b"\xc2\xa0", b"\xe2\x80\xaf", b"\xe2\x80\x99", b"\xa0")
_SHIFTS = tuple(np.uint64(1 << k) for k in range(6))
_TOP = np.uint64(63)
_MARKS_CHANGED = bytes.maketrans(b",.", b".,")


def _words(mask: Mask) -> Words:
    """The bits of a mask, 64 to a word, the first byte lowest."""
    packed = np.packbits(mask, bitorder="little")
    words = np.zeros(-(-packed.size // 8), dtype="<u8")
    words.view(np.uint8)[: packed.size] = packed
    return words


def _before(words: Words, count: int, *, edge: bool = False) -> Words:
    """Bits of the bytes that stand ``count`` before; in front of the first stands a line end, an edge."""
    moved = words << np.uint64(count)
    moved[1:] |= words[:-1] >> np.uint64(64 - count)
    if edge:
        moved[0] |= np.uint64((1 << count) - 1)
    return moved


def _behind(words: Words, count: int) -> Words:
    """Bits of the bytes that stand ``count`` behind."""
    moved = words >> np.uint64(count)
    moved[:-1] |= words[1:] << np.uint64(64 - count)
    return moved


def _inside_quotes(quote: Words) -> Words:
    """Bytes up to and including which an odd number of quotes stands."""
    words = quote.copy()
    for shift in _SHIFTS:
        words ^= words << shift
    odd = (words >> _TOP).astype(np.uint8)
    carry = np.bitwise_xor.accumulate(odd)
    words[1:] ^= np.where(carry[:-1] == 1, np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64(0))
    return words


def _quotes_sound(control: Words, delimiter: Words, quote: Words, inside: Words) -> bool:
    """Every quote opens or closes a whole cell, and none holds a line end or another control character."""
    edge = control | delimiter
    opening = quote & inside
    closing = quote ^ opening
    torn = (control & inside).any() or inside[-1] >> _TOP
    loose = (opening & ~_before(edge, 1, edge=True)).any() or (closing & ~_behind(edge, 1)).any()
    return not (torn or loose)


def _groups_sound(b: ByteArray, mark: Words, digit: Words, start: Words, decimal: int) -> bool:
    """Every thousands separator stands in a properly grouped decimal number."""
    follows = _behind(mark | _words(b == decimal), 4)
    for count in (1, 2, 3):
        follows &= _behind(digit, count)
    leading = digit & ~_words(b == _ZERO) & _before(start, 1, edge=True)
    two = _before(digit, 2)
    first = _before(leading, 1) | _before(leading, 2)
    first |= two & (_before(leading, 3) | (_before(digit, 3) & _before(mark, 4)))
    return not (mark & ~(follows & first)).any()


def _set(b: ByteArray, words: Words, value: int) -> None:
    """Overwrite the bytes whose bits are set."""
    np.putmask(b, np.unpackbits(words.view(np.uint8), bitorder="little", count=b.size).view(np.bool_), value)


def make_plain(piece: bytes, *, delimiter: str, decimal: str) -> bytes | None:
    """Take quotes and thousands separators out of whole lines, and make the decimal mark a point."""
    if not piece.isascii():
        for wide in _WIDE_MARKS:
            if wide in piece:
                if b"'" in piece:
                    return None  # a second kind of mark
                piece = piece.replace(wide, b"'")
    quoted, between, changed = b'"' in piece, delimiter.encode(), _MARKS_CHANGED if decimal == "," else None
    marks = [m for m in _MARKS if m != decimal.encode() and m in piece and (m != between or quoted)]
    if not quoted and not marks:
        return piece.translate(changed) if changed else piece
    b = np.frombuffer(piece, dtype=np.uint8)
    control, parts = _words(b < _SPACE), _words(b == ord(delimiter))
    quote = _words(b == _QUOTE)
    if quoted:
        inside = _inside_quotes(quote)
        if not _quotes_sound(control, parts, quote, inside):
            return None
        parts &= ~inside
    out, taken = b, b'"'
    for mark in marks:
        digit, occurs = _words((b - np.uint8(_ZERO)) < 10), _words(b == mark[0])
        groups = occurs & ~parts & _before(digit, 1) & _behind(digit, 1)
        if not groups.any():
            continue
        start = control | parts | quote | _words((b == _SPACE) | (b == ord("+")) | (b == ord("-")))
        if out is not b or taken != b'"' or not _groups_sound(b, groups, digit, start, ord(decimal)):
            return None
        if (occurs == groups).all():
            taken += mark
            continue
        out = b.copy()
        _set(out, groups, _QUOTE)  # deleted below, as the quotes are
    if delimiter == decimal and quoted:
        out = b.copy() if out is b else out
        _set(out, parts, _TAB)
    return (piece if out is b else out.tobytes()).translate(changed, taken)


_PIECE_BYTES, _QUOTED_BYTES = 1 << 22, 1 << 19
_MOST_THREADS = 6
#: Of few pieces a second thread saves less than it costs the first.
_FEW_PIECES = 4
#: Rows print fixed decimals where so many of the first ones have the same number of marks.
_SAMPLED_BYTES = 1 << 12
_FIXED_SHARE = 0.95


def _plain(reader: RowReader, span: tuple[int, int]) -> bytes | None:
    """Whole lines without quotes and thousands separators, ``None`` where these are not sound."""
    data, layout = reader.text.data, reader.layout
    quoted = data.find(b'"', span[0], span[0] + _SAMPLED_BYTES) >= 0
    # vectors over a short piece stay in the processor's cache
    pieces = [
        make_plain(data[start:stop], delimiter=layout.delimiter, decimal=layout.decimal)
        for start, stop in _spans(data, *span, size=_QUOTED_BYTES if quoted else _PIECE_BYTES)
    ]
    return None if None in pieces else b"".join(cast("list[bytes]", pieces))


def _parse(reader: RowReader, plain: bytes | None) -> list[FloatArray] | None:
    """The wanted columns of plain lines, ``None`` where they are not all rows of numbers."""
    import pandas as pd  # 0.4 s: not for `tissueid --help`

    layout, wanted = reader.layout, reader.wanted
    if plain is None or b"\0" in plain:
        return None
    if not plain or plain.isspace():
        return [np.empty(0) for _ in wanted]
    separator = "\t" if layout.delimiter == layout.decimal else layout.delimiter
    numbers = [numeric or index in wanted for index, numeric in enumerate(layout.numeric)]
    try:
        frame = pd.read_csv(
            io.BytesIO(plain),
            sep=separator,
            header=None,
            dtype=cast("Any", {index: np.float64 if one else object for index, one in enumerate(numbers)}),
            na_filter=False,
            quoting=csv.QUOTE_NONE,
            engine="c",
            low_memory=False,
            encoding_errors="replace",
        )
    except (ValueError, OverflowError, KeyError):
        return None
    # no row is short: proved by the parser where all cells are numbers, else by counting delimiters
    whole = all(numbers) or _count(plain, separator) == len(frame) * (layout.n_columns - 1)
    if frame.shape[1] != layout.n_columns or not whole:
        return None
    usual = _marks_a_row(plain)
    if usual is not None and _count(plain, ".") != len(frame) * usual:
        return None  # a mark was lost, or gained: the slow reader looks at each number
    return [frame[index].to_numpy() for index in wanted]


def _count(plain: bytes, mark: str) -> int:
    """Occurrences of a byte; faster than ``bytes.count`` where they are many."""
    return int(np.count_nonzero(np.frombuffer(plain, dtype=np.uint8) == ord(mark)))


def _marks_a_row(plain: bytes) -> int | None:
    """Decimal marks of a row where all rows print the same decimals, by the first rows of a piece."""
    end = plain.rfind(b"\n", 0, _SAMPLED_BYTES) + 1
    counts = Counter(line.count(b".") for line in plain[:end].splitlines() if line.strip())
    if not counts:
        return None
    usual, often = counts.most_common(1)[0]
    return usual if usual and often >= _FIXED_SHARE * counts.total() else None


def _spans(data: bytes, start: int, end: int, *, size: int) -> list[tuple[int, int]]:
    """Whole lines of about ``size`` bytes each."""
    spans = []
    while start < end:
        stop = data.find(b"\n", min(start + size, end) - 1, end) + 1 or end
        spans.append((start, stop))
        start = stop
    return spans


def _read_fast(reader: RowReader) -> list[FloatArray] | None:
    spans = _spans(reader.text.data, reader.layout.offset, reader.end, size=_PIECE_BYTES)
    plain, parse = map(partial(_plain, reader), spans), partial(_parse, reader)
    most = threads(min(_MOST_THREADS, len(spans))) if len(spans) > _FEW_PIECES else 1
    if most > 1:
        with ThreadPoolExecutor(most) as pool:
            # this thread makes plain while the others parse, where the interpreter is released
            pieces = list(pool.map(parse, plain))
    else:
        pieces = [parse(piece) for piece in plain]
    whole = [piece for piece in pieces if piece is not None]
    if len(whole) < len(pieces):
        return None
    none = np.empty(0)
    columns = [np.concatenate([none, *(piece[k] for piece in whole)]) for k in range(len(reader.wanted))]
    return columns if all(np.isfinite(column).all() for column in columns) else None


def read_body(text: Text, layout: Layout, choice: ColumnChoice, place: Place) -> tuple[Channels, list[Flag]]:
    """All rows of a laid-out text: the three channels in s, mm and N, and what the reader noticed."""
    reader = RowReader(text, layout, tuple(choice.index[channel] for channel in CHANNELS), place)
    flags: list[Flag] = []
    columns = _read_fast(reader)
    if columns is None:
        columns, flags = reader.read()
    row, said = reader.tail()
    flags += said
    if row is not None:
        columns = [np.append(column, value) for column, value in zip(columns, row, strict=True)]
    if columns[0].size < 2:
        message = (
            f"the table has {columns[0].size} rows of numbers, a recording needs two; export the raw data"
            " again"
        )
        place.refuse("no_rows", message, line=layout.first_line)
    columns = choice.counted(columns)
    fractional = [column != np.floor(column) for column in columns]
    refuse_broken(
        columns, fractional, "file", place, lambda row, k: (reader.line_of_row(row), reader.wanted[k] + 1)
    )
    doubt = lost_marks(columns, fractional, choice, reader.first_row())
    flags += [] if doubt is None else [doubt]
    return choice.scaled(columns), flags
