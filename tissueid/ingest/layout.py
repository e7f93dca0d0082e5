"""Layout of the table in a file: delimiter, header, names, units, first row, decimal mark, and results.

The table is the longest run of rows of numbers in the head of the file, the names are sought above it.  A
table of results is known by its title, by a row of statistics, or by names and units of its own.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import zip_longest

from tissueid.flags import Flag
from tissueid.ingest.columns import channel_columns, has_channels
from tissueid.ingest.header_units import between_names, stated_units
from tissueid.ingest.labelled import units_beside, with_units
from tissueid.ingest.numbers import Row, decimal_evidence, is_word, looks_numeric
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.refusals import Place
from tissueid.ingest.text import HEAD_BYTES, Text
from tissueid.ingest.vocabulary import is_comment_name, is_units_key, plain_words, split_name
from tissueid.units import quantity_of

Cells = Sequence[str]

_BRACKETED = re.compile(r"\s*[(\[（［【].*[)\]）］】]\s*")
_STATISTICS = re.compile(
    r"mean|average|median|(?:sample )?standard deviation|std(?: dev)?|s d|sd|(?:mean|media|moyenne) [\d ]*sd"
    r"|coefficient of variation|c ?v|minimum|maximum|range|count"
    r"|mittelwert|standardabweichung|variationskoeffizient|spannweite"
    r"|moyenne|ecart type|mediane|coefficient de variation|etendue"
    r"|medi[ao]|mediana|desviacion (?:estandar|tipica)|coeficiente de variacion|minimo|maximo|rango"
    r"|desvio padrao|coeficiente de variacao|amplitude"
    r"|deviazione standard|coefficiente di variazione|massimo"
    r"|srednia|odchylenie standardowe|wspolczynnik zmiennosci|rozstep"
    r"|平均值?|均值|标准偏差|标准差|標準偏差|中值|中位数|最大值?|最小值?|范围|变异系数"
)
_MOMENT = re.compile(r"\d+([:/.-])\d+\1\d")
_TITLE = re.compile(
    r"(?:results?(?: table)?|statistics|ergebnis(?:se|tabelle)?|statistik|(?:tableau (?:de |des )?)?resultats"
    r"|(?:tabla |tabela )?(?:de |dos )?resultados|(?:tabella )?(?:dei )?risultati|(?:tabela )?wynik(?:i|ow)"
    r"|结果表?|结果表格|統計|统计|結果表?)(?: \d+)?"
)


def _filled(row: Cells) -> list[str]:
    return [cell.strip() for cell in row if cell.strip()]


def _opening(row: Cells) -> str:
    """The first filled cell of a row, empty where there is none."""
    return next((cell for cell in row if cell.strip()), "")


def is_statistics(row: Cells) -> bool:
    """True where a row is a mean, a standard deviation and the like: its first filled cell says so."""
    opening = _opening(row)
    # nearly all rows are samples, and done with here
    if not opening or looks_numeric(opening):
        return False
    filled, word = _filled(row), plain_words(opening.strip())
    if word in {"min", "max"}:  # over columns a minute
        return looks_numeric(filled[-1])
    return len(filled) > 1 and _STATISTICS.fullmatch(word) is not None


def is_title(row: Cells) -> bool:
    """True where a line announces results."""
    filled = _filled(row)
    return len(filled) == 1 and _TITLE.fullmatch(plain_words(filled[0])) is not None


def is_units_row(row: Cells) -> bool:
    """True where a row states units: ``(sec),(mm),(N),,`` or ``"s","mm","N"``."""
    filled = _filled(row)
    if not filled or any(map(looks_numeric, filled)):
        return False
    if all(_BRACKETED.fullmatch(cell) for cell in filled):
        return True
    unknown = 0
    for cell in filled:
        if quantity_of(cell) is None and _BRACKETED.fullmatch(cell) is None:
            unknown += 1
            if 2 * unknown >= len(filled):
                return False
    return len(filled) - unknown >= 2


def _is_text(row: Cells) -> bool:
    """A line that holds something, but no number."""
    opening = _opening(row)
    return bool(opening) and not looks_numeric(opening) and not any(map(looks_numeric, _filled(row)))


def _carries_units(row: Cells) -> bool:
    """Names with their units, as over a table without a units row."""
    return sum(split_name(cell)[1] is not None for cell in _filled(row)) >= 2


def results_below(rows: Sequence[Cells], names: Cells, units: Cells, options: ReadOptions) -> int | None:
    """First row of a table of results under a recording, ``None`` where all rows belong to a recording."""
    own = {tuple(_filled(names)), tuple(_filled(units))}
    statistics = next((index for index, row in enumerate(rows) if is_statistics(row)), None)
    if statistics is not None:
        return _top(rows, statistics, own)
    for index, row in enumerate(rows):
        if not _is_text(row) or tuple(_filled(row)) in own:
            continue
        below = next((later for later in rows[index + 1 :] if _filled(later)), ())
        named = len(_filled(row)) >= 2 and (is_units_row(below) or _carries_units(row))
        if has_channels(row, below, options):
            return None
        if is_title(row) or (named and tuple(_filled(below)) not in own):
            return index
    return None


def _foot(rows: Sequence[Cells]) -> int | None:
    """First line of keys and values behind the last row: ``Peak force,7.02,N``."""
    last = max((index for index, row in enumerate(rows) if row and looks_numeric(row[0])), default=-1)
    foot = [index for index in range(last + 1, len(rows)) if _filled(rows[index])]
    if last < 0 or not foot or _numeric_share(tuple(rows[foot[0]])) > 0.0:
        return None
    words = all(is_word(_opening(rows[index])) for index in foot)
    return foot[0] if words and any(looks_numeric(c) for i in foot for c in rows[i]) else None


def _top(rows: Sequence[Cells], at: int, own: set[tuple[str, ...]]) -> int:
    """The first line of the table in which a row of statistics stands."""
    head = at
    while head > 0 and _filled(rows[head - 1]) and not _is_text(rows[head - 1]):
        head -= 1
    top = head
    while top > 0 and (_is_text(rows[top - 1]) or not _filled(rows[top - 1])):
        top -= 1
    lines = [row for row in rows[top:head] if _filled(row) and tuple(_filled(row)) not in own]
    # a remark of the operator among the samples is no head
    if any(is_title(row) or is_units_row(row) or len(_filled(row)) >= 2 for row in lines):
        return next(index for index in range(top, head) if _filled(rows[index]))
    return at


def results_spans(rows: Sequence[Cells]) -> list[range]:
    """Tables of results among the lines of a header, each from its title or head to its last row."""
    spans: list[range] = []
    index = 0
    while index < len(rows):
        if not _opens_results(rows, index):
            index += 1
            continue
        start = index
        while is_statistics(rows[start]) and start > 0 and _filled(rows[start - 1]):
            start -= 1
        index = _end(rows, index)
        spans.append(range(start, index))
    return spans


def _end(rows: Sequence[Cells], index: int) -> int:
    """End of a table of results: at a blank line, or at the next head."""
    below_head = False
    while index < len(rows) and _filled(rows[index]):
        text = _is_text(rows[index])
        if text and below_head:
            break
        below_head = below_head or not text
        index += 1
    return index


def announced_results(rows: Sequence[Cells]) -> list[range]:
    """Those of :func:`results_spans` that a title or a row of statistics leaves no doubt about."""
    return [
        span
        for span in results_spans(rows)
        if is_title(rows[span.start]) or any(is_statistics(rows[index]) for index in span)
    ]


def results_flag(first: int, last: int) -> Flag:
    """Flag of a table of results in the lines ``first`` to ``last``, counted from 1."""
    message = f"lines {first} to {last} are a table of results, not samples: left out"
    return Flag("rows_skipped", message, {"count": last - first + 1, "lines": [first, last]})


def _opens_results(rows: Sequence[Cells], index: int) -> bool:
    row = rows[index]
    opening = _opening(row)
    if not opening or looks_numeric(opening):
        # titles, statistics and heads begin with a word: nearly all lines are samples, and done with here
        return False
    if is_title(row) or is_statistics(row):
        return True
    # a date or clock is a value of the header, no name
    named = _is_text(row) and len(_filled(row)) >= 2 and not any(map(_MOMENT.match, _filled(row)))
    return named and (_carries_units(row) or (index + 1 < len(rows) and is_units_row(rows[index + 1])))


_PADDED_BY_TABS = re.compile(r"\d[,;]\t")
_DELIMITERS = (";", "\t", "|", ",")
_TAIL_BYTES = 1 << 12
#: Lines in which the table is sought, and how many of the last of them vote on the delimiter.
_HEAD_LINES = 200
_SCORED_LINES = 100
#: Rows of numbers whose marks decide by themselves where they agree.
_VOTING_ROWS = 40
#: Lines between names and numbers in which units stand, and the longest word that may be one.
_ROWS_OF_HEAD = 3
_LONGEST_WORD = 12
#: Longer cells are prose, be there words of columns in it or not.
_LONGEST_NAME = 80
#: What a program writes before a line of words that is no data of its own, and before names in one.
_COMMENT_MARK = re.compile(r"(?i)\A\s*(?:[#%]+|//+)\s*(?:(?:column|field|format)s? *: *)?(?=[^\W\d_]|[(\[])")
#: A tail of nothing but numbers holds no results.
_ONLY_NUMBERS = re.compile(rb"[-+\d.,;:'\t\r\n\"eE \xa0]*")


@dataclass(frozen=True, slots=True)
class Anchor:
    """Rows of a table by their number, counted from 0; ``None`` where there is no such row."""

    names: int | None
    units: int | None
    first: int

    def head(self, rows: Sequence[Row]) -> tuple[Row, Row]:
        """Names and units among the rows in which they were found; empty where there are none."""
        names = () if self.names is None else rows[self.names]
        return names, () if self.units is None else _without_key(rows[self.units], len(names))


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a text file."""

    delimiter: str
    decimal: str
    header: tuple[Row, ...]  # lines above the names, cut into cells
    #: Padded to ``n_columns``; empty texts where the file has none.
    names: Row
    units: Row
    units_in_row: bool  # whether there is a units row
    names_line: int | None  # one-based
    first_line: int  # one-based line at which the rows begin
    offset: int  # byte at which the rows begin
    n_columns: int
    numeric: tuple[bool, ...]  # which columns hold numbers in the sample
    stop: int | None = None  # byte at which a table of results begins below the rows, ``None`` without one
    clock: int | None = None  # column of clock times, which are seconds by now
    remarked: bool = False  # whether a row may end in a remark, under a name for it that most rows leave out


