"""Write a log as a Bluehill raw-data CSV; knows nothing of the reader that will meet it.

::

    Text Inputs : Specimen label,"paper-a"

    Time,Extension,Load
    (sec),(mm),(N)
    0.00000,0.00000,-0.31415

What the locales and versions of the export change is a :class:`Dialect`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from tissueid.synth.simulate import SyntheticLog

__all__ = ["DIALECTS", "Dialect", "bluehill_csv"]

ENGLISH = ("Time", "Extension", "Load")


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


#: Dialects by name.
DIALECTS: Mapping[str, Dialect] = MappingProxyType(
    {
        "bare": Dialect(),
        "headless": Dialect(header=False, newline="\n"),
        "quoted": Dialect(thousands=",", quoted=True),
        "semicolon": Dialect(delimiter=";", decimal=",", encoding="utf-8"),
        "semicolon-quoted": Dialect(
            delimiter=";", decimal=",", thousands="\u00a0", quoted=True, encoding="utf-8"
        ),
        "german-latin-1": Dialect(
            delimiter=";", decimal=",", encoding="latin-1", names=("Zeit", "Traversenweg", "Last")
        ),
        "french-latin-1": Dialect(
            delimiter=";",
            decimal=",",
            quoted=True,
            encoding="latin-1",
            names=("Temps", "Déplacement", "Charge"),
        ),
        "spanish-bom": Dialect(encoding="utf-8-sig", names=("Tiempo", "Extensión", "Carga")),
        "polish-cp1250": Dialect(
            delimiter=";", decimal=",", encoding="cp1250", names=("Godzina", "Przemieszczenie", "Obciążenie")
        ),
        "utf-16": Dialect(encoding="utf-16"),
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
    lines.append(dialect.delimiter.join(dialect.names))
    if dialect.units_row:
        lines.append(dialect.delimiter.join(("(sec)", "(mm)", "(N)")))
    rows = zip(log.time_s.tolist(), log.displacement_mm.tolist(), log.force_N.tolist(), strict=True)
    if dialect.quoted or dialect.decimal != ".":
        lines += [
            dialect.delimiter.join(
                _cell(value, places, dialect) for value, places in zip(row, decimals, strict=True)
            )
            for row in rows
        ]
    else:
        row_format = dialect.delimiter.join(f"%.{places}f" for places in decimals)
        lines += [row_format % row for row in rows]
    lines.append("")
    return dialect.newline.join(lines).encode(dialect.encoding)


def _header(log: SyntheticLog, dialect: Dialect) -> list[str]:
    """The header entries and the empty line after them."""
    entries = [
        ("Text Inputs : Specimen label", log.specimen, ""),
        ("General : Sample note", "synthetic data", ""),
    ]
    if log.truth["speed_mm_s"] > 0.0:
        rate = _number(60.0 * log.truth["speed_mm_s"], 5, dialect)
        entries.append(("Test : Rate 1", rate, "mm/min"))
    lines = []
    for key, value, unit in entries:
        cells = [key, f'"{value}"', unit] if unit else [key, f'"{value}"']
        lines.append(dialect.delimiter.join(cells))
    return [*lines, ""]


def _cell(value: float, places: int, dialect: Dialect) -> str:
    text = _number(value, places, dialect)
    return f'"{text}"' if dialect.quoted else text


def _number(value: float, places: int, dialect: Dialect) -> str:
    """A number with fixed decimals and the dialect's marks."""
    text = f"{value:,.{places}f}" if dialect.thousands and dialect.quoted else f"{value:.{places}f}"
    return text.replace(",", "\0").replace(".", dialect.decimal).replace("\0", dialect.thousands)
