"""From the bytes of a text export to ASCII-compatible lines: byte order marks, encodings, line ends, clocks.

Numbers are ASCII in every encoding seen.  Where the bytes are not UTF-8, the code page is the one in which
the most column names and header keys are words that test machines print.
"""

from __future__ import annotations

import codecs
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NoReturn

import charset_normalizer

from tissueid.flags import Flag
from tissueid.ingest.header import is_protocol_key
from tissueid.ingest.labelled import ALIKE, FEWEST_ROWS, bare_rows
from tissueid.ingest.markup import lines_of_markup
from tissueid.ingest.refusals import Place
from tissueid.ingest.vocabulary import CHANNELS, rank_of, specimen_key_rank

#: What is looked at to recognise a file: 48 header lines and several hundred rows; lines of it that are here.
HEAD_BYTES, HEAD_LINES = 1 << 16, 300
#: A longer line is no line of names.
LONGEST_NAMES = 1000
#: Written so that a text can be a number in one way only: a line of digits is refused in linear time.
_NUMBER = rb"[+-]?(?:\d+(?:,\d+|\.\d*)?|[.,]\d+)(?:[eEdD][+-]?\d+)?|[+-]?nan"
_ROW = re.compile(rb"[ \t]*(?:%b)(?: +(?:%b))+[ \t]*\r?" % (_NUMBER, _NUMBER), re.IGNORECASE)
#: Words of a line of names: ``Time (s)`` and ``(s)`` are one each.
_NAME = re.compile(rb"[^\s(\[]+(?: ?[(\[][^)\]]*[)\]])?|[(\[][^)\]]*[)\]]")
#: Hours, minutes and seconds, or minutes and seconds with their fraction; milliseconds may follow a colon.
_CLOCK = (
    rb"(?:(?:\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}|\d{1,2}[- ][A-Za-z]{3}[- ]\d{2,4})[ T])?"
    rb"(?:(\d{1,2}):(?=\d{2}:)|(?=\d{1,3}:\d{2}%b\d))"
    rb"(\d{1,3}):(\d{2})(%b\d{1,9}|:\d{3})?(?: ?([AaPp])\.?[Mm]\.?)?(?:Z|[+-]\d{2}:?\d{2})?"
)
_CELL_CLOCK, _CELL_CLOCK_AMONG_COMMAS = (
    re.compile(
        rb"(?:(?<=[,;\t|\"])|(?<=^))[ ]*" + _CLOCK % (mark, mark) + rb"[ ]*(?=[,;\t|\"\r]|$)", re.MULTILINE
    )
    for mark in (rb"[.,]", rb"[.]")
)
_OTHER_DELIMITERS = re.compile(rb"[;\t|]")
_DECIMAL_COMMA = re.compile(rb"(?:^|[;\t|])\"?[+-]?\d*,\d+")
#: What a program writes before names that are no data of its own.
_REMARK = re.compile(rb"^(?:#+|%+|//+)[ \t]*")
_REMARK_LINE = re.compile(rb"^(?:#|%|//)[^\n]* [^\n]*", re.MULTILINE)
#: What a serial monitor writes before every line.
_MONITORED = re.compile(rb"^(\d{1,2}:\d{2}:\d{2}(?:\.\d{1,6})?) -> (?=[^\n]*([,;\t ]))?", re.MULTILINE)
_NO_CELLS = bytes.maketrans(b' "', b"__")
#: Last rows that show how a clock is printed.
_TAIL_BYTES = 1 << 12
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
    above = [k for k, line in enumerate(lines[:first]) if line.strip()][-2:]
    # a # is the name of a column that counts the rows, and else no name
    begins = [
        int(cell) if cell.isdigit() else -1 for cell in (lines[k].split()[0] for k in rows[:FEWEST_ROWS])
    ]
    counted = all(b == a + 1 for a, b in pairwise(begins))
    head = [_named(line, columns, counted) if k in above else line for k, line in enumerate(lines[:first])]
    offset = sum(len(line) + 1 for line in lines[:first])
    rest = _REMARK_LINE.sub(lambda remark: remark[0].translate(_NO_CELLS), data[offset:])
    body = re.sub(rb"(?m)^\t", b"", re.sub(rb" +", b"\t", rest))
    body = body.replace(b"\t\n", b"\n").replace(b"\t\r\n", b"\r\n").removesuffix(b"\t")
    return b"".join(line + b"\n" for line in head) + body


