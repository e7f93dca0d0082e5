"""Quotes and thousands separators proved sound, a piece of the file at a time, or not at all.

A C parser told about quotes and thousands reads ``"1.424,86200";"-2,04726"``, but ``2,11,0828`` and ``"1"5``
too; so it is told about them only where all of them are proved, on the bits of the bytes, 64 to a word:

1. the parity of the quotes says which bytes stand inside a pair, as a prefix exclusive-or of the bits of a
   word (x ^= x << 1, << 2, ... << 32); each opening quote must follow a delimiter or line end, each closing
   one precede one, and no line may end inside;
2. a thousands separator is a mark between two digits (inside quotes where it is also the delimiter);
   the groups must be 1-3 digits, not 0 first, then threes, then the decimal mark.

Anything else is left to the slow reader, which says what is wrong and where.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Marks", "prove_marks", "single_bytes"]

Bytes = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Words = NDArray[np.uint64]

_QUOTE, _SPACE, _ZERO = 0x22, 0x20, 0x30
#: Thousands separators as single bytes; typographic ones are first made an apostrophe.
_MARKS = (",", ".", "'", " ")
_WIDE_MARKS = (b"\xc2\xa0", b"\xe2\x80\xaf", b"\xe2\x80\x99", b"\xa0")
_SHIFTS = tuple(np.uint64(1 << k) for k in range(6))
_ONE, _TOP = np.uint64(1), np.uint64(63)


@dataclass(frozen=True, slots=True)
class Marks:
    """What is sound in a piece.

    Attributes
    ----------
    quoted : bool
    thousands : str or None
    delimiters : int
        Outside quotes.
    """

    quoted: bool
    thousands: str | None
    delimiters: int


def single_bytes(piece: bytes) -> bytes:
    """The lines with every thousands separator in one byte."""
    if not piece.isascii():
        for wide in _WIDE_MARKS:
            piece = piece.replace(wide, b"'")
    return piece


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


def _groups_sound(b: Bytes, mark: Words, digit: Words, start: Words, decimal: int) -> bool:
    """Every thousands separator stands in a properly grouped decimal number."""
    zero = _words(b == _ZERO)
    follows = _behind(mark | _words(b == decimal), 4)
    for count in (1, 2, 3):
        follows &= _behind(digit, count)
    two, three = _before(digit, 2), _before(digit, 3)
    first = ~two & _before(start, 2, edge=True) & ~_before(zero, 1)
    first |= two & ~three & _before(start, 3, edge=True) & ~_before(zero, 2)
    lead = _before(start, 4, edge=True) & ~_before(zero, 3)
    later = _before(mark, 4) & _before(digit, 5)
    first |= two & three & ~_before(digit, 4) & (lead | later)
    return not (mark & ~(follows & first)).any()


def prove_marks(b: Bytes, marks: str, *, delimiter: str, decimal: str) -> Marks | None:
    """What the parser may be told of whole lines.

    Parameters
    ----------
    b : ndarray of uint8
        Whole lines, each thousands separator in one byte.
    marks : str
        Thousands separators and quotes that occur in them, perhaps.
    delimiter, decimal : str

    Returns
    -------
    Marks or None
        ``None`` where quotes or groups are not sound, or there are two kinds of groups.
    """
    control, parts = _words(b < _SPACE), _words(b == ord(delimiter))
    quote, inside = np.zeros_like(control), np.zeros_like(control)
    quoted = '"' in marks
    if quoted:
        quote = _words(b == _QUOTE)
        inside = _inside_quotes(quote)
        if not _quotes_sound(control, parts, quote, inside):
            return None
        parts = parts & ~inside
    thousands = None
    for mark in _MARKS:
        if mark not in marks or mark == decimal or (mark == delimiter and not quoted):
            continue
        digit = _words((b - np.uint8(_ZERO)) < 10)
        between = _words(b == ord(mark)) & ~parts & _before(digit, 1) & _behind(digit, 1)
        if not between.any():
            continue
        start = control | parts | quote | _words((b == _SPACE) | (b == ord("+")) | (b == ord("-")))
        if thousands is not None or not _groups_sound(b, between, digit, start, ord(decimal)):
            return None
        thousands = mark
    return Marks(quoted, thousands, int(np.bitwise_count(parts).sum()))
