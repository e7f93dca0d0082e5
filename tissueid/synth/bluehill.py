"""Bluehill's raw-data CSV: its dialects (locales, versions, options), and the bytes of a log in each.

Words are written down apart from the reader's vocabulary, so that the two can be held against each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from tissueid.synth.simulate import SyntheticLog


@dataclass(frozen=True, slots=True)
class Words:
    """Names that one language gives the parts of an export."""

    names: tuple[str, str, str]  # columns of time, displacement and force
    #: Header keys, with their group before ``" : "``.
    label: str
    note: str
    rate: str
    depth: str
    hold: str
    results: str  # title of a table of results
    peak: str  # a result: the largest load
    statistics: tuple[str, str]  # row labels: mean and standard deviation


#: Language code -> words.
LANGUAGES: Mapping[str, Words] = MappingProxyType(
    {
        "en": Words(
            ("Time", "Extension", "Load"), "Text Inputs : Specimen label", "General : Sample note",
            "Test : Rate 1", "Test : Indentation depth", "Test : Hold time", "Results Table 1",
            "Maximum Load", ("Mean", "Standard deviation"),
        ),
        "de": Words(
            ("Zeit", "Traversenweg", "Last"), "Texteingaben : Probenbezeichnung", "Allgemein : Bemerkung",
            "Prüfung : Geschwindigkeit 1", "Prüfung : Eindringtiefe", "Prüfung : Haltezeit",
            "Ergebnistabelle 1", "Maximale Last", ("Mittelwert", "Standardabweichung"),
        ),
        "fr": Words(
            ("Temps", "Déplacement", "Charge"), "Saisies de texte : Libellé de l'éprouvette",
            "Général : Remarque", "Essai : Vitesse 1", "Essai : Profondeur d'indentation",
            "Essai : Temps de maintien", "Tableau de résultats 1", "Charge maximale",
            ("Moyenne", "Écart type"),
        ),
        "es": Words(
            ("Tiempo", "Extensión", "Carga"), "Entradas de texto : Etiqueta de probeta",
            "General : Nota de muestra", "Ensayo : Velocidad 1", "Ensayo : Profundidad de indentación",
            "Ensayo : Tiempo de retención", "Tabla de resultados 1", "Carga máxima",
            ("Media", "Desviación estándar"),
        ),
        "pt": Words(
            ("Tempo", "Extensão", "Carga"), "Entradas de texto : Rótulo do corpo de prova",
            "Geral : Nota da amostra", "Ensaio : Velocidade 1", "Ensaio : Profundidade de indentação",
            "Ensaio : Tempo de retenção", "Tabela de resultados 1", "Carga máxima",
            ("Média", "Desvio padrão"),
        ),
        "it": Words(
            ("Tempo", "Estensione", "Carico"), "Immissioni di testo : Etichetta provino",
            "Generale : Nota del campione", "Prova : Velocità 1", "Prova : Profondità di indentazione",
            "Prova : Tempo di mantenimento", "Tabella risultati 1", "Carico massimo",
            ("Media", "Deviazione standard"),
        ),
        "pl": Words(
            ("Godzina", "Przemieszczenie", "Obciążenie"), "Pola tekstowe : Etykieta próbki",
            "Ogólne : Uwaga", "Badanie : Prędkość 1", "Badanie : Głębokość wgłębienia",
            "Badanie : Czas przetrzymania", "Tabela wyników 1", "Maksymalne obciążenie",
            ("Średnia", "Odchylenie standardowe"),
        ),
        "zh": Words(
            ("时间", "位移", "载荷"), "文本输入 : 试样标签", "常规 : 样品备注", "测试 : 速率 1",
            "测试 : 压入深度", "测试 : 保持时间", "结果表 1", "最大载荷", ("平均值", "标准偏差"),
        ),
        "ja": Words(
            ("時間", "変位", "荷重"), "テキスト入力 : 試験片ラベル", "一般 : 備考", "試験 : 試験速度 1",
            "試験 : 押込み深さ", "試験 : 保持時間", "結果表 1", "最大荷重", ("平均", "標準偏差"),
        ),
    }
)  # fmt: skip

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
    "swiss": ("apostrophes between thousands", Dialect(delimiter=";", thousands="'", quoted=True)),
    "german": ("German throughout", _spoken("de", replace(_LATIN, results="after"))),
    "french": ("French throughout", _spoken("fr", replace(_LATIN, results="after"))),
    "spanish": ("Spanish throughout", _spoken("es", replace(_COMMA, encoding="utf-8", results="after"))),
    "portuguese": ("Portuguese throughout", _spoken("pt", replace(_LATIN, results="before"))),
    "italian": ("Italian throughout", _spoken("it", replace(_LATIN, results="after"))),
    "polish": ("Polish throughout", _spoken("pl", replace(_COMMA, encoding="cp1250", results="before"))),
    "chinese-gbk": ("Chinese throughout, GBK", _spoken("zh", Dialect(encoding="gbk", results="after"))),
    "japanese": ("Japanese throughout, Shift-JIS", _spoken("ja", Dialect(encoding="cp932", results="after"))),
    "chinese": (
        "Chinese throughout, UTF-8 with a byte order mark",
        _spoken("zh", Dialect(encoding="utf-8-sig", results="before")),
    ),
}

#: Dialects by name.
DIALECTS: Mapping[str, Dialect] = MappingProxyType(
    {name: replace(how, description=text) for name, (text, how) in _DESCRIBED.items()}
)


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
    """The bytes of one export."""
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
        entries.append((words.rate, _number(60.0 * log.truth["speed_mm_s"], 5, dialect), "mm/min"))
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