def split_line(line: str, delimiter: str) -> Row:
    """The cells of a header line, quotes removed; forgiving, unlike the reader of rows."""
    line = line.rstrip("\r\n")
    if '"' not in line:
        return tuple(line.split(delimiter))
    try:
        return tuple(next(csv.reader([line], delimiter=delimiter)))
    except (csv.Error, StopIteration):
        return tuple(line.split(delimiter))


@lru_cache(maxsize=1024)
def _numeric_share(row: Row) -> float:
    """The share of a row's filled cells that look numeric, 0 where fewer than two do."""
    if len(row) < 2:
        return 0.0
    filled = [cell for cell in row if cell.strip()]
    numeric = sum(map(looks_numeric, filled))
    return numeric / len(filled) if numeric >= 2 else 0.0


def _runs(rows: Sequence[Row]) -> list[range]:
    """Stretches of rows of numbers, in their order, but those that end in statistics last."""
    samples: list[range] = []
    results: list[range] = []
    start, stop = -1, -1
    for index, row in enumerate(rows):
        if not _filled(row):
            continue
        if _numeric_share(row) >= 0.5 and not is_statistics(row):
            start, stop = (index if start < 0 else start), index + 1
        elif start >= 0:
            (results if is_statistics(row) else samples).append(range(start, stop))
            start = -1
    if start >= 0:
        samples.append(range(start, stop))
    longest = max(map(len, samples), default=0)
    return samples + [run for run in results if len(run) > longest]


