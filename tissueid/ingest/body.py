"""The fast path through the rows: pieces of some megabytes, made plain, through pandas' C parser.

Passes over the bytes: one to hash, one to parse; where quotes or thousands separators occur also the
vector operations of :mod:`tissueid.ingest.plain`.  The parser is given the strictest settings it has
(no quotes, no missing values, no thousands), so that every short, long or odd row is an error; then,
and only then, the slow reader takes over, reads what may be read and names the line of what may not.
Pieces are independent, so they are parsed by as many threads as there are processors; memory is that
of the file plus the three columns.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.ingest.broken_rows import broken_row
from tissueid.ingest.columns import ColumnChoice
from tissueid.ingest.layout import Layout
from tissueid.ingest.lost_marks import lost_marks
from tissueid.ingest.plain import make_plain
from tissueid.ingest.refusals import Place
from tissueid.ingest.rows import RowReader
from tissueid.ingest.text import Text
from tissueid.ingest.vocabulary import CHANNELS
from tissueid.own_process import threads

_PIECE_BYTES, _QUOTED_BYTES = 1 << 22, 1 << 19
_MOST_THREADS = 6
#: Of few pieces a second thread saves less than it costs the first.
_FEW_PIECES = 4
#: Rows print fixed decimals where so many of the first ones have the same number of marks.
_SAMPLED_BYTES = 1 << 12
_FIXED_SHARE = 0.95


@dataclass(frozen=True, slots=True)
class Body:
    """The three channels in s, mm and N, and what the reader noticed."""

    time_s: FloatArray
    displacement_mm: FloatArray
    force_N: FloatArray
    flags: tuple[Flag, ...]


class _Piece:
    """The least file that pandas reads from: one string of bytes, given once."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def read(self, _size: int = -1) -> bytes:
        data, self._data = self._data, b""
        return data

    def __iter__(self) -> Iterator[bytes]:
        return iter(())


@dataclass(frozen=True, slots=True)
class _Plan:
    """Plan by which every piece is parsed."""

    data: bytes
    layout: Layout
    wanted: tuple[int, ...]

    def plain(self, span: tuple[int, int]) -> bytes | None:
        """Whole lines without quotes and thousands separators, ``None`` where these are not sound."""
        quoted = self.data.find(b'"', span[0], span[0] + _SAMPLED_BYTES) >= 0
        # vectors over a short piece stay in the processor's cache
        pieces = [
            make_plain(self.data[start:stop], delimiter=self.layout.delimiter, decimal=self.layout.decimal)
            for start, stop in _spans(self.data, *span, size=_QUOTED_BYTES if quoted else _PIECE_BYTES)
        ]
        return None if None in pieces else b"".join(cast("list[bytes]", pieces))

    def parse(self, plain: bytes | None) -> list[FloatArray] | None:
        """The wanted columns of plain lines, ``None`` where they are not all rows of numbers."""
        import pandas as pd  # 0.4 s: not for `tissueid --help`

        layout = self.layout
        if plain is None or b"\0" in plain:
            return None
        both = layout.delimiter == layout.decimal
        separator = "\t" if both else layout.delimiter
        if not plain or plain.isspace():
            return [np.empty(0) for _ in self.wanted]
        dtypes = {
            index: np.float64 if numeric or index in self.wanted else object
            for index, numeric in enumerate(layout.numeric)
        }
        try:
            frame = pd.read_csv(
                cast("Any", _Piece(plain)),
                sep=separator,
                header=None,
                dtype=cast("Any", dtypes),
                na_filter=False,
                quoting=csv.QUOTE_NONE,
                engine="c",
                low_memory=False,
                encoding_errors="replace",
            )
        except (ValueError, OverflowError, KeyError):
            return None
        if frame.shape[1] != layout.n_columns or not self._rows_whole(plain, separator, len(frame)):
            return None
        usual = _marks_a_row(plain)
        if usual is not None and _count(plain, ".") != len(frame) * usual:
            return None  # a mark was lost, or gained: the slow reader looks at each number
        return [frame[index].to_numpy() for index in self.wanted]

    def _rows_whole(self, plain: bytes, separator: str, n_rows: int) -> bool:
        """No row is short: proved by the parser where all cells are numbers, else by counting delimiters.

        The parser refuses a long row, so that the right sum means that each row is right.
        """
        if all(numeric or i in self.wanted for i, numeric in enumerate(self.layout.numeric)):
            return True
        return _count(plain, separator) == n_rows * (self.layout.n_columns - 1)


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
    plan = _Plan(reader.text.data, reader.layout, reader.wanted)
    spans = _spans(plan.data, reader.layout.offset, reader.end, size=_PIECE_BYTES)
    most = threads(min(_MOST_THREADS, len(spans))) if len(spans) > _FEW_PIECES else 1
    pieces: list[list[FloatArray] | None]
    if most > 1:
        with ThreadPoolExecutor(most) as pool:
            # this thread makes plain while the others parse, where the interpreter is released
            pieces = list(pool.map(plan.parse, map(plan.plain, spans)))
    else:
        pieces = [plan.parse(plan.plain(span)) for span in spans]
    if any(piece is None for piece in pieces):
        return None
    whole = cast("list[list[FloatArray]]", pieces)
    if not whole:
        return [np.empty(0) for _ in reader.wanted]
    columns = [np.concatenate([piece[k] for piece in whole]) for k in range(len(reader.wanted))]
    return columns if all(np.isfinite(column).all() for column in columns) else None


def read_body(text: Text, layout: Layout, choice: ColumnChoice, place: Place) -> Body:
    """Read all rows of a laid-out text.

    Raises InputError: the codes of :class:`~tissueid.ingest.rows.RowReader`, ``no_rows`` or
    ``time_backwards``.
    """
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
        place.refuse(
            "no_rows",
            f"the table has {columns[0].size} rows of numbers, a recording needs two; export the raw data"
            f" again",
            line=layout.first_line,
        )
    falls = np.flatnonzero(np.diff(columns[0]) < 0)
    if falls.size:
        raise _backwards(reader, columns[0], int(falls[0]) + 1)
    fractional = [column != np.floor(column) for column in columns]
    broken = broken_row(columns, fractional)
    if broken is not None:
        broken.refuse(place, reader.line_of_row(broken.row), reader.wanted[broken.channel] + 1)
    doubt = lost_marks(columns, fractional, choice.factors, reader.first_row())
    flags += [] if doubt is None else [doubt]
    scaled = [
        column if choice.factors[channel] == 1.0 else column * choice.factors[channel]
        for channel, column in zip(CHANNELS, columns, strict=True)
    ]
    return Body(scaled[0], scaled[1], scaled[2], tuple(flags))


def _backwards(reader: RowReader, time: FloatArray, row: int) -> Exception:
    return reader.place.refusal(
        "time_backwards",
        f"the time falls from {time[row - 1]:.10g} to {time[row]:.10g}: two recordings in one file, or a"
        f" damaged"
        " row; split the file, or name another time column with --columns time=NAME",
        line=reader.line_of_row(row),
        column=reader.wanted[0] + 1,
    )