def _head(data: bytes) -> list[bytes]:
    """The first whole lines."""
    head = data[:HEAD_BYTES]
    lines = head.split(b"\n")
    return (lines[:-1] if len(data) > len(head) else lines)[:HEAD_LINES]


def _named(line: bytes, columns: int, counted: bool) -> bytes:
    """A line of names or units, parted by tabs where it has as many words as there are columns."""
    printed = line.strip()
    if len(printed) > LONGEST_NAMES:
        return line
    for plain in (_REMARK.sub(b"", printed), *([printed] if counted else [])):
        for words in (re.split(rb"[ ]{2,}", plain), plain.split(), _NAME.findall(plain)):
            if len(words) == columns:
                return b"\t".join(words)
    return line


def with_seconds(data: bytes) -> bytes:
    """The text with seconds in the place of clock times in its rows; as it is where rows have none."""
    offset, lines = _clocked_rows(data)
    if not lines:
        return data
    clock = _clock_in(lines[0])
    other = clock.sub(b"", lines[0])
    mark = b"," if _OTHER_DELIMITERS.search(other) and _DECIMAL_COMMA.search(other) else b"."
    # whole seconds may be printed without the fraction that the others have
    usual = max((len(found[3]) - 1 for line in lines for found in clock.findall(line)), default=0)
    days, last = 0.0, 0.0

    def seconds(match: re.Match[bytes]) -> bytes:
        nonlocal days, last
        hour, minute, second, fraction, half = match.groups()
        hours = int(hour or 0)
        hours = hours % 12 + 12 * (half in b"Pp") if half else hours
        value = 3600.0 * hours + 60.0 * int(minute) + int(second)
        value += float(b"0." + fraction[1:]) if fraction else 0.0
        days += DAY_S * (value < last - HALF_DAY_S)
        last = value
        digits = max(len(fraction) - 1 if fraction else 0, usual)
        return f"{days + value:.{digits}f}".encode().replace(b".", mark)

    return data[:offset] + clock.sub(seconds, data[offset:])


def _clocked_rows(data: bytes) -> tuple[int, list[bytes]]:
    """Byte at which rows with clock times begin, and the first and last of them; no lines where none do.

    Minutes may be printed once there are some: 59.9, 1:00.1.
    """
    lines = _head(data)
    first = _first_row(lines)
    offset = sum(len(line) + 1 for line in lines[:first])
    tail = data[max(offset, len(data) - _TAIL_BYTES) :]
    if first is None and b":" in tail and (late := _CELL_CLOCK.search(data, offset)) is not None:
        offset = data.rfind(b"\n", 0, late.start() + 1) + 1
        lines = data[offset : offset + HEAD_BYTES].split(b"\n")
        grown = 60 * int(late[1] or 0) + int(late[2]) in (1, 60)  # and no time of the day
        first = 0 if grown and _first_row(lines) == 0 else None
    return offset, [] if first is None else [*lines[first:], *tail.split(b"\n")]


def _clock_in(line: bytes) -> re.Pattern[bytes]:
    """The pattern of a clock time in a line: where commas part the cells, none begins a fraction."""
    return _CELL_CLOCK if _OTHER_DELIMITERS.search(line) else _CELL_CLOCK_AMONG_COMMAS


def _first_row(lines: Sequence[bytes]) -> int | None:
    """The first of several lines on end with one clock time and two numbers."""
    starts = range(len(lines) - FEWEST_ROWS + 1)
    return next((k for k in starts if all(map(_is_clocked, lines[k : k + FEWEST_ROWS]))), None)


def _is_clocked(line: bytes) -> bool:
    cells = _OTHER_DELIMITERS.split(line) if _OTHER_DELIMITERS.search(line) else line.split(b",")
    numbers = [
        cell for cell in cells if re.fullmatch(rb"[\s\"]*(?:%b)[\s\"]*" % _NUMBER, cell, re.IGNORECASE)
    ]
    return len(_clock_in(line).findall(line)) == 1 and len(numbers) >= 2