def anchor(rows: Sequence[Row], options: ReadOptions) -> Anchor | None:
    """Names, units and first row of the recording, ``None`` where no row holds two numbers.

    It is the first run of two and more rows of numbers under names that say what time, displacement and force
    are; where there are no such names, the longest run.
    """
    inside = {index for span in announced_results(rows) for index in span}
    runs = _runs(rows)
    runs = [run for run in runs if run.start not in inside] or runs
    for run in [run for run in runs if len(run) > 1] + [run for run in runs if len(run) == 1]:
        found = _named_anchor(rows, run.start, options)
        if found is not None:
            return found
    if not runs:
        return None
    first = max(runs, key=len).start
    found = _anchor_without_words(rows, first, options)
    if found.names is None or found.units is not None:
        return found
    return replace(found, units=units_above(rows, found.names, options))


def _filled_above(rows: Sequence[Row], first: int) -> list[int]:
    return [i for i in range(first - 1, -1, -1) if _filled(rows[i])]


def _named_anchor(rows: Sequence[Row], first: int, options: ReadOptions) -> Anchor | None:
    """The names above a run that say what time, displacement and force are, with the units below them."""
    for index in _filled_above(rows, first):
        if is_statistics(rows[index]):
            return None  # what stands higher are results and their names
        if _numeric_share(rows[index]) > 0.0 or is_units_row(rows[index]):
            continue
        if all(map(looks_numeric, _filled(rows[index]))):
            continue  # how many rows follow
        below = [i for i in range(index + 1, first) if _filled(rows[i])][:_ROWS_OF_HEAD]
        units = next((i for i in below if is_units_row(rows[i])), None)
        if units is None and below and _stands_as_units(rows, index, below[0], options):
            units = below[0]
        if has_channels(rows[index], rows[units] if units is not None else (), options):
            after = (units if units is not None else index) + 1
            above = units_above(rows, index, options) if units is None else None
            return Anchor(index, units if above is None else above, after)
    return None


