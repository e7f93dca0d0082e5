"""Class (a): the same numbers in another dress, and files that were cut, joined or shuffled."""

from dataclasses import replace
from itertools import chain

from fuzz_mutant import Mutant, Mutation, Random, textual
from fuzz_seeds import Seed, seeds, split_cells

DELIMITERS = (",", ";", "\t", "|", ":", " ", "&", ";;", ", ")
ENCODINGS = (
    "ascii", "utf-8", "utf-8-sig", "latin-1", "cp1250", "cp1252", "gbk", "utf-16", "utf-16-le", "utf-16-be",
    "utf-32", "utf-32-le", "cp500", "utf-7", "shift_jis", "mac-roman",
)  # fmt: skip
NEWLINES = (
    "\n", "\r\n", "\r", "\n\r", "\r\r\n", "\n\n", "\x0b", "\x0c", "\x85", "\u2028", "\0", "\\n", " \n",
)  # fmt: skip


def _body(seed: Seed) -> range:
    return range(seed.first, len(seed.lines))


def _some(seed: Seed, rng: Random) -> list[int]:
    """A few rows of the body."""
    return rng.sample(list(_body(seed)), rng.choice((1, 1, 2, 5, 20)))


# -- another dress: equal to the original, or refused ---------------------------------------------------


def redelimit(seed: Seed, rng: Random) -> Mutant:
    new = rng.choice([d for d in DELIMITERS if d != seed.intent.delimiter])
    lines = [new.join(split_cells(line, seed.intent.delimiter)) for line in seed.lines]
    return textual("delimiter everywhere", seed, lines, expect="original")


def redelimit_rows(seed: Seed, rng: Random) -> Mutant:
    lines, new = list(seed.lines), rng.choice([d for d in DELIMITERS if d != seed.intent.delimiter])
    for at in _some(seed, rng):
        lines[at] = new.join(split_cells(lines[at], seed.intent.delimiter))
    return textual("delimiter of some rows", seed, lines, expect="original")


def one_delimiter(seed: Seed, rng: Random) -> Mutant:
    lines, at = list(seed.lines), rng.choice(list(_body(seed)))
    cells = split_cells(lines[at], seed.intent.delimiter)
    k = rng.randrange(1, len(cells))
    new = rng.choice(["", *DELIMITERS, seed.intent.delimiter * 2])
    lines[at] = seed.intent.delimiter.join(cells[:k]) + new + seed.intent.delimiter.join(cells[k:])
    return textual("one delimiter", seed, lines, expect="original")


def trailing_delimiters(seed: Seed, rng: Random) -> Mutant:
    lines = list(seed.lines)
    where = range(seed.names, len(lines)) if rng.random() < 0.4 else _some(seed, rng)
    if rng.random() < 0.2:
        where = _body(seed)
    for at in where:
        lines[at] += seed.intent.delimiter * rng.choice((1, 1, 2))
    return textual("delimiters at the end of lines", seed, lines, expect="original")


def pad(seed: Seed, rng: Random) -> Mutant:
    space = rng.choice((" ", "  ", "\t", "\u00a0"))
    rows = _body(seed) if rng.random() < 0.5 else _some(seed, rng)
    lines = seed.with_cells(rows, lambda cells: [rng.choice((space + c, c + space, c)) for c in cells])
    return textual("padded cells", seed, lines, expect="original")


def requote(seed: Seed, rng: Random) -> Mutant:
    lines, how = list(seed.lines), rng.choice(("all", "some", "none", "outer", "apostrophes", "one cell"))
    start = rng.choice((seed.names, seed.first))
    chosen = set(_some(seed, rng)) if how == "one cell" else set(range(start, len(lines)))
    for at in chosen:
        cells = split_cells(lines[at], seed.intent.delimiter)
        bare = [cell.strip('"') for cell in cells]
        if how == "outer":
            lines[at] = '"' + lines[at].replace('"', '""') + '"'
            continue
        if how == "one cell":
            k = rng.randrange(len(cells))
            cells[k] = bare[k] if cells[k] != bare[k] else f'"{bare[k]}"'
        else:
            mark = "'" if how == "apostrophes" else '"'
            share = {"all": 1.0, "some": 0.5, "none": 0.0, "apostrophes": 1.0}[how]
            cells = [mark + c + mark if rng.random() < share else c for c in bare]
        lines[at] = seed.intent.delimiter.join(cells)
    return textual(f"quotes: {how}", seed, lines, expect="original")


def tear_quote(seed: Seed, rng: Random) -> Mutant:
    lines, at = list(seed.lines), rng.choice(list(_body(seed)))
    line = lines[at]
    quotes = [i for i, letter in enumerate(line) if letter == '"']
    if quotes and rng.random() < 0.5:
        k = rng.choice(quotes)
        lines[at] = line[:k] + rng.choice(("", '""', "'")) + line[k + 1 :]
    else:
        k = rng.randrange(len(line) + 1)
        lines[at] = line[:k] + '"' + line[k:]
    return textual("a torn quote", seed, lines, expect="original")