_PIECE_BYTES = 1 << 20
_CODE_PAGES = ("latin-1", "cp1252", "cp1250", "gbk", "cp932")
#: Code pages that known words alone speak for.
_BY_WORDS = ("cp1251", "cp949", "cp1254", "big5")
_MAGIC = (
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"GIF8", "a GIF image"),
    (b"BM", "a bitmap image"),
    (b"%PDF", "a PDF document"),
    (b"\x1f\x8b", "gzip-compressed"),
    (b"7z\xbc\xaf", "a 7z archive"),
    (b"\x89HDF", "an HDF5 file"),
    (b"MATLAB ", "a MATLAB file"),
    (b"TDSm", "a LabVIEW TDMS file"),
    (b"\x93NUMPY", "an array of NumPy"),
    (b"PAR1\x15", "a Parquet file"),
    (b"ARROW1\0\0", "a Feather file"),
    (b"\x80\4\x95", "a pickle of Python"),
    (b"\x80\5\x95", "a pickle of Python"),
    (b"\x7fELF", "a program"),
    (b"MZ", "a program"),
    (b"PK\x03\x04", "a zip archive or workbook"),
    (b"\xd0\xcf\x11\xe0", "a workbook or another compound document"),
)
ARRAYS = "an archive of NumPy arrays"
#: Call by which a kind of file is written as CSV.
_AS_CSV = {
    "an array of NumPy": 'numpy.savetxt("a.csv", numpy.load(FILE), delimiter=",", header="time_s,...")',
    ARRAYS: 'pandas.DataFrame(dict(numpy.load(FILE))).to_csv("a.csv")',
    "a Parquet file": 'pandas.read_parquet(FILE).to_csv("a.csv")',
    "a Feather file": 'pandas.read_feather(FILE).to_csv("a.csv")',
    "a pickle of Python": 'pandas.read_pickle(FILE).to_csv("a.csv")',
    "an HDF5 file": 'pandas.read_hdf(FILE).to_csv("a.csv")',
    "a MATLAB file": 'writetable(T, "a.csv") in MATLAB',
    "a LabVIEW TDMS file": 'nptdms.TdmsFile(FILE).as_dataframe().to_csv("a.csv")',
    "JSON in lines": 'pandas.read_json(FILE, lines=True).to_csv("a.csv")',
    "JSON": 'pandas.read_json(FILE).to_csv("a.csv")',
}
MARKUP = "XML or HTML"
_BOMS_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
#: Some programs end a line by one.
_NUL_AT_END = re.compile(rb"(?<!\0)\0(?=\r?\n)")
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")
#: A quoted number with its marks is a cell, not a row.
_ONE_NUMBER = re.compile(rb"[+-]?(?:\d+[.,]?\d*|\d{1,3}(?:[.,]\d{3})+(?:[.,]\d*)?)")
_CONTROL_FRACTION = 0.002
#: Least share of ASCII letters in the head of a UTF-16 export: its numbers are ASCII.
_UTF16_FRACTION = 0.15
#: Most NULs in the other byte, as a share.
_UTF16_STRAY = 0.05
#: ``mm²`` in latin-1 is ``mm˛`` in cp1250, and ``µN`` is a Chinese character.
_SIGNED_UNIT = re.compile(r"[kcm]?m[²³]|[µμ](?:m|N|s)(?:/(?:s|min))?")
#: A quoted cell of words that goes on in another line.
_BROKEN_NAME = re.compile(
    rb'(?:^|(?<=[,;\t]))"[^",;\t\n]*(?:\n[^",;\t\n]*){1,3}"(?=[,;\t\r\n])', re.MULTILINE
)
#: Fortran has a D in an exponent.
_FORTRAN = re.compile(rb"(?<![\w.])([+-]?(?:\d+\.\d*|\.\d+))[dD]([+-]\d{1,3})(?![\w.])")
#: Spaces between the quotes of a cell and the marks that part it from others.
_QUOTE_APART = re.compile(
    rb'(?:(?<=[,;\t])|^)[ ]+(?="(?:[^"]|"[ ]*[,;\t\r\n]))|(?<=")[ ]+(?=[,;\t\r\n])', re.MULTILINE
)
#: A minus sign that is no hyphen.
_MINUS, _MINUS_SIGN = "\u2212".encode(), re.compile("\u2212(?=[0-9.,])".encode())