def _stands_as_units(rows: Sequence[Row], names: int, at: int, options: ReadOptions) -> bool:
    """True where a row has a short word under each channel: units, be they known or not."""
    cells = rows[at]
    under = channel_columns(rows[names], options)
    return bool(under) and all(
        index < len(cells)
        and 0 < len(cells[index].strip()) <= _LONGEST_WORD
        and " " not in cells[index].strip()
        and is_word(cells[index])
        for index in under.values()
    )


def units_above(rows: Sequence[Row], names: int, options: ReadOptions) -> int | None:
    """A row of units right above the names, or one of the header that says so by its first cell."""
    columns = channel_columns(rows[names], options)
    for index in _filled_above(rows, names) if columns else ():
        if index < names - 1 and not is_units_key(_opening(rows[index])):
            continue
        cells = _without_key(rows[index], len(rows[names]))
        printed = [(channel, cells[k]) for channel, k in columns.items() if k < len(cells)]
        stated = [(channel, quantity_of(cell)) for channel, cell in printed if cell.strip()]
        if len(stated) >= 2 and all(quantity == options.quantity(channel) for channel, quantity in stated):
            return index
    return None


def _without_key(row: Row, width: int) -> Row:
    """A row of units without the word that announces it, be that in a cell of its own or not."""
    if not row or not is_units_key(row[0]):
        return row
    return row[1:] if len(row) > width else (row[0].partition(":")[2].strip(), *row[1:])


def _anchor_without_words(rows: Sequence[Row], best: int, options: ReadOptions) -> Anchor:
    """Names that are no known words: the line above the units, else the line above the numbers."""
    above = _filled_above(rows, best)
    if not above:
        return Anchor(None, None, best)
    row, over = rows[above[0]], rows[above[1]] if len(above) > 1 else ()
    if is_units_row(row):
        if over and len(over) < len(row) and has_channels(row, (), options):
            return Anchor(above[0], None, best)  # under a title
        if len(over) >= max(2, len(row) - 1):
            return Anchor(above[1], above[0], best)
        if all(_BRACKETED.fullmatch(cell) for cell in row if cell.strip()):
            return Anchor(None, above[0], best)
    named = len(_filled(row)) >= 2 and _numeric_share(row) == 0.0
    return Anchor(above[0] if named and len(row) >= len(rows[best]) - 1 else None, None, best)


#: Line that says in what a data logger wrote: Aurora's ``Test Data in Volts:``.
_IN_VOLTS = re.compile(r"\W*(?:test |raw )?data in (?:volts|V)\b", re.IGNORECASE)
#: Line of a force that may be in whole numbers of counts: ``Counts per Unit Force:,1000000``.
_IN_COUNTS = re.compile(
    r"\W*(?:counts?|bits) ?(?:per|/) ?(?:unit )?(?:of )?(?:force|m?N\b|newton)", re.IGNORECASE
)


def _head_lines(text: Text, place: Place) -> list[bytes]:
    """Whole lines of the first bytes of a file."""
    raw = text.data[:HEAD_BYTES].splitlines(keepends=True)
    if len(text.data) > HEAD_BYTES:
        raw = raw[:-1]
    if not text.data:
        place.refuse("empty_file", "the file is empty; export the test again")
    if not raw:
        place.refuse("not_an_export", f"the first line is longer than {HEAD_BYTES} bytes: this is no table")
    return raw


