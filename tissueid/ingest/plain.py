"""Quoted and grouped numbers made plain, a piece of the file at a time, or not at all.

``"1.424,86200";"-2,04726"`` becomes ``1424.86200;-2.04726``.  A C parser told about quotes and thousands also
reads ``2,11,0828`` and ``"1"5``, and takes twice the time; so the marks are proved here, on the bits of the
bytes, 64 to a word, and taken out, and the parser is told about neither:

1. the parity of the quotes says which bytes stand inside a pair, as a prefix exclusive-or of the bits of a
   word (x ^= x << 1, << 2, ... << 32); each opening quote must follow a delimiter or line end, each closing
   one precede one, and no line may end inside;
2. a thousands separator is a mark between two digits (inside quotes where it is also the delimiter);
   the groups must be 1-3 digits, not 0 first, then threes, then the decimal mark;
3. comma and point change places where the comma is the decimal mark: the parser is faster with a point.

Anything else is left to the slow reader, which says what is wrong and where.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
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


def _groups_sound(b: Bytes, mark: Words, digit: Words, start: Words, decimal: int) -> bool:
    """Every thousands separator stands in a properly grouped decimal number."""
    follows = _behind(mark | _words(b == decimal), 4)
    for count in (1, 2, 3):
        follows &= _behind(digit, count)
    leading = digit & ~_words(b == _ZERO) & _before(start, 1, edge=True)
    two = _before(digit, 2)
    first = _before(leading, 1) | _before(leading, 2)
    first |= two & (_before(leading, 3) | (_before(digit, 3) & _before(mark, 4)))
    return not (mark & ~(follows & first)).any()


def _set(b: Bytes, words: Words, value: int) -> None:
    """Overwrite the bytes whose bits are set."""
    np.putmask(b, np.unpackbits(words.view(np.uint8), bitorder="little", count=b.size).view(np.bool_), value)


def make_plain(piece: bytes, *, delimiter: str, decimal: str) -> bytes | None:
    """Take quotes and thousands separators out of whole lines, and make the decimal mark a point.

    ``piece``: whole lines; ``delimiter``, ``decimal``: where both are a comma, the delimiters become tabs.
    Returns ``None`` where quotes or groups are not sound.
    """
    if not piece.isascii():
        for wide in _WIDE_MARKS:
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