#: Head of a segment of LabVIEW's "one header per segment", with the names of its columns.
_SEGMENT_HEAD = re.compile(
    rb"^Channels[\t,;][^\n]*\n(?:(?!X_Value)[^\n]*\n){0,20}X_Value[^\n]*\n", re.MULTILINE
)
_FIRST_NUMBER = re.compile(rb"[+-]?\d+(?:[.,]\d*)?(?:[eE][+-]?\d+)?(?=[\t;])")


@dataclass(frozen=True, slots=True)
class Text:
    """A text file, ready to be cut into lines."""

    data: bytes  # lines ended by LF or CRLF, ASCII-compatible, without byte order mark
    codec: str  # what decodes ``data``
    encoding: str  # what the file was written in, for the record
    flags: tuple[Flag, ...] = ()
    names: tuple[str, ...] = ()  # that every row repeats, and units: taken out of ``data``
    units: tuple[str, ...] = ()
    before_clock: bytes | None = None  # what stands in a row before the clock time that became seconds

    def decode(self, line: bytes) -> str:
        """One line or the head as text; what can't be decoded is shown as such."""
        return line.decode(self.codec, errors="replace")

    def clock_column(self, delimiter: str) -> int | None:
        """Column, counted from 0, of clock times that became seconds."""
        return None if self.before_clock is None else self.before_clock.count(delimiter.encode())


def foreign_kind(head: bytes) -> str | None:
    """Kind of a file that is no text table: ``"a PNG image"``; ``None`` where it may be one."""
    for magic, kind in _MAGIC:
        # two-letter magics are words too: believe them only among control bytes
        if head.startswith(magic) and (len(magic) > 2 or len(_CONTROL.findall(head)) > 1):
            return kind
    if _is_utf16(head):
        return None
    head = _NUL_AT_END.sub(b"", head).rstrip(b"\0")
    if b"\0" in head or len(_CONTROL.findall(head)) > _CONTROL_FRACTION * len(head):
        return "binary data"
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if re.match(rb"\{[^\n]*\}\s*\n\s*\{", start):
        return "JSON in lines"
    if re.match(rb"[\[{]\s*[\"{\[\]}]", start):
        return "JSON"
    if re.match(rb"<(?:\?xml|!doctype|html)", start, re.IGNORECASE):
        return MARKUP
    return None


def refuse_foreign(kind: str, place: Place) -> NoReturn:
    """Refuse a file that is no text table."""
    call = f", as with {_AS_CSV[kind]}" if kind in _AS_CSV else ""
    message = (
        f"this is {kind}, no table; give the export of the test machine, or save its columns as CSV{call}"
    )
    place.refuse("not_an_export", message)


def _is_utf16(head: bytes) -> bool:
    """UTF-16, by its mark or by NULs at every second byte and hardly any elsewhere.

    Digits and delimiters have one NUL each; a header in Chinese has few, so that all of the head counts, and
    a character such as U+4E00 has one in the other byte.
    """
    if head.startswith(_BOMS_UTF16):
        return True
    even, odd = head[0::2].count(0), head[1::2].count(0)
    sample = len(head) // 2
    few, many = sorted((even, odd))
    return len(head) >= 16 and few <= _UTF16_STRAY * many and many >= _UTF16_FRACTION * sample


def decode_text(data: bytes, place: Place) -> Text:
    """Find the encoding and unify byte order marks and line ends."""
    blank = b" \t\r\n\0"
    if not data[:HEAD_BYTES].strip(blank) and not data.strip(blank):
        place.refuse("empty_file", "the file is empty; export the test again")
    head = data[:HEAD_BYTES]
    kind = foreign_kind(head)
    if kind is None and data.endswith(b"\0") and b"\0" not in (rows := data.rstrip(b"\0")):
        text, line = decode_text(rows, place), rows.count(b"\n") + 1
        message = f"line {line} ends in NUL bytes: the file was not closed, and rows may be missing"
        return replace(text, flags=(*text.flags, Flag("cut_row", message, {"line": line, "kept": True})))
    if kind == MARKUP and (lines := lines_of_markup(data)) is not None:
        return decode_text(lines, place)
    if kind is not None:
        refuse_foreign(kind, place)
    _refuse_long_lines(data, place)
    if _is_utf16(head):
        return _from_utf16(data, place)
    data = _NUL_AT_END.sub(b"", data) if b"\0" in data else data
    if head.startswith(codecs.BOM_UTF8):
        text = Text(_line_ends(data[3:]), "utf-8", "utf-8-sig")
    elif data.isascii():
        text = Text(_line_ends(data), "ascii", "ascii")
    elif _is_utf8(data):
        text = Text(_line_ends(data), "utf-8", "utf-8")
    else:
        codec, sure = _code_page(head)
        message = f"the encoding of the header is not certain, {codec} was taken"
        doubt = () if sure else (Flag("undecoded_text", message, {"encoding": codec}),)
        text = Text(_line_ends(data), codec, codec, doubt)
    return _plain(text, place)