def find_layout(text: Text, options: ReadOptions, place: Place) -> Layout:
    """Lay out a text file."""
    raw = _head_lines(text, place)
    for count in (_HEAD_LINES, len(raw)):  # of few headers the table begins so far down
        lines = [text.decode(line) for line in raw[:count]]
        delimiter = options.delimiter or _find_delimiter(lines)
        cells = (split_line(line, delimiter) for line in lines)
        rows = [(_COMMENT_MARK.sub("", first), *others) for first, *others in cells]
        found = anchor(rows, options)
        if found is not None or count >= len(raw):
            break
    if found is None:
        raise _no_numbers(rows, delimiter, options, place)
    _refuse_volts(lines, place)
    _refuse_rows_above(rows, found, place)
    names, units = found.head(rows)
    if found.names is not None and found.units is None:
        units = stated_units(rows[: found.names], names, options)
    below = rows[found.first :]
    results = None
    if not _ONLY_NUMBERS.fullmatch(b"".join(raw[found.first : len(rows)])):
        results = results_below(below, names, units, options)
    sample = [row for row in below[:results] if _numeric_share(row) >= 0.5]
    if not sample:
        message = "under the names stand results or another table, but no row of numbers; export the raw data"
        place.refuse("no_rows", message, line=found.first + 1)
    _refuse_counts(lines, sample, channel_columns(names, options).get("force"), options, place)
    n_columns = Counter(map(len, sample)).most_common(1)[0][0]
    names, units = between_names(names, units, n_columns)
    names = tuple(one or own for one, own in zip_longest(names, text.names, fillvalue=""))
    cells = (split_line(text.decode(line), delimiter) for line in io.BytesIO(text.data))
    beside = text.units or units_beside(names if any(names) else sample[0], cells, place)
    units = with_units(names, units, beside, place)
    decimal = options.decimal or find_decimal(text, sample, delimiter, place, first=found.first, rows=below)
    layout = Layout(
        delimiter,
        decimal,
        _without_results(rows[: found.first if found.names is None else found.names]),
        _padded(names, n_columns, comments=True),
        _padded(units, n_columns),
        found.units is not None,
        None if found.names is None else found.names + 1,
        found.first + 1,
        sum(map(len, raw[: found.first])),
        n_columns,
        numeric_columns(sample, n_columns),
        remarked=n_columns < len(names) and is_comment_name(names[n_columns]),
        clock=text.clock_column(delimiter),
    )
    end = None if results is None else sum(map(len, raw[: found.first + results]))
    return replace(layout, stop=_stop_in_tail(text, layout, options) if end is None else end)


def numeric_columns(sample: Sequence[Row], n_columns: int) -> tuple[bool, ...]:
    """Tell which columns hold numbers in the first rows; none where there are no rows."""
    first = sample[:50]
    return tuple(
        bool(first) and all(i < len(row) and looks_numeric(row[i]) for row in first) for i in range(n_columns)
    )


def _refuse_volts(lines: Sequence[str], place: Place) -> None:
    """Refuse what a data logger says that it wrote in volts."""
    volts = next((k for k, line in enumerate(lines[:_HEAD_LINES]) if _IN_VOLTS.match(line)), None)
    if volts is not None:
        message = f"{lines[volts].strip()!r}: volts are no travel, no force; export in calibrated units"
        place.refuse("wrong_unit", message, line=volts + 1)


def _refuse_counts(
    lines: Sequence[str], sample: Sequence[Row], force: int | None, options: ReadOptions, place: Place
) -> None:
    """Refuse a force in whole numbers under a line that says how many counts are a unit of it."""
    counts = next((k for k, line in enumerate(lines[:_HEAD_LINES]) if _IN_COUNTS.match(line)), None)
    if counts is None or force is None or "force" in options.units:
        return
    if all(cell.strip().lstrip("+-").isdigit() for row in sample for cell in row[force : force + 1]):
        message = f"{lines[counts].strip()!r}: the force is in counts; divide it by them, or state their unit"
        place.refuse("wrong_unit", f"{message} with --units force=UNIT", line=counts + 1, column=force + 1)


def _refuse_rows_above(rows: Sequence[Row], found: Anchor, place: Place) -> None:
    """Refuse rows of numbers above the names: they would be passed over as if they were a header."""
    above = rows[: found.first if found.names is None else found.names]
    inside = {index for span in results_spans(above) for index in span}
    for run in _runs(above):
        # an entry of a header begins with its key, whatever numbers follow it
        rows_alone = [index for index in run if looks_numeric(next(filter(str.strip, above[index])))]
        if len(rows_alone) > 1 and run.start not in inside:
            message = (
                f"{len(rows_alone)} rows of numbers stand above the names in line {len(above) + 1}, which are"
                " no results: is this two files in one, or were rows moved? Export the file again"
            )
            place.refuse("mixed_tables", message, line=run.start + 1)


