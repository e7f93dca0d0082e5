"""Tables of results, which an export may print above or below the samples, and which are no samples.

::

    Results Table 1
    ,Maximum Load,Extension at Maximum Load
    ,(N),(mm)
    1,12.31000,4.10000
    Mean,12.80000,4.21000
    Standard deviation,0.41000,0.08000

Such a table is known by its title, by a row of statistics, or by names and units of its own.  Its rows
may be as wide as those of the samples, so nothing else keeps them apart.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from tissueid.flags import Flag
from tissueid.ingest.columns import has_channels, split_name
from tissueid.ingest.numbers import looks_numeric
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.vocabulary import plain_words
from tissueid.units import quantity_of

Row = Sequence[str]

_BRACKETED = re.compile(r"\s*[(\[].*[)\]]\s*")
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
_TITLE = re.compile(
    r"(?:results?(?: table)?|statistics|ergebnis(?:se|tabelle)?|statistik|(?:tableau (?:de |des )?)?resultats"
    r"|(?:tabla |tabela )?(?:de |dos )?resultados|(?:tabella )?(?:dei )?risultati|(?:tabela )?wynik(?:i|ow)"
    r"|结果表?|结果表格|統計|统计|結果表?)(?: \d+)?"
)


def _filled(row: Row) -> list[str]:
    return [cell.strip() for cell in row if cell.strip()]


def is_statistics(row: Row) -> bool:
    """True where a row is a mean, a standard deviation and the like: its first filled cell says so."""
    opening = next((cell for cell in row if cell.strip()), "")
    # nearly all rows are samples, and done with here
    if not opening or looks_numeric(opening):
        return False
    return len(_filled(row)) > 1 and _STATISTICS.fullmatch(plain_words(opening.strip())) is not None


def is_title(row: Row) -> bool:
    """True where a line announces results."""
    filled = _filled(row)
    return len(filled) == 1 and _TITLE.fullmatch(plain_words(filled[0])) is not None


def is_units_row(row: Row) -> bool:
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


def _is_text(row: Row) -> bool:
    """A line that holds something, but no number."""
    opening = next((cell for cell in row if cell.strip()), "")
    return bool(opening) and not looks_numeric(opening) and not any(map(looks_numeric, _filled(row)))


def _carries_units(row: Row) -> bool:
    """Names with their units, as over a table without a units row."""
    return sum(split_name(cell)[1] is not None for cell in _filled(row)) >= 2


def results_below(rows: Sequence[Row], names: Row, units: Row, options: ReadOptions) -> int | None:
    """First row of a table of results among the rows under the names of a recording.

    ``rows``: rows of the recording and what follows, or the last of them; blank ones included; ``names``,
    ``units``: head of the recording: where it is repeated, the recording goes on.  Returns ``None`` where all
    rows belong to the recording, or to another recording.
    """
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


def _top(rows: Sequence[Row], at: int, own: set[tuple[str, ...]]) -> int:
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


def results_spans(rows: Sequence[Row]) -> list[range]:
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


def _end(rows: Sequence[Row], index: int) -> int:
    """End of a table of results: at a blank line, or at the next head."""
    below_head = False
    while index < len(rows) and _filled(rows[index]):
        text = _is_text(rows[index])
        if text and below_head:
            break
        below_head = below_head or not text
        index += 1
    return index


def announced_results(rows: Sequence[Row]) -> list[range]:
    """Those of :func:`results_spans` that a title or a row of statistics leaves no doubt about."""
    return [
        span
        for span in results_spans(rows)
        if is_title(rows[span.start]) or any(is_statistics(rows[index]) for index in span)
    ]


def results_flag(first: int, last: int) -> Flag:
    """Flag of a table of results in the lines ``first`` to ``last``, counted from 1."""
    return Flag(
        "rows_skipped",
        f"lines {first} to {last} are a table of results, not samples: left out",
        {"count": last - first + 1, "lines": [first, last]},
    )


def _opens_results(rows: Sequence[Row], index: int) -> bool:
    row = rows[index]
    opening = next((cell for cell in row if cell.strip()), None)
    if opening is None or looks_numeric(opening):
        # titles, statistics and heads begin with a word: nearly all lines are samples, and done with here
        return False
    if is_title(row) or is_statistics(row):
        return True
    named = _is_text(row) and len(_filled(row)) >= 2
    return named and (_carries_units(row) or (index + 1 < len(rows) and is_units_row(rows[index + 1])))
