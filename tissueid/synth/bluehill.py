"""Write a log as a Bluehill raw-data CSV; knows nothing of the reader that will meet it.

::

    Text Inputs : Specimen label,"paper-a"

    Time,Extension,Load
    (sec),(mm),(N)
    0.00000,0.00000,-0.31415

What the locales, versions and options of the export change is a :class:`Dialect`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from tissueid.synth.languages import LANGUAGES
from tissueid.synth.simulate import SyntheticLog

__all__ = ["DIALECTS", "Dialect", "bluehill_csv"]

ENGLISH = LANGUAGES["en"].names
#: What fills a header up: results, GUIDs, nothing, a placeholder, keys with ellipses, a date.
_FILLER = (
    ("General : Operator", "<Ninguno>", ""),
    ("General : GUID", "{9F3C1C2A-5E0B-4A6E-9B9E-0123456789AB}", ""),
    ("Text Inputs : Comment", "", ""),
    ("Dimension : Thickness", "12.50000", "mm"),
    ("General : Start Date", "13/11/2018 5:14 PM", ""),
    ("Calculations : Maximum Load at ...", "1424.86200", "N"),
)


@dataclass(frozen=True, slots=True)
class Dialect:
    """How the export is printed.

    Attributes
    ----------
    delimiter, decimal, thousands : str
        ``thousands`` is empty for none; it is printed inside quotes only.
    quoted : bool
        Every data cell in quotes.
    encoding : str
        Codec of the bytes; ``utf-8-sig`` writes a byte-order mark.
    names : tuple of str
        Column names of time, displacement and force.
    header, units_row : bool
        Whether there is a header, and a row of units.
    newline : str
    description : str
        One line for the help.
    language : str
        Of the header's keys and the results, where that is not English.
    groups : bool
        Whether header keys carry their group: ``"Test : Rate 1"``.
    header_lines : int
        Filled up to this number of lines.
    vertical : bool
        Header keys, values and units each on a line of their own, and results one a line.
    units : tuple of str
        As printed in the units row, or in the names where there is no such row.
    unit_in_names : bool
    order : tuple of int
        Position of time, displacement and force among the three.
    columns : tuple of (str, str, str)
        Further columns, as name, unit and the cell of every row; text makes a comment column.
    results : str
        ``""``, ``"before"`` or ``"after"``: where a table of results stands.
    wrapped : bool
        Whole lines quoted, as a spreadsheet does.
    lead, end : str
        Before the first line and after the last.
    """

    delimiter: str = ","
    decimal: str = "."
    thousands: str = ""
    quoted: bool = False
    encoding: str = "ascii"
    names: tuple[str, str, str] = ENGLISH
    header: bool = True
    units_row: bool = True
    newline: str = "\r\n"
    description: str = ""
    language: str = "en"
    groups: bool = True
    header_lines: int = 0
    vertical: bool = False
    units: tuple[str, str, str] = ("(sec)", "(mm)", "(N)")
    unit_in_names: bool = False
    order: tuple[int, int, int] = (0, 1, 2)
    columns: tuple[tuple[str, str, str], ...] = ()
    results: str = ""
    wrapped: bool = False
    lead: str = ""
    end: str = ""


def _spoken(language: str, **how: object) -> Dialect:
    """A dialect of another language than English."""
    return Dialect(language=language, names=LANGUAGES[language].names, **how)  # type: ignore[arg-type]


_COMMA = {"delimiter": ";", "decimal": ","}
_COUNTERS = (("Segment ID", "", "22476"), ("Total Cycle Count", "", "0"))
_COMMENT = (("Comment", "(text)", "no remark"),)

#: Dialects by name.
DIALECTS: Mapping[str, Dialect] = MappingProxyType(
    {
        "bare": Dialect(description="commas, bare cells: the default of the export"),
        "headless": Dialect(header=False, newline="\n", description="no header, LF"),
        "quoted": Dialect(thousands=",", quoted=True, description="quoted cells with thousands separators"),
        "semicolon": Dialect(**_COMMA, encoding="utf-8", description="semicolons and decimal commas"),
        "semicolon-quoted": Dialect(
            **_COMMA,
            thousands="\u00a0",
            quoted=True,
            encoding="utf-8",
            description="decimal commas in quotes, no-break spaces between thousands",
        ),
        "german-latin-1": Dialect(
            **_COMMA, encoding="latin-1", names=LANGUAGES["de"].names, description="German columns, latin-1"
        ),
        "french-latin-1": Dialect(
            **_COMMA,
            quoted=True,
            encoding="latin-1",
            names=LANGUAGES["fr"].names,
            description="French columns, quoted, latin-1",
        ),
        "spanish-bom": Dialect(
            encoding="utf-8-sig",
            names=LANGUAGES["es"].names,
            description="Spanish columns, UTF-8 with a mark",
        ),
        "polish-cp1250": Dialect(
            **_COMMA, encoding="cp1250", names=LANGUAGES["pl"].names, description="Polish columns, cp1250"
        ),
        "utf-16": Dialect(encoding="utf-16", description="UTF-16 with a byte order mark"),
        "utf-16-be": Dialect(encoding="utf-16-be", description="UTF-16, big end first, without a mark"),
        "tab": Dialect(delimiter="\t", description="tabs"),
        "tab-utf-16": Dialect(
            delimiter="\t", encoding="utf-16-le", description="tabs, UTF-16 without a mark"
        ),
        "vertical": Dialect(
            vertical=True, results="after", description="keys, values and results below each other"
        ),
        "vertical-before": Dialect(
            vertical=True, results="before", groups=False, description="vertical, results before the samples"
        ),
        "results-before": Dialect(results="before", description="a table of results before the samples"),
        "results-after": Dialect(results="after", description="a table of results after the samples"),
        "results-quoted": Dialect(
            **_COMMA,
            quoted=True,
            thousands=".",
            results="after",
            encoding="utf-8",
            description="quoted, points between thousands, results after the samples",
        ),  # fmt: skip
        "wrapped": Dialect(
            quoted=True, thousands=",", wrapped=True, description="whole lines quoted by a spreadsheet"
        ),
        "unit-in-names": Dialect(
            unit_in_names=True,
            units_row=False,
            units=("s", "mm", "N"),
            description="units in the names, no row",
        ),
        "no-units": Dialect(units_row=False, description="no unit anywhere: mm, N and s by default"),
        "cr-only": Dialect(newline="\r", description="lines ended by CR alone"),
        "crcrlf": Dialect(end="\r\r\n", lead="\r\n", description="an empty first line and a last CR CR LF"),
        "counters": Dialect(columns=_COUNTERS, description="counters without unit"),
        "comments": Dialect(columns=_COMMENT + _COUNTERS, description="a column of text"),
        "load-first": Dialect(order=(0, 2, 1), description="Load before Extension"),
        "long-header": Dialect(header_lines=48, description="48 header lines"),
        "ungrouped": Dialect(header_lines=12, groups=False, description="header keys without their group"),
        "swiss": Dialect(
            delimiter=";", thousands="'", quoted=True, description="apostrophes between thousands"
        ),
        "german": _spoken(
            "de", **_COMMA, encoding="latin-1", results="after", description="German throughout"
        ),
        "french": _spoken(
            "fr", **_COMMA, encoding="latin-1", results="after", description="French throughout"
        ),
        "spanish": _spoken(
            "es", **_COMMA, encoding="utf-8", results="after", description="Spanish throughout"
        ),
        "portuguese": _spoken(
            "pt", **_COMMA, encoding="latin-1", results="before", description="Portuguese throughout"
        ),
        "italian": _spoken(
            "it", **_COMMA, encoding="latin-1", results="after", description="Italian throughout"
        ),
        "polish": _spoken(
            "pl", **_COMMA, encoding="cp1250", results="before", description="Polish throughout"
        ),
        "chinese-gbk": _spoken("zh", encoding="gbk", results="after", description="Chinese throughout, GBK"),
        "chinese": _spoken(
            "zh", encoding="utf-8-sig", results="before", description="Chinese throughout, UTF-8"
        ),
    }
)


def bluehill_csv(log: SyntheticLog, *, dialect: Dialect, decimals: tuple[int, int, int] = (5, 5, 5)) -> bytes:
    """The bytes of one export.

    Parameters
    ----------
    log : SyntheticLog
    dialect : Dialect
    decimals : tuple of int
        Printed decimals of time, displacement and force.
    """
    lines = _header(log, dialect) if dialect.header else []
    if dialect.results == "before":
        lines += [*_results(log, dialect), ""]
    lines += _table(log, dialect, decimals)
    if dialect.results == "after":
        lines += ["", *_results(log, dialect)]
    if dialect.wrapped:
        lines = ['"' + line.replace('"', '""') + '"' if line else line for line in lines]
    text = dialect.lead + dialect.newline.join([*lines, ""]) + dialect.end
    return text.encode(dialect.encoding)


def _header(log: SyntheticLog, dialect: Dialect) -> list[str]:
    """The header entries and the empty line after them."""
    words = LANGUAGES[dialect.language]
    entries = [(words.label, log.specimen, ""), (words.note, "synthetic data", "")]
    if log.truth["speed_mm_s"] > 0.0:
        rate = _number(60.0 * log.truth["speed_mm_s"], 5, dialect)
        entries.append((words.rate, rate, "mm/min"))
    if dialect.language != "en":
        entries.append((words.depth, _number(log.truth["depth_mm"], 5, dialect), "mm"))
        entries.append((words.hold, _number(log.truth["hold_s"], 5, dialect), "s"))
    while len(entries) < dialect.header_lines:
        entries.append(_FILLER[len(entries) % len(_FILLER)])
    lines = []
    for key, value, unit in entries:
        printed = key if dialect.groups else key.split(" : ")[-1]
        cells = [printed, f'"{value}"', unit] if unit else [printed, f'"{value}"']
        lines += cells if dialect.vertical else [dialect.delimiter.join(cells)]
    return [*lines, ""]


def _table(log: SyntheticLog, dialect: Dialect, decimals: tuple[int, int, int]) -> list[str]:
    """Names, units and rows of the samples."""
    names = [
        f"{name} ({unit})" if dialect.unit_in_names else name
        for name, unit in zip(dialect.names, dialect.units, strict=True)
    ]
    join = dialect.delimiter.join
    order = dialect.order
    lines = [join([*(names[k] for k in order), *(name for name, _, _ in dialect.columns)])]
    if dialect.units_row:
        lines.append(join([*(dialect.units[k] for k in order), *(unit for _, unit, _ in dialect.columns)]))
    rows = zip(log.time_s.tolist(), log.displacement_mm.tolist(), log.force_N.tolist(), strict=True)
    plain = not dialect.quoted and dialect.decimal == "." and order == (0, 1, 2) and not dialect.columns
    if plain:
        row_format = join(f"%.{places}f" for places in decimals)
        return lines + [row_format % row for row in rows]
    further = [f'"{cell}"' if dialect.quoted else cell for _, _, cell in dialect.columns]
    for row in rows:
        cells = [_cell(value, places, dialect) for value, places in zip(row, decimals, strict=True)]
        lines.append(join([*(cells[k] for k in order), *further]))
    return lines


def _results(log: SyntheticLog, dialect: Dialect) -> list[str]:
    """A table of results: three specimens, mean and standard deviation; made up, and no samples."""
    words = LANGUAGES[dialect.language]
    peak = float(abs(log.force_N).max())
    peaks = (peak, 0.75 * peak, 1.25 * peak)
    mean = (peak, 0.25 * peak)
    if dialect.vertical:
        values = [_cell(value, 5, dialect) for value in (*peaks, *mean)]
        pairs = zip(("1", "2", "3", *words.statistics), values, strict=True)
        return [words.results, words.peak, "(N)", *(dialect.delimiter.join(pair) for pair in pairs)]
    travel = f"{words.names[1]} - {words.peak}"
    lines = [
        words.results,
        dialect.delimiter.join(("", words.peak, travel)),
        dialect.delimiter.join(("", "(N)", "(mm)")),
    ]
    for label, value in zip(("1", "2", "3", *words.statistics), (*peaks, *mean), strict=True):
        cells = (label, _cell(value, 5, dialect), _cell(value / 100.0, 5, dialect))
        lines.append(dialect.delimiter.join(cells))
    return lines


def _cell(value: float, places: int, dialect: Dialect) -> str:
    text = _number(value, places, dialect)
    return f'"{text}"' if dialect.quoted else text


def _number(value: float, places: int, dialect: Dialect) -> str:
    """A number with fixed decimals and the dialect's marks."""
    text = f"{value:,.{places}f}" if dialect.thousands and dialect.quoted else f"{value:.{places}f}"
    return text.replace(",", "\0").replace(".", dialect.decimal).replace("\0", dialect.thousands)