def _without_results(header: Sequence[Row]) -> tuple[Row, ...]:
    left_out = {index for span in results_spans(header) for index in span}
    return tuple(row for index, row in enumerate(header) if index not in left_out and _filled(row))


def _stop_in_tail(text: Text, layout: Layout, options: ReadOptions) -> int | None:
    """The byte at which results begin in the last lines of the file, ``None`` where there are none."""
    start = max(layout.offset, len(text.data) - HEAD_BYTES)
    tail = text.data[start:]
    if _ONLY_NUMBERS.fullmatch(tail):
        return None
    raw = tail.splitlines(keepends=True)
    rows = [split_line(text.decode(line), layout.delimiter) for line in raw]
    results = results_below(rows, layout.names, layout.units, options)
    results = _foot(rows) if results is None else results
    return None if results is None else start + sum(map(len, raw[:results]))


def _padded(row: Row, n_columns: int, *, comments: bool = False) -> Row:
    """Empty cells at the end are added or dropped; a filled one stays and is refused later."""
    cells = list(row)
    while len(cells) > n_columns and (not cells[-1].strip() or (comments and is_comment_name(cells[-1]))):
        cells.pop()
    return tuple(cells + [""] * (n_columns - len(cells)))


def _find_delimiter(lines: Sequence[str]) -> str:
    """The delimiter with which most cells of most lines are numbers; the first of equals.

    A tab behind a comma or semicolon is padding.
    """

    def score(delimiter: str) -> float:
        scored = [
            line for line in lines[-_SCORED_LINES:] if delimiter != "\t" or not _PADDED_BY_TABS.search(line)
        ]
        return sum(_numeric_share(split_line(line, delimiter)) for line in scored)

    return max(_DELIMITERS, key=score)


def _no_numbers(rows: Sequence[Row], delimiter: str, options: ReadOptions, place: Place) -> Exception:
    if 2 * sum(len(filled) == 1 and looks_numeric(filled[0]) for filled in map(_filled, rows)) > len(rows):
        message = "there is one number a line, and a recording is force over displacement: export both"
        return place.refusal("not_an_export", message, line=1)
    for index, row in enumerate(rows):
        if max(map(len, row)) <= _LONGEST_NAME and has_channels(row, (), options):
            message = "there is no row of numbers under the names; export the raw data again"
            return place.refusal("no_rows", message, line=index + 1)
    filled = [index for index, row in enumerate(rows) if _filled(row)]
    line = filled[0] + 1 if filled else 1
    start = delimiter.join(rows[line - 1])[:60].strip() if rows else ""
    message = (
        f"no line holds a row of numbers (the text begins {start!r}); give the raw data export of the"
        f" test machine"
    )
    return place.refusal("not_an_export", message, line=line)


def find_decimal(
    text: Text, sample: Sequence[Row], delimiter: str, place: Place, *, first: int, rows: Sequence[Row]
) -> str:
    """Point or comma, by the votes of the first rows and, where these are divided or silent, of more."""
    votes = decimal_evidence(cell for row in sample[:_VOTING_ROWS] for cell in row if looks_numeric(cell))
    if min(votes[:2]) == 0 < max(votes[:2]):
        return "." if votes[0] else ","
    tail: list[Row] = []
    if first + len(rows) >= _HEAD_LINES:  # the sample does not reach the end of the file
        last = text.data[-_TAIL_BYTES:].splitlines()[1:-1]
        tail = [split_line(text.decode(line), delimiter) for line in last]
    cells = [cell for row in (*sample, *tail) for cell in row if looks_numeric(cell)]
    points, commas, open_cells = decimal_evidence(cells)
    if points != commas:
        return "." if points > commas else ","
    if not open_cells:
        return "."
    for index, row in enumerate(rows, start=first):
        for column, cell in enumerate(row):
            marks = cell.count(".") + cell.count(",")
            if not looks_numeric(cell) or marks == 0:
                continue
            if marks > 1:
                return "."  # damaged: the reader of rows will name it
            message = (
                f"{cell!r} may be a decimal number or a thousand and more, and no other cell decides;"
                " state the decimal mark with --decimal"
            )
            place.refuse("ambiguous_decimal", message, line=index + 1, column=column + 1)
    return "."
