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

from tissueid.flags import Flag
from tissueid.ingest.broken_rows import broken_row
from tissueid.ingest.columns import ColumnChoice
from tissueid.ingest.layout import Layout
from tissueid.ingest.lost_marks import lost_marks
from tissueid.ingest.plain import Marks, prove_marks, single_bytes
from tissueid.ingest.refusals import Place
from tissueid.ingest.rows import RowReader
from tissueid.ingest.text import Text
from tissueid.ingest.vocabulary import CHANNELS
from tissueid.processors import threads
from tissueid.trial import FloatArray

__all__ = ["Body", "read_body"]

_PIECE_BYTES, _PROVED_BYTES = 1 << 22, 1 << 19
#: What is proved before the parser is told of it.
_MARKS = "\",.' "
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
    """How every piece is parsed."""

    data: bytes
    layout: Layout
    wanted: tuple[int, ...]

    def proved(self, span: tuple[int, int]) -> tuple[bytes, Marks] | None:
        """Whole lines and what is sound in them, ``None`` where quotes or thousands are not."""
        layout = self.layout
        piece = single_bytes(self.data[span[0] : span[1]])
        marks = "".join(mark for mark in _MARKS if mark.encode() in piece)
        if not set(marks) - {layout.decimal, layout.delimiter}:
            return piece, Marks(quoted=False, thousands=None, delimiters=-1)
        view = np.frombuffer(piece, dtype=np.uint8)
        # vectors over a short piece stay in the processor's cache
        found = [
            prove_marks(view[start:stop], marks, delimiter=layout.delimiter, decimal=layout.decimal)
            for start, stop in _spans(piece, 0, len(piece), size=_PROVED_BYTES)
        ]
        sound = [one for one in found if one is not None]
        kinds = {one.thousands for one in sound} - {None}
        if len(sound) < len(found) or len(kinds) > 1:
            return None
        return piece, Marks('"' in marks, next(iter(kinds), None), sum(one.delimiters for one in sound))

    def parse(self, proved: tuple[bytes, Marks] | None) -> list[FloatArray] | None:
        """The wanted columns of proved lines, ``None`` where they are not all rows of numbers."""
        import pandas as pd  # 0.4 s: not for `tissueid --help`

        if proved is None or b"\0" in proved[0]:
            return None
        layout, (piece, marks) = self.layout, proved
        if not piece or piece.isspace():
            return [np.empty(0) for _ in self.wanted]
        if layout.delimiter == layout.decimal and not marks.quoted:
            return None  # every cell is two
        dtypes = {
            index: np.float64 if numeric or index in self.wanted else object
            for index, numeric in enumerate(layout.numeric)
        }
        try:
            frame = pd.read_csv(
                cast("Any", _Piece(piece)),
                sep=layout.delimiter,
                decimal=layout.decimal,
                thousands=marks.thousands,
                header=None,
                dtype=cast("Any", dtypes),
                na_filter=False,
                quoting=csv.QUOTE_MINIMAL if marks.quoted else csv.QUOTE_NONE,
                engine="c",
                low_memory=False,
                encoding_errors="replace",
            )
        except (ValueError, OverflowError, KeyError):
            return None
        if frame.shape[1] != layout.n_columns or not self._rows_whole(piece, marks, len(frame)):
            return None
        usual = _marks_a_row(piece, layout.decimal)
        if usual is not None and _count(piece, layout.decimal) != len(frame) * usual:
            return None  # a mark was lost, or gained: the slow reader looks at each number
        return [frame[index].to_numpy() for index in self.wanted]

    def _rows_whole(self, piece: bytes, marks: Marks, n_rows: int) -> bool:
        """No row is short: proved by the parser where all cells are numbers, else by counting delimiters.

        The parser refuses a long row, so that the right sum means that each row is right.
        """
        if all(numeric or i in self.wanted for i, numeric in enumerate(self.layout.numeric)):
            return True
        counted = marks.delimiters if marks.delimiters >= 0 else _count(piece, self.layout.delimiter)
        return counted == n_rows * (self.layout.n_columns - 1)


def _count(piece: bytes, mark: str) -> int:
    """Occurrences of a byte; faster than ``bytes.count`` where they are many."""
    return int(np.count_nonzero(np.frombuffer(piece, dtype=np.uint8) == ord(mark)))


def _marks_a_row(piece: bytes, decimal: str) -> int | None:
    """Decimal marks of a row where all rows print the same decimals, by the first rows of a piece."""
    end = piece.rfind(b"\n", 0, _SAMPLED_BYTES) + 1
    mark = decimal.encode()
    counts = Counter(line.count(mark) for line in piece[:end].splitlines() if line.strip())
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
            # this thread proves while the others parse, where the interpreter is released
            pieces = list(pool.map(plan.parse, map(plan.proved, spans)))
    else:
        pieces = [plan.parse(plan.proved(span)) for span in spans]
    if any(piece is None for piece in pieces):
        return None
    whole = cast("list[list[FloatArray]]", pieces)
    if not whole:
        return [np.empty(0) for _ in reader.wanted]
    columns = [np.concatenate([piece[k] for piece in whole]) for k in range(len(reader.wanted))]
    return columns if all(np.isfinite(column).all() for column in columns) else None


def read_body(text: Text, layout: Layout, choice: ColumnChoice, place: Place) -> Body:
    """Read all rows of a laid-out text.

    Parameters
    ----------
    text : Text
    layout : Layout
    choice : ColumnChoice
    place : Place

    Raises
    ------
    InputError
        The codes of :class:`~tissueid.ingest.rows.RowReader`, ``no_rows`` or ``time_backwards``.
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
    broken = broken_row(columns)
    if broken is not None:
        broken.refuse(place, reader.line_of_row(broken.row), reader.wanted[broken.channel] + 1)
    doubt = lost_marks(columns, choice.factors, reader.first_row())
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
