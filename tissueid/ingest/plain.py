"""Quoted and grouped numbers made plain, a piece of the file at a time, or not at all.

``"1,424.86200","-2.04726"`` becomes ``1424.86200,-2.04726``.  A C parser told about quotes and
thousands also reads ``2,11,0828`` and ``"1"5``; so the marks are proved here, on the bytes, and taken
out, and the parser is told about neither.  The work is a few vector operations a byte:

1. the parity of the quotes says which bytes stand inside a pair: 64 at a time, as a prefix exclusive-or
   of the bits of a word (x ^= x << 1, << 2, ... << 32);
2. each opening quote must follow a delimiter or line end, each closing one precede one, and no line
   may end inside;
3. a thousands separator is a mark between two digits (inside quotes where it is also the delimiter);
   the groups must be 1-3 digits, not 0 first, then threes, then the decimal mark.

Anything else is left to the slow reader, which says what is wrong and where.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["make_plain"]

Bytes = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_QUOTE, _TAB, _LF, _CR, _SPACE, _ZERO = 0x22, 0x09, 0x0A, 0x0D, 0x20, 0x30
_PAD = b"\n" * 8
#: Thousands separators as single bytes; the no-break spaces of UTF-8 are first made 0xA0.
_MARKS = (b",", b".", b"\xa0", b"'", b" ")
_WIDE_MARKS = ((b"\xc2\xa0", b"\xa0"), (b"\xe2\x80\xaf", b"\xa0"), (b"\xe2\x80\x99", b"'"))
_SHIFTS = tuple(np.uint64(1 << k) for k in range(6))


def _inside_quotes(quote: Mask) -> Mask:
    """Whether an odd number of quotes stands up to and including each byte."""
    packed = np.packbits(quote, bitorder="little")
    words = np.zeros(-(-packed.size // 8), dtype="<u8")
    words.view(np.uint8)[: packed.size] = packed
    for shift in _SHIFTS:
        words ^= words << shift
    odd = (words >> np.uint64(63)).astype(np.uint8)
    carry = np.bitwise_xor.accumulate(odd)
    words[1:] ^= np.where(carry[:-1] == 1, np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64(0))
    return np.unpackbits(words.view(np.uint8), bitorder="little", count=quote.size).view(np.bool_)


def _quotes_sound(quote: Mask, inside: Mask, newline: Mask, edge: Mask) -> bool:
    """Whether every quote opens or closes a whole cell."""
    opening = quote & inside
    closing = quote ^ opening
    torn = bool((newline & inside).any()) or bool(inside[-1])
    # of two truth values, a > b says a and not b
    return not (torn or (opening[1:] > edge[:-1]).any() or (closing[:-1] > edge[1:]).any())


def _groups_sound(
    b: Bytes, digit: Mask, at: NDArray[np.intp], *, mark: int, decimal: int, delimiter: int
) -> bool:
    """Whether each thousands separator at ``at`` stands in a properly grouped decimal number."""
    after = b[at + 4]
    if not (digit[at + 2] & digit[at + 3] & ((after == mark) | (after == decimal))).all():
        return False
    two = digit[at - 2]
    three = two & digit[at - 3]
    if (three & digit[at - 4]).any():
        return False
    length = 1 + two.astype(np.intp) + three
    lead, before = b[at - length], b[at - length - 1]
    may_start = np.zeros(256, dtype=np.bool_)
    may_start[[_QUOTE, _TAB, _LF, _CR, ord("+"), ord("-"), ord(" "), delimiter]] = True
    continues = (before == mark) & (length == 3) & digit[at - length - 2]
    return bool((continues | (may_start[before] & (lead != _ZERO))).all())


def make_plain(piece: bytes, *, delimiter: str, decimal: str) -> bytes | None:
    """Take quotes and thousands separators out of whole lines.

    Parameters
    ----------
    piece : bytes
        Whole lines.
    delimiter, decimal : str
        Where both are a comma, the delimiters become tabs.

    Returns
    -------
    bytes or None
        ``None`` where quotes or groups are not sound.
    """
    if not piece.isascii():
        for wide, narrow in _WIDE_MARKS:
            piece = piece.replace(wide, narrow)
    quoted = b'"' in piece
    marks = [
        m for m in _MARKS if m != decimal.encode() and m in piece and (m != delimiter.encode() or quoted)
    ]
    if not quoted and not marks:
        return piece
    b = np.frombuffer(_PAD + piece + _PAD, dtype=np.uint8)
    inside = None
    if quoted:
        quote = b == _QUOTE
        newline = b < _SPACE  # or another control character: inside a number it is as bad
        inside = _inside_quotes(quote)
        if not _quotes_sound(quote, inside, newline, newline | (b == ord(delimiter))):
            return None
    out = _without_marks(b, inside, marks, delimiter=delimiter, decimal=decimal)
    if out is None:
        return None
    if delimiter == decimal and inside is not None:
        out = np.where((b == ord(delimiter)) & ~inside, np.uint8(_TAB), out)
    # the deleted byte is the quote: marks were overwritten with it
    return out[len(_PAD) : -len(_PAD)].tobytes().translate(None, b'"')


def _without_marks(
    b: Bytes, inside: Mask | None, marks: list[bytes], *, delimiter: str, decimal: str
) -> Bytes | None:
    """The bytes with every thousands separator overwritten by a quote; at most one kind may occur."""
    digit = (b - np.uint8(_ZERO)) < 10
    out = b
    for mark in marks:
        between = b[1:-1] == mark[0]
        between &= digit[:-2]
        between &= digit[2:]
        if inside is not None and mark == delimiter.encode():
            between &= inside[1:-1]
        at = np.flatnonzero(between) + 1
        if at.size == 0:
            continue
        if out is not b or not _groups_sound(
            b, digit, at, mark=mark[0], decimal=ord(decimal), delimiter=ord(delimiter)
        ):
            return None
        out = b.copy()
        out[at] = _QUOTE
    return out
