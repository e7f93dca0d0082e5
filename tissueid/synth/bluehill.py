"""Write a log as a Bluehill raw-data CSV; knows nothing of the reader that will meet it.

::

    Text Inputs : Specimen label,"paper-a"

    Time,Extension,Load
    (sec),(mm),(N)
    0.00000,0.00000,-0.31415

What the locales, versions and options of the export change is a :class:`Dialect`.
"""

from __future__ import annotations

from tissueid.synth.dialects import Dialect
from tissueid.synth.languages import LANGUAGES
from tissueid.synth.simulate import SyntheticLog

#: What fills a header up: results, GUIDs, nothing, a placeholder, keys with ellipses, a date.
_FILLER = (
    ("General : Operator", "<Ninguno>", ""),
    ("General : GUID", "{9F3C1C2A-5E0B-4A6E-9B9E-0123456789AB}", ""),
    ("Text Inputs : Comment", "", ""),
    ("Dimension : Thickness", "12.50000", "mm"),
    ("General : Start Date", "13/11/2018 5:14 PM", ""),
    ("Calculations : Maximum Load at ...", "1424.86200", "N"),
)


def bluehill_csv(log: SyntheticLog, *, dialect: Dialect, decimals: tuple[int, int, int] = (5, 5, 5)) -> bytes:
    """The bytes of one export.

    ``decimals``: printed decimals of time, displacement and force.
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
    head = (("", words.peak, travel), ("", "(N)", "(mm)"))
    lines = [words.results, *(dialect.delimiter.join(row) for row in head)]
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
