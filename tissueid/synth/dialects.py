"""Dialects of Bluehill's exports: locales, versions and options, each with a name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from tissueid.synth.languages import LANGUAGES

ENGLISH = LANGUAGES["en"].names


@dataclass(frozen=True, slots=True)
class Dialect:
    """Print of an export."""

    #: ``thousands`` is empty for none; it is printed inside quotes only.
    delimiter: str = ","
    decimal: str = "."
    thousands: str = ""
    quoted: bool = False  # every data cell in quotes
    encoding: str = "ascii"  # codec of the bytes; ``utf-8-sig`` writes a byte-order mark
    names: tuple[str, str, str] = ENGLISH  # column names of time, displacement and force
    #: Whether there is a header, and a row of units.
    header: bool = True
    units_row: bool = True
    newline: str = "\r\n"
    description: str = ""  # one line for the help
    language: str = "en"  # of the header's keys and the results, where that is not English
    groups: bool = True  # whether header keys carry their group: ``"Test : Rate 1"``
    header_lines: int = 0  # filled up to this number of lines
    #: Header keys, values and units each on a line of their own, and results one a line.
    vertical: bool = False
    #: As printed in the units row, or in the names where there is no such row.
    units: tuple[str, str, str] = ("(sec)", "(mm)", "(N)")
    unit_in_names: bool = False
    order: tuple[int, int, int] = (0, 1, 2)  # position of time, displacement and force among the three
    #: Further columns, as name, unit and the cell of every row; text makes a comment column.
    columns: tuple[tuple[str, str, str], ...] = ()
    results: str = ""  # ``""``, ``"before"`` or ``"after"``: where a table of results stands
    wrapped: bool = False  # whole lines quoted, as a spreadsheet does
    #: Before the first line and after the last.
    lead: str = ""
    end: str = ""


def _spoken(language: str, how: Dialect) -> Dialect:
    """A dialect in another language than English, header and results included."""
    return replace(how, language=language, names=LANGUAGES[language].names)


_BARE = Dialect()
_COMMA = Dialect(delimiter=";", decimal=",")
_QUOTED = Dialect(quoted=True, thousands=",")
_LATIN = replace(_COMMA, encoding="latin-1")
_COUNTERS = (("Segment ID", "", "22476"), ("Total Cycle Count", "", "0"))
_COMMENT = (("Comment", "(text)", "no remark"),)
_NBSP = "\u00a0"

_DESCRIBED: dict[str, tuple[str, Dialect]] = {
    "bare": ("commas, bare cells: the default of the export", _BARE),
    "headless": ("no header, LF", replace(_BARE, header=False, newline="\n")),
    "quoted": ("quoted cells with thousands separators", _QUOTED),
    "semicolon": ("semicolons and decimal commas", replace(_COMMA, encoding="utf-8")),
    "semicolon-quoted": (
        "decimal commas in quotes, no-break spaces between thousands",
        replace(_COMMA, thousands=_NBSP, quoted=True, encoding="utf-8"),
    ),
    "german-latin-1": ("German columns, latin-1", replace(_LATIN, names=LANGUAGES["de"].names)),
    "french-latin-1": (
        "French columns, quoted, latin-1",
        replace(_LATIN, quoted=True, names=LANGUAGES["fr"].names),
    ),
    "spanish-bom": (
        "Spanish columns, UTF-8 with a byte order mark",
        Dialect(encoding="utf-8-sig", names=LANGUAGES["es"].names),
    ),
    "polish-cp1250": (
        "Polish columns, cp1250",
        replace(_COMMA, encoding="cp1250", names=LANGUAGES["pl"].names),
    ),
    "utf-16": ("UTF-16 with a byte order mark", Dialect(encoding="utf-16")),
    "utf-16-be": ("UTF-16, big end first, without a mark", Dialect(encoding="utf-16-be")),
    "tab": ("tabs", Dialect(delimiter="\t")),
    "tab-utf-16": ("tabs, UTF-16 without a mark", Dialect(delimiter="\t", encoding="utf-16-le")),
    "vertical": ("keys, values and results below each other", Dialect(vertical=True, results="after")),
    "vertical-before": (
        "vertical, without groups, results before the samples",
        Dialect(vertical=True, results="before", groups=False),
    ),
    "results-before": ("a table of results before the samples", Dialect(results="before")),
    "results-after": ("a table of results after the samples", Dialect(results="after")),
    "results-quoted": (
        "decimal commas in quotes, points between thousands, results after the samples",
        replace(_COMMA, quoted=True, thousands=".", results="after", encoding="utf-8"),
    ),
    "wrapped": ("whole lines quoted by a spreadsheet", replace(_QUOTED, wrapped=True)),
    "unit-in-names": (
        "units in the names, no row of units",
        Dialect(unit_in_names=True, units_row=False, units=("s", "mm", "N")),
    ),
    "no-units": ("no unit anywhere", Dialect(units_row=False)),
    "cr-only": ("lines ended by CR alone", Dialect(newline="\r")),
    "crcrlf": ("an empty first line and a last CR CR LF", Dialect(end="\r\r\n", lead="\r\n")),
    "counters": ("counters without unit", Dialect(columns=_COUNTERS)),
    "comments": ("a column of text, counters", Dialect(columns=_COMMENT + _COUNTERS)),
    "load-first": ("Load before Extension", Dialect(order=(0, 2, 1))),
    "long-header": ("48 header lines", Dialect(header_lines=48)),
    "ungrouped": ("header keys without their group", Dialect(header_lines=12, groups=False)),
    "swiss": (
        "apostrophes between thousands",
        Dialect(delimiter=";", thousands="'", quoted=True),
    ),
    "german": ("German throughout", _spoken("de", replace(_LATIN, results="after"))),
    "french": ("French throughout", _spoken("fr", replace(_LATIN, results="after"))),
    "spanish": ("Spanish throughout", _spoken("es", replace(_COMMA, encoding="utf-8", results="after"))),
    "portuguese": ("Portuguese throughout", _spoken("pt", replace(_LATIN, results="before"))),
    "italian": ("Italian throughout", _spoken("it", replace(_LATIN, results="after"))),
    "polish": ("Polish throughout", _spoken("pl", replace(_COMMA, encoding="cp1250", results="before"))),
    "chinese-gbk": ("Chinese throughout, GBK", _spoken("zh", Dialect(encoding="gbk", results="after"))),
    "japanese": (
        "Japanese throughout, Shift-JIS",
        _spoken("ja", Dialect(encoding="cp932", results="after")),
    ),
    "chinese": (
        "Chinese throughout, UTF-8 with a byte order mark",
        _spoken("zh", Dialect(encoding="utf-8-sig", results="before")),
    ),
}

#: Dialects by name.
DIALECTS: Mapping[str, Dialect] = MappingProxyType(
    {name: replace(how, description=text) for name, (text, how) in _DESCRIBED.items()}
)
