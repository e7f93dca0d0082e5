"""Tables that are laid out for the eye: columns by spaces, and times as a clock shows them.

Both are made plain before anything else looks at the text, line for line: a run of spaces between two numbers
becomes a tab (``save -ascii``, many loggers), and ``2026-03-04 10:00:01.250`` becomes seconds of its day.  A
clock that goes back by more than half a day has passed midnight.  The header above the rows stays as it is,
but for a line of names or units that has as many words as the rows have numbers.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import takewhile

#: What is looked at to recognise a file: 48 header lines and several hundred rows; lines of it that are here.
HEAD_BYTES, HEAD_LINES = 1 << 16, 300
#: Rows that show a table by spaces, or a clock.
FEWEST_ROWS = 5
#: Share of the rows that have the same number of columns.
ALIKE = 0.9
#: A longer line is no line of names.
LONGEST_NAMES = 1000
#: Written so that a text can be a number in one way only: a line of digits is refused in linear time.
_NUMBER = rb"[+-]?(?:\d+(?:,\d+|\.\d*)?|[.,]\d+)(?:[eEdD][+-]?\d+)?|[+-]?nan"
_ROW = re.compile(rb"[ \t]*(?:%b)(?: +(?:%b))+[ \t]*\r?" % (_NUMBER, _NUMBER), re.IGNORECASE)
#: Words of a line of names: ``Time (s)`` and ``(s)`` are one each.
_NAME = re.compile(rb"[^\s(\[]+(?: ?[(\[][^)\]]*[)\]])?|[(\[][^)\]]*[)\]]")
_CLOCK = re.compile(
    rb"(?:\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}[ T])?(\d{1,2}):(\d{2}):(\d{2})([.,]\d{1,9})?"
    rb"(?: ?([AaPp])\.?[Mm]\.?)?(?:Z|[+-]\d{2}:?\d{2})?"
)
_CELL_CLOCK = re.compile(
    rb"(?:(?<=[,;\t|\"])|(?<=^))[ ]*" + _CLOCK.pattern + rb"[ ]*(?=[,;\t|\"\r]|$)", re.MULTILINE
)
_DECIMAL_COMMA = re.compile(rb"(?:^|[;\t|])\"?[+-]?\d*,\d+")
DAY_S, HALF_DAY_S = 86_400.0, 43_200.0


def by_spaces(data: bytes) -> bytes:
    """The text with tabs in place of spaces between columns; as it is where other delimiters part them."""
    lines = _head(data)
    counts = {k: len(line.split()) for k, line in enumerate(lines) if _ROW.fullmatch(line)}
    if not counts:
        return data
    columns, often = Counter(counts.values()).most_common(1)[0]
    rows = [k for k, count in counts.items() if count == columns]
    first = next(
        (k for k, after in zip(rows, rows[FEWEST_ROWS - 1 :], strict=False) if after - k < FEWEST_ROWS), None
    )
    # a damaged row is named by its line once the others are cells
    if first is None or often < ALIKE * len(counts):
        return data
    head = [_named(line, columns) if k >= first - 2 else line for k, line in enumerate(lines[:first])]
    offset = sum(len(line) + 1 for line in lines[:first])
    body = re.sub(rb"(?m)^\t", b"", re.sub(rb" +", b"\t", data[offset:]))
    body = body.replace(b"\t\n", b"\n").replace(b"\t\r\n", b"\r\n").removesuffix(b"\t")
    return b"".join(line + b"\n" for line in head) + body


def _head(data: bytes) -> list[bytes]:
    """The first whole lines."""
    head = data[:HEAD_BYTES]
    lines = head.split(b"\n")
    return (lines[:-1] if len(data) > len(head) else lines)[:HEAD_LINES]


def _named(line: bytes, columns: int) -> bytes:
    """A line of names or units, parted by tabs where it has as many words as there are columns."""
    plain = line.strip()
    if len(plain) > LONGEST_NAMES:
        return line
    for words in (re.split(rb"[ ]{2,}", plain), plain.split(), _NAME.findall(plain)):
        if len(words) == columns:
            return b"\t".join(words)
    return line


def with_seconds(data: bytes) -> bytes:
    """The text with seconds in the place of clock times in its rows; as it is where rows have none."""
    lines = _head(data)
    first = _first_row(lines)
    if first is None:
        return data
    offset = sum(len(line) + 1 for line in lines[:first])
    other = _CELL_CLOCK.sub(b"", lines[first])
    mark = b"," if re.search(rb"[;\t|]", other) and _DECIMAL_COMMA.search(other) else b"."
    days, last = 0.0, 0.0

    def seconds(match: re.Match[bytes]) -> bytes:
        nonlocal days, last
        hour, minute, second, fraction, half = match.groups()
        hours = int(hour) % 12 + 12 * (half in b"Pp") if half else int(hour)
        value = 3600.0 * hours + 60.0 * int(minute) + int(second)
        value += float(b"0." + fraction[1:]) if fraction else 0.0
        days += DAY_S * (value < last - HALF_DAY_S)
        last = value
        digits = len(fraction) - 1 if fraction else 0
        return f"{days + value:.{digits}f}".encode().replace(b".", mark)

    return data[:offset] + _CELL_CLOCK.sub(seconds, data[offset:])


def _first_row(lines: Sequence[bytes]) -> int | None:
    """The first of several lines on end with one clock time and two numbers."""
    for k in range(len(lines)):
        run = list(takewhile(_is_clocked, lines[k : k + FEWEST_ROWS]))
        if len(run) == FEWEST_ROWS:
            return k
    return None


def _is_clocked(line: bytes) -> bool:
    cells = re.split(rb"[;\t|]", line) if re.search(rb"[;\t|]", line) else line.split(b",")
    numbers = [
        cell for cell in cells if re.fullmatch(rb"[\s\"]*(?:%b)[\s\"]*" % _NUMBER, cell, re.IGNORECASE)
    ]
    return len(_CELL_CLOCK.findall(line)) == 1 and len(numbers) >= 2