def _refuse_long_lines(data: bytes, place: Place) -> None:
    """Refuse a line that no table has, before it is copied; one look at the end of each 64 KiB."""
    start = 0
    while len(data) - start > HEAD_BYTES:
        end = max(data.rfind(mark, start, start + HEAD_BYTES) for mark in (b"\n", b"\r"))
        if end < 0:
            line = data.count(b"\n", 0, start) + 1
            name = "the first line" if line == 1 else f"line {line}"
            place.refuse(
                "not_an_export", f"{name} is longer than {HEAD_BYTES} bytes: this is no table", line=line
            )
        start = end + 1


def _from_utf16(data: bytes, place: Place) -> Text:
    if data.startswith(_BOMS_UTF16):
        codec = "utf-16"
    else:
        head = data[:HEAD_BYTES]
        codec = "utf-16-be" if head[0::2].count(0) > head[1::2].count(0) else "utf-16-le"
    try:
        decoded = data.decode(codec)
    except UnicodeDecodeError as error:
        message = f"the file starts as UTF-16 text but is damaged at byte {error.start}; export it again"
        place.refuse("not_an_export", message)
    unified = _line_ends(decoded.encode())
    head = unified[:HEAD_BYTES]
    if len(_CONTROL.findall(head)) > _CONTROL_FRACTION * len(head):
        refuse_foreign("binary data", place)
    return _plain(Text(unified, "utf-8", "utf-16"), place)


def _line_ends(data: bytes) -> bytes:
    """Lone CR, of an old or hand-made file, becomes LF; anything with an LF stays as it is."""
    return data if b"\n" in data else data.replace(b"\r", b"\n")


def _is_utf8(data: bytes) -> bool:
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        for start in range(0, len(data), _PIECE_BYTES):
            decoder.decode(data[start : start + _PIECE_BYTES])
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        return False
    return True


def _code_page(head: bytes) -> tuple[str, bool]:
    """The code page in which most names are known words, and whether that is certain."""
    scores = {}
    for codec in (*_CODE_PAGES, *_BY_WORDS):
        try:
            decoded = head.decode(codec)
        except UnicodeDecodeError as error:
            if error.start < len(head) - 2:  # a character cut at the end of the head is no evidence
                continue
            decoded = head.decode(codec, errors="replace")
        if not re.search("[\x80-\x9f]", decoded):
            scores[codec] = _known_words(decoded)
    if not scores:
        return "latin-1", False
    plain = _known_words(head.decode("ascii", errors="replace"))
    best = max(scores, key=lambda codec: scores[codec])
    if scores[best] > plain:
        return best, True
    scores = {codec: score for codec, score in scores.items() if codec in _CODE_PAGES}
    best = max(scores, key=lambda codec: scores[codec], default="latin-1")
    guess = charset_normalizer.from_bytes(head, cp_isolation=list(scores)).best()
    if guess is not None:
        found = {"latin_1": "latin-1", "gb2312": "gbk", "gb18030": "gbk"}.get(guess.encoding, guess.encoding)
        if found in scores and head.decode(found, "replace") == head.decode(best, "replace"):
            return best, True
        return (found, True) if found in scores else (best, False)
    return best, False


def _known_words(decoded: str) -> int:
    lines = (line for line in decoded.splitlines()[:100] if not line.isascii())
    pieces = {piece for line in lines for piece in re.split(r'[,;\t"()\[\]]', line) if not piece.isascii()}
    return sum(
        specimen_key_rank(piece) is not None
        or is_protocol_key(piece)
        or any(map(_SIGNED_UNIT.fullmatch, piece.split()))
        or any(rank_of(piece, channel, loose=False) is not None for channel in CHANNELS)
        for piece in pieces
        if len(piece) <= 80
    )