def line_ends(seed: Seed, rng: Random) -> Mutant:
    new = rng.choice(NEWLINES)
    if rng.random() < 0.5:
        return textual("line ends everywhere", seed, seed.lines, expect="original", newline=new)
    ends = [new if rng.random() < 0.1 else seed.newline for _ in seed.lines]
    text = "".join(chain.from_iterable(zip(seed.lines, ends, strict=True)))
    return textual("line ends of some lines", seed, [text], expect="original", newline="")


def file_end(seed: Seed, rng: Random) -> Mutant:
    ends = ("", "\r", "\n", "\r\r\n", "\n\n\n", "\x1a", "\0", " ", seed.intent.delimiter * 2, "\t\r\n")
    end = rng.choice(ends)
    return textual("end of the file", seed, seed.lines, expect="original", end=end)


def blank_lines(seed: Seed, rng: Random) -> Mutant:
    lines = list(seed.lines)
    blank = rng.choice(("", " ", "\t", seed.intent.delimiter * (seed.intent.n_columns - 1), '""'))
    for at in sorted(rng.sample(range(len(lines)), rng.choice((1, 3, 10))), reverse=True):
        lines.insert(at, blank)
    return textual("blank lines", seed, lines, expect="original")


def reencode(seed: Seed, rng: Random) -> Mutant | None:
    codec = rng.choice([c for c in ENCODINGS if c != seed.intent.encoding])
    try:
        data = seed.text.encode(codec)
    except UnicodeEncodeError:
        return None
    return Mutant("encoding", seed, data, seed.intent, "original")


def stray_bytes(seed: Seed, rng: Random) -> Mutant:
    """A byte order mark or a control byte where none belongs, outside the numbers or within."""
    data = bytearray(seed.data)
    at = rng.choice((0, len(data), rng.randrange(len(data))))
    data[at:at] = rng.choice((b"\xef\xbb\xbf", b"\xff\xfe", b"\0", b"\x1a", b"\x07", b"\xa0", b"\xc2\xa0"))
    return Mutant("stray bytes", seed, bytes(data), seed.intent, "original")


def header(seed: Seed, rng: Random) -> Mutant:
    lines, d = list(seed.lines), seed.intent.delimiter
    new = rng.choice(
        (
            f"Test : Rate 1{d}10.00{d}mm/min", f"Results : Maximum load{d}12.5{d}N",
            f"General : Start Date{d}13/11/2018 5:14 PM", f"Time{d}12:30", f"A{d}B{d}C", f"v1{d}3",
            "Specimen label", "Load cell 2 kN", '"torn', "",
        )
    )  # fmt: skip
    if seed.names and rng.random() < 0.4:
        del lines[rng.randrange(seed.names)]
    else:
        for _ in range(rng.choice((1, 1, 3, 60))):
            lines.insert(rng.randrange(seed.names + 1), new)
    return textual("header lines", seed, lines, expect="original")


def group_thousands(seed: Seed, rng: Random) -> Mutant | None:
    """Separators where the dialect may have them: inside quotes, before a decimal mark."""
    lines, point = list(seed.lines), seed.intent.decimal
    mark = seed.intent.thousands or (rng.choice("' ") if point == "," else rng.choice(",' "))
    changed = False
    for at in _body(seed):
        cells = split_cells(lines[at], seed.intent.delimiter)
        for k in seed.intent.channels:
            bare = cells[k].strip('"')
            whole, _, fraction = bare.partition(point)
            if len(whole.lstrip("+-")) == 4 and whole.lstrip("+-").isdigit() and fraction:
                cells[k] = f'"{whole[:-3]}{mark}{whole[-3:]}{point}{fraction}"'
                changed = True
        lines[at] = seed.intent.delimiter.join(cells)
    return textual("thousands grouped", seed, lines, expect="original") if changed else None


def swap_decimal(seed: Seed, rng: Random) -> Mutant:
    """The whole table in the other locale."""
    swap, words = str.maketrans(".,", ",."), seed.intent.words
    lines = seed.with_cells(
        _body(seed), lambda cells: [c if k in words else c.translate(swap) for k, c in enumerate(cells)]
    )
    return textual("decimal mark everywhere", seed, lines, expect="original")


# -- cut, joined, shuffled: as the oracle reads it, or refused -------------------------------------------


