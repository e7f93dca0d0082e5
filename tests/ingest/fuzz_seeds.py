"""Small exports in many dialects, the ground of the fuzz: text, and where its table stands.

Bluehill files come from the synthetic writer; testXpert's text and the tables with more columns from a
plain writer here, which knows nothing of any reader.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from tissueid.synth import Dialect, SyntheticLog, bluehill_csv, recipe, simulate

#: What one printed unit is in s, mm or N; written down here, by definition of each unit.
FACTORS = {
    "s": 1.0, "sec": 1.0, "ms": 1e-3, "min": 60.0,
    "mm": 1.0, "um": 1e-3, "m": 1e3, "cm": 10.0, "in": 25.4,
    "N": 1.0, "kN": 1e3, "mN": 1e-3, "kgf": 9.80665, "gf": 9.80665e-3, "lbf": 0.45359237 * 9.80665,
}  # fmt: skip
#: The mark that is not the decimal one.
OTHER_MARK = {".": ",", ",": "."}
UNITS_OF = {0: ("s", "sec", "ms", "min"), 1: ("mm", "um", "m", "cm", "in"), 2: ("N", "kN", "mN", "gf", "lbf")}


@dataclass(frozen=True)
class Intent:
    """The meaning of a file: all that its reading depends on.

    ``channels`` are the columns of time, displacement and force, ``units`` their printed units,
    ``words`` the columns whose cells may hold anything.
    """

    encoding: str = "ascii"
    delimiter: str = ","
    decimal: str = "."
    thousands: str = ""
    n_columns: int = 3
    channels: tuple[int, int, int] = (0, 1, 2)
    units: tuple[str, str, str] = ("sec", "mm", "N")
    words: frozenset[int] = frozenset()


def split_cells(line: str, delimiter: str) -> list[str]:
    """Cells with their quotes, cut at delimiters outside quotes."""
    cells, start, inside = [], 0, False
    for at, letter in enumerate(line):
        if letter == '"':
            inside = not inside
        elif letter == delimiter and not inside:
            cells.append(line[start:at])
            start = at + 1
    return [*cells, line[start:]]


@dataclass(frozen=True)
class Seed:
    """One sound file: lines without their ends, and which of them are names, units and first row."""

    name: str
    lines: tuple[str, ...]
    names: int
    units: int | None
    first: int
    intent: Intent
    newline: str = "\r\n"
    quoted: bool = False
    suffix: str = ".csv"

    @property
    def text(self) -> str:
        return self.newline.join((*self.lines, ""))

    @property
    def data(self) -> bytes:
        return self.text.encode(self.intent.encoding)

    def with_cells(self, rows: Iterable[int], change: Callable[[list[str]], Iterable[str]]) -> list[str]:
        lines, delimiter = list(self.lines), self.intent.delimiter
        for at in rows:
            lines[at] = delimiter.join(change(split_cells(lines[at], delimiter)))
        return lines

    def with_cell(self, at: int, column: int, change: Callable[[str], str]) -> list[str]:
        return self.with_cells(
            [at], lambda cells: [change(c) if k == column else c for k, c in enumerate(cells)]
        )

    @property
    def unit_line(self) -> int:
        """The row of units, or the names that have them."""
        return self.names if self.units is None else self.units


@cache
def _logs() -> tuple[SyntheticLog, SyntheticLog]:
    """A ramp and hold in compression, time past a thousand seconds, and one that pulls negative."""
    log = simulate(recipe("paper-a-hold-100Hz"), rng=np.random.default_rng(3))[0]
    pick = np.r_[0:200:3, 200:1200:12]
    common = {"force_clean_N": log.force_clean_N[pick], "truth": dict(log.truth)}
    time, travel, force = log.time_s[pick], log.displacement_mm[pick], log.force_N[pick]
    late = SyntheticLog("late", "22L.3", time + 995.0, travel, 12.0 * force, **common)
    negative = SyntheticLog("negative", "cow 7", time, -2.5 - travel, -force, **common)
    return late, negative


def _bluehill(name: str, dialect: Dialect, *, log: int, rows: int = 90, **intent: object) -> Seed:
    text = bluehill_csv(_logs()[log], dialect=dialect).decode(dialect.encoding)
    lines = text.split(dialect.newline)[:-1]
    names = lines.index(dialect.delimiter.join(dialect.names))
    units, first = names + 1 if dialect.units_row else None, names + 1 + dialect.units_row
    thousands = dialect.thousands if dialect.quoted else ""
    meant = Intent(dialect.encoding, dialect.delimiter, dialect.decimal, thousands, **intent)
    kept = tuple(lines[: first + rows])
    return Seed(name, kept, names, units, first, meant, dialect.newline, dialect.quoted)


def _table(
    name: str, head: list[str], names: list[str], units: list[str] | None,
    columns: list[Callable[[int], str]], intent: Intent, *, rows: int = 80, quoted_names: bool = False,
    suffix: str = ".csv", newline: str = "\r\n",
) -> Seed:  # fmt: skip
    def joined(cells: list[str]) -> str:
        return intent.delimiter.join(f'"{cell}"' if quoted_names else cell for cell in cells)

    top = [*head, joined(names), *([joined(units)] if units is not None else [])]
    body = [intent.delimiter.join(column(i) for column in columns) for i in range(rows)]
    unit_row = len(head) + 1 if units is not None else None
    return Seed(name, (*top, *body), len(head), unit_row, len(top), intent, newline, suffix=suffix)


def _general(value: float) -> str:
    """As testXpert prints: six significant digits, exponents of three."""
    text = f"{value:.6g}"
    if "e" in text:
        mantissa, _, power = text.partition("e")
        text = f"{mantissa}e{power[0]}{int(power[1:]):03d}"
    return text


def _tables() -> list[Seed]:
    late, negative = _logs()
    t, x, f = (a.tolist() for a in (negative.time_s, negative.displacement_mm, negative.force_N))
    big = (12.0 * late.force_N).tolist()
    tra_head = ['"Prüfername","A. B."', '"Specimen thickness",1.5,"mm"', '"v1",1,"mm/min"', ""]
    full = Intent(n_columns=6, channels=(0, 3, 1), units=("s", "mm", "kN"), words=frozenset({5}))
    return [
        _table(
            "tra", tra_head, ["Time", "Standard travel", "Standard force"], ["s", "mm", "N"],
            [lambda i: _general(t[i]), lambda i: _general(-2.5 - x[i]), lambda i: _general(-f[i] / 3.0)],
            Intent("latin-1", units=("s", "mm", "N")), quoted_names=True, suffix=".TRA",
        ),
        _table(
            "many columns", ["Specimen label,kidney 4", ""],
            ["Time", "Load", "Cycle Count", "Extension", "Compressive extension", "Comment"],
            ["(s)", "(kN)", "", "(mm)", "(mm)", ""],
            [
                lambda i: f"{t[i]:.3f}", lambda i: f"{f[i] / 1000.0:.6f}", lambda i: str(i // 9),
                lambda i: f"{x[i]:.4f}", lambda i: f"{-x[i]:.4f}", lambda i: "note" if i == 7 else "",
            ],
            full,
        ),
        _table(
            "two decimals", ["Specimen ID,7", ""], ["Time", "Displacement", "Force"], ["s", "mm", "N"],
            [lambda i: f"{t[i]:.2f}", lambda i: f"{x[i]:.2f}", lambda i: f"{f[i]:.2f}"],
            Intent(units=("s", "mm", "N")), newline="\n",
        ),
        _table(
            "small units", [], ["Time (ms)", "Indentation (um)", "Force (mN)"], None,
            [
                lambda i: f"{1000 * t[i]:.2f}", lambda i: f"{-1000 * x[i] + i % 7 / 10:.1f}",
                lambda i: f"{-1000 * f[i]:.3f}",
            ],
            Intent(delimiter="\t", units=("ms", "um", "mN")), newline="\n", suffix=".txt",
        ),
        _table(
            "forces past a thousand", ["General : Note;x", ""], ["Zeit", "Weg", "Kraft"],
            ["(s)", "(mm)", "(N)"],
            [
                lambda i: f"{t[i]:.3f}".replace(".", ","),
                lambda i: f"{-x[i]:.3f}".replace(".", ","),
                lambda i: f"{big[i]:,.3f}".translate(str.maketrans(",.", ".,")),
            ],
            Intent("utf-8", ";", ",", ".", units=("s", "mm", "N")),
        ),
    ]  # fmt: skip


@cache
def seeds() -> tuple[Seed, ...]:
    """All seeds; each is read by the reader before it is spoilt."""
    semicolon = partial(Dialect, delimiter=";", decimal=",")
    spaced = semicolon(thousands="\u00a0", quoted=True, encoding="utf-8")
    german = semicolon(encoding="latin-1", names=("Zeit", "Traversenweg", "Prüfkraft"))
    polish = semicolon(encoding="cp1250", names=("Czas", "Przemieszczenie", "Obciążenie"))
    spanish = Dialect(encoding="utf-8-sig", names=("Tiempo", "Extensión", "Carga"), quoted=True)
    in_names = ("Time (s)", "Extension (mm)", "Load (N)")
    headless = Dialect(names=in_names, units_row=False, header=False, newline="\n")
    return (
        _bluehill("comma bare", Dialect(), log=1),
        _bluehill("comma quoted thousands", Dialect(quoted=True, thousands=","), log=0),
        _bluehill("semicolon comma", semicolon(encoding="utf-8"), log=0),
        _bluehill("semicolon quoted no-break space", spaced, log=0),
        _bluehill("tab, CR LF, long", Dialect(delimiter="\t"), log=0, rows=148),
        _bluehill("UTF-16", Dialect(encoding="utf-16", delimiter="\t"), log=1, rows=60),
        _bluehill("units in names, LF", headless, log=1, units=("s", "mm", "N")),
        _bluehill("German latin-1", german, log=1),
        _bluehill("Polish cp1250", polish, log=1),
        _bluehill("Spanish BOM", spanish, log=1),
        *_tables(),
    )