def _plain(text: Text, place: Place) -> Text:
    """The text without wrapped lines, columns by spaces and clock times."""
    text = _unwrapped(text)
    data = text.data
    if text.codec == "utf-8" and _MINUS in data:
        data = _MINUS_SIGN.sub(b"-", data)
    if _FORTRAN.search(data, 0, HEAD_BYTES):
        data = _FORTRAN.sub(rb"\1E\2", data)
    if _MONITORED.match(data):
        data = _MONITORED.sub(lambda one: one[1] + (one[2] or b","), data)
    if _QUOTE_APART.search(data, 0, HEAD_BYTES):
        data = _QUOTE_APART.sub(b"", data)
    data = _one_measurement(_on_one_line(data))
    data, names, units = bare_rows(data, _head(data), place)
    spaced = by_spaces(data)
    data = with_seconds(spaced)
    if data is text.data:
        return text
    return replace(
        text, data=data, names=tuple(map(text.decode, names)), units=tuple(map(text.decode, units)),
        before_clock=None if data is spaced else _before_clock(spaced),
    )  # fmt: skip


def _before_clock(data: bytes) -> bytes | None:
    """Cells before the clock time of the first row; ``None`` where 10:30 may be hours and minutes."""
    line = _clocked_rows(data)[1][0]
    clock = _clock_in(line).search(line)
    return line[: clock.start()] if clock is not None and (clock[1] or clock[4]) else None


def _on_one_line(data: bytes) -> bytes:
    """The text with its quoted names on one line each; the lines that they leave stay, empty."""
    head, rest = data[:HEAD_BYTES], data[HEAD_BYTES:]
    joined = _BROKEN_NAME.sub(lambda name: re.sub(rb"\r?\n", b"\0", name[0]), head)
    if joined == head:
        return data
    lines = (line.replace(b"\0", b" ") + b"\n" * line.count(b"\0") for line in joined.split(b"\n"))
    return b"\n".join(lines) + rest


def _one_measurement(data: bytes) -> bytes:
    """A LabVIEW measurement without the heads that its segments repeat; their lines stay, empty.

    The names and units of one behind which the time starts again stay: it begins another recording.
    """
    first = _SEGMENT_HEAD.search(data) if data.startswith(b"LabVIEW Measurement") else None
    if first is None:
        return data
    rest = data[first.end() :]

    def goes_on(head: re.Match[bytes]) -> bytes:
        above = rest[max(head.start() - LONGEST_NAMES, 0) : head.start()].rstrip().rpartition(b"\n")[2]
        times = [_FIRST_NUMBER.match(line) for line in (above, rest[head.end() : head.end() + LONGEST_NAMES])]
        last, begun = (float(time[0].replace(b",", b".")) if time else 0.0 for time in times)
        kept = (b"Y_Unit_Label", b"X_Value") if begun < last else ()
        return b"\n".join(line if line.startswith(kept) else b"" for line in head[0].split(b"\n"))

    return data[: first.end()] + _SEGMENT_HEAD.sub(goes_on, rest)


def _unwrapped(text: Text) -> Text:
    """Undo a spreadsheet that quoted whole lines: ``"0.1,""1,367.90"",3"`` becomes ``0.1,"1,367.90",3``."""
    lines = [line for line in text.data[:HEAD_BYTES].split(b"\n")[:-1] if line.strip()][:200]
    wrapped = sum(_is_wrapped(line.strip()) for line in lines)
    if not lines or wrapped < 0.8 * len(lines):
        return text
    whole = (line.rstrip(b"\r") for line in text.data.split(b"\n"))
    data = b"\n".join(line[1:-1].replace(b'""', b'"') if _is_wrapped(line) else line for line in whole)
    return replace(text, data=data)


def _is_wrapped(line: bytes) -> bool:
    """One quoted cell that holds a whole line: delimiters inside, no lone quote."""
    inner = line[1:-1]
    return (
        len(line) > 2
        and line[:1] == line[-1:] == b'"'
        and re.search(rb"[,;\t]", inner) is not None
        and b'"' not in inner.replace(b'""', b"")
        and not _ONE_NUMBER.fullmatch(inner)
    )