def truncate(seed: Seed, rng: Random) -> Mutant:
    """Cut at a byte; the last row counts as cut where part of its text is gone."""
    data = seed.data
    near_end = rng.random() < 0.6
    at = rng.randrange(len(data) * 9 // 10, len(data)) if near_end else rng.randrange(1, len(data))
    kept = data[:at].decode(seed.intent.encoding, errors="replace")
    lines = kept.replace("\r\n", "\n").removesuffix("\r").split("\n")
    index = len(lines) - 1
    torn = bool(lines[-1]) and index >= seed.first and lines[-1] != seed.lines[index]
    return Mutant("truncated", seed, data[:at], seed.intent, "oracle", cut=torn)


def remove_lines(seed: Seed, rng: Random) -> Mutant:
    lines = list(seed.lines)
    for at in sorted(rng.sample(range(len(lines)), rng.choice((1, 1, 2, 10, 40))), reverse=True):
        del lines[at]
    return textual("lines removed", seed, lines, expect="oracle")


def duplicate_lines(seed: Seed, rng: Random) -> Mutant:
    lines, at = list(seed.lines), rng.randrange(len(seed.lines))
    lines[at:at] = lines[at : at + rng.choice((1, 1, 2, 8))] * rng.choice((1, 1, 3))
    return textual("lines duplicated", seed, lines, expect="oracle")


def swap_lines(seed: Seed, rng: Random) -> Mutant:
    lines = list(seed.lines)
    i, j = rng.sample(range(len(lines)), 2)
    if rng.random() < 0.5:
        j = min(i + 1, len(lines) - 1)
    lines[i], lines[j] = lines[j], lines[i]
    return textual("lines swapped", seed, lines, expect="oracle")


def move_block(seed: Seed, rng: Random) -> Mutant:
    lines = list(seed.lines)
    start = rng.randrange(len(lines))
    block = lines[start : start + rng.choice((1, 3, 10, 40))]
    del lines[start : start + len(block)]
    at = rng.randrange(len(lines) + 1)
    if rng.random() < 0.3:
        at = rng.randrange(seed.first + 1)
    lines[at:at] = block
    return textual("block moved", seed, lines, expect="oracle")


def _stretch(seed: Seed, rng: Random) -> tuple[int, int]:
    """A few bytes of a file, most often whole letters."""
    size, at = rng.choice((1, 2, 5, 20, 60, 400)), rng.randrange(len(seed.data) - 1)
    if seed.intent.encoding == "utf-16" and rng.random() < 0.9:
        at, size = at - at % 2, 2 * size
    return at, at + size


def cut_bytes(seed: Seed, rng: Random) -> Mutant:
    start, stop = _stretch(seed, rng)
    return Mutant("bytes cut out", seed, seed.data[:start] + seed.data[stop:], seed.intent, "oracle")


def repeat_bytes(seed: Seed, rng: Random) -> Mutant:
    start, stop = _stretch(seed, rng)
    return Mutant("bytes repeated", seed, seed.data[:stop] + seed.data[start:], seed.intent, "oracle")


def splice(seed: Seed, rng: Random) -> Mutant:
    """The head of one file and the tail of another, of the same or another dialect."""
    other = rng.choice(seeds()) if rng.random() < 0.7 else seed
    a, b = seed.data, other.data
    first = rng.randrange(len(a) // 3, len(a))
    second = rng.randrange(len(b))
    return Mutant("two files spliced", seed, a[:first] + b[second:], seed.intent, "oracle")


def splice_lines(seed: Seed, rng: Random) -> Mutant:
    other = rng.choice(seeds()) if rng.random() < 0.7 else seed
    kept = rng.randrange(seed.first + 1, len(seed.lines))
    start = rng.choice((0, other.names, rng.randrange(len(other.lines))))
    mutant = textual("two files joined", seed, [*seed.lines[:kept], *other.lines[start:]], expect="oracle")
    # under its own head a table has its own units and marks
    return replace(mutant, turn=(kept, other.intent)) if start <= other.names else mutant


def later_part(seed: Seed, rng: Random) -> Mutant:
    """A file that goes on after its header is repeated, as where a log is appended to."""
    at = rng.randrange(seed.first + 2, len(seed.lines) - 2)
    lines = [*seed.lines[:at], *seed.lines[: seed.first], *seed.lines[at:]]
    return textual("header repeated within", seed, lines, expect="oracle")


def other_units_within(seed: Seed, rng: Random) -> Mutant | None:
    """Appended to with other units or another order of columns: must be refused."""
    if seed.units is None:
        return None
    at = rng.randrange(seed.first + 2, len(seed.lines) - 2)
    head = list(seed.lines[seed.names : seed.first])
    changed = [line.replace("mm", "m").replace("kN", "N").replace("N", "mN") for line in head[1:]]
    lines = [*seed.lines[:at], head[0], *changed, *seed.lines[at:]]
    return textual("other units within", seed, lines, expect="refusal")


DRESS: tuple[Mutation, ...] = (
    redelimit, redelimit_rows, one_delimiter, trailing_delimiters, pad, requote, tear_quote, line_ends,
    file_end, blank_lines, reencode, stray_bytes, header, group_thousands, swap_decimal,
)  # fmt: skip
CUTS: tuple[Mutation, ...] = (
    truncate, remove_lines, duplicate_lines, swap_lines, move_block, cut_bytes, repeat_bytes, splice,
    splice_lines, later_part, other_units_within,
)  # fmt: skip
STRUCTURE = DRESS + CUTS
