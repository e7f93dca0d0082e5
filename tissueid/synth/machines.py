"""Logs as other machines print them: testXpert, Mach-1, MTS 793, Shimadzu, Optics11 Chiaro, and workbooks.

Each knows the grammar of its format and nothing of the reader.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable, Iterator, Sequence

from tissueid.store.xlsx import Cell, Sheet, xlsx_bytes
from tissueid.synth.simulate import SyntheticLog

Decimals = tuple[int, int, int]

#: Standard gravity on a gram [N].
GRAM_FORCE_N = 9.80665e-3
_TRA_WORDS = {
    "en": (
        ("Specimen thickness", "Operator"),
        ("Time", "Crosshead absolute", "Standard force", "Standard travel"),
    ),
    "fr": (
        ("Epaisseur éprouvette", "Opérateur"),
        ("Temps", "Traverse absolue", "Force standard", "Course standard"),
    ),
    "de": (("Probendicke", "Prüfer"), ("Prüfzeit", "Traversenweg absolut", "Standardkraft", "Standardweg")),
}
_MTS_WORDS = {
    "en": ("ENU|1|2|.|/", "Operator Information", "Specimen Name", "Data Acquisition: Timed", "Time:", "Sec"),
    "de": ("DEU|1|2|,|.", "Bediener Information", "Probenbezeichnung", "Datenerfassung", "Zeit:", "s"),
}
_MTS_NAMES = {
    "en": (("Axial Force Command", "N"), ("Axial Force", "N"), ("Axial Displacement", "mm"), ("Time", "Sec")),
    "de": (("Ch 1 Kraft Sollwert", "kN"), ("Ch 1 Kraft", "kN"), ("Ch 1 Weg", "mm"), ("Laufzeit", "s")),
}


def _rows(log: SyntheticLog) -> Iterator[tuple[float, float, float]]:
    return zip(log.time_s.tolist(), log.displacement_mm.tolist(), log.force_N.tolist(), strict=True)


def _short(value: float, places: int) -> str:
    """As testXpert prints: no zeros at the end, small numbers with an exponent of three digits."""
    rounded = round(value, places)
    if rounded == int(rounded):
        return str(int(rounded))
    text = repr(rounded)
    if "e-" in text:
        mantissa, _, power = text.partition("e-")
        return f"{mantissa}e-{int(power):03d}"
    return text


def tra_text(
    log: SyntheticLog,
    *,
    language: str,
    delimiter: str = ",",
    decimal: str = ".",
    decimals: Decimals = (5, 5, 5),
) -> bytes:
    """A testXpert ``.TRA``: ``"key",value,"unit"`` lines, quoted names and units, shortest numbers."""
    (thickness, operator), names = _TRA_WORDS[language]

    def number(value: float, places: int) -> str:
        return _short(value, places).replace(".", decimal)

    speed = number(60.0 * log.truth["speed_mm_s"], 5)
    head = [
        (f'"{thickness}"', number(12.5, 5), '"mm"'),
        (f'"{operator}"', '"synthetic"'),
        ('"v1"', speed, '"mm/min"'),
        tuple(f'"{name}"' for name in names),
        tuple(f'"{unit}"' for unit in ("s", "mm", "N", "mm")),
    ]
    rows = [
        (number(t, decimals[0]), number(x - 755.0, 3), number(f, decimals[2]), number(x, decimals[1]))
        for t, x, f in _rows(log)
    ]
    return "".join(delimiter.join(cells) + "\r\n" for cells in [*head, *rows]).encode("latin-1")


def mach1_text(
    logs: Sequence[SyntheticLog], *, decimals: Decimals = (5, 5, 5), divided: bool = True
) -> bytes:
    """A Mach-1 text: a block without force, then one block a log, tabs, force in gf."""
    lines = ["<Mach-1 File>"]
    lines += _mach1_block(
        "Find Contact", ("Contact criteria, gf:\t1.000",), ["Time, s\tPosition (z), mm", "0.0\t0.0"]
    )
    for log in logs:
        head = (
            f"Ramp velocity, mm/s:\t{log.truth['speed_mm_s']:.5f}",
            f"Ramp amplitude, mm:\t{log.truth['depth_mm']:.5f}",
            f"Fixed relaxation time, s:\t{log.truth['hold_s']:.5f}",
        )
        rows = [
            f"{t:.{decimals[0]}f}\t0.00000\t{x:.{decimals[1]}f}\t{f / GRAM_FORCE_N:.{decimals[2]}f}"
            for t, x, f in _rows(log)
        ]
        if divided:
            rows.insert(len(rows) // 2, "<divider>")
        names = "Time, s\tPosition (x), mm\tPosition (z), mm\tFz, gf"
        lines += _mach1_block("Stress Relaxation", head, [names, *rows])
    return "".join(line + "\r\n" for line in lines).encode("ascii")


def _mach1_block(command: str, head: Sequence[str], table: Sequence[str]) -> list[str]:
    return [
        "<INFO>",
        "Date:\tMonday, 1 January 2024",
        "Remark:\tsynthetic data",
        "<END INFO>",
        f"<{command}>",
        *head,
        "<DATA>",
        *table,
        "<END DATA>",
    ]


def mts793_text(
    logs: Sequence[SyntheticLog], *, language: str = "en", decimals: Decimals = (5, 5, 5)
) -> bytes:
    """An MTS 793 text: the first line states the marks, one block a log, a commanded channel first."""
    marks, operator, label, acquired, clock, second = _MTS_WORDS[language]
    decimal = marks.split("|")[3]
    kilo = 1e3 if language == "de" else 1.0
    places = decimals[2] + (3 if language == "de" else 0)
    lines = [
        f"MTS793|BTW|{marks}|:|1|0|0|A",
        "",
        operator,
        f"{label}\t{logs[0].specimen}",
        "Remark\tsynthetic data",
    ]
    for log in logs:
        title = f"{acquired}\t\t\t\t{clock}\t{log.time_s[-1]:.3f}\t{second}\t1/2/2020 10:00:00 AM"
        names = _MTS_NAMES[language]
        lines += [
            "",
            title.replace(".", decimal),
            "\t".join(n for n, _ in names),
            "\t".join(u for _, u in names),
        ]
        for t, x, f in _rows(log):
            row = f"0.0\t{f / kilo:.{places}f}\t{x:.{decimals[1]}f}\t{t:.{decimals[0]}f}"
            lines.append(row.replace(".", decimal))
    return "".join(line + "\r\n" for line in lines).encode("latin-1")


def shimadzu_text(logs: Sequence[SyntheticLog], *, decimals: Decimals = (5, 5, 5)) -> bytes:
    """A Shimadzu text: specimen names, columns and units above, specimens side by side, ragged ends."""
    head = (
        [cell for log in logs for cell in (f"synthetic {log.name}", "", "")],
        ["Time", "Force", "Stroke"] * len(logs),
        ["sec", "N", "mm"] * len(logs),
    )
    columns = [
        [(f"{t:.{decimals[0]}f}", f"{f:.{decimals[2]}f}", f"{x:.{decimals[1]}f}") for t, x, f in _rows(log)]
        for log in logs
    ]
    longest = max(map(len, columns))
    rows = [
        [cell for rows in columns for cell in (rows[i] if i < len(rows) else ("",) * 3)]
        for i in range(longest)
    ]
    return "".join(",".join(f'"{cell}"' for cell in row) + "\r\n" for row in [*head, *rows]).encode("ascii")


def chiaro_text(log: SyntheticLog, *, decimals: Decimals = (5, 5, 5)) -> bytes:
    """An Optics11 Chiaro text: tabs, line ends of three kinds, micro sign of cp1252, uN and nm."""
    head = (
        "Date\t01/01/2024\tTime\t10:00:00\tStatus\tsynthetic\r\n"
        "Scan (#)\t1\tX (#)\t1\tIndentation (#)\t1\n\r"
        "Tip radius (um)\t27.500\r\nk (N/m)\t0.019\r\nSMDuration (s) 0.000\r\n\r\n"
        f"Piezo speed  (µm/s)\t{1e3 * log.truth['speed_mm_s']:.3f}\n\nModel: Hertz\n"
        "Comment: \r\n\r\n"
    )
    names = "Time (s)\tLoad (uN)\tIndentation (nm)\tCantilever (nm)\tPiezo (nm)\tAuxiliary\r\n"
    further = "\t-1.5\t64.9\t0.1\r\n"
    lines = [
        f"{t:.{decimals[0]}f}\t{1e6 * f:.{decimals[2] + 1}f}\t{1e6 * x:.{decimals[1] + 1}f}{further}"
        for t, x, f in _rows(log)
    ]
    return (head + names + "".join(lines)).encode("cp1252")


def chiaro_zip(log: SyntheticLog, *, decimals: Decimals = (5, 5, 5)) -> bytes:
    """The same in a zip archive, beside a note; the same log gives the same bytes."""
    parts = {
        "synthetic Indentation_001.txt": chiaro_text(log, decimals=decimals),
        "position.txt": b"synthetic: no table\n",
    }
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in parts.items():
            archive.writestr(zipfile.ZipInfo(name, (2024, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


_WORDS = {
    "en": ("Test time", "Standard force", "Standard travel", "Grip to grip separation", "Results"),
    "fr": ("Temps d'essai", "Force standard", "Allongement", "Ecartement entre outils", "Résultats"),
    "de": ("Prüfzeit", "Standardkraft", "Standardweg", "Werkzeugabstand", "Ergebnisse"),
}


def xlsx(sheets: Iterable[tuple[str, Sequence[Sequence[Cell]]]]) -> bytes:
    """A workbook of sheets whose first row is of texts; the same sheets give the same bytes."""
    return xlsx_bytes([Sheet(name, tuple(map(str, head)), rows) for name, (head, *rows) in sheets])


def _rounded(log: SyntheticLog, decimals: Decimals) -> list[tuple[float, float, float]]:
    channels = (log.time_s, log.displacement_mm, log.force_N)
    columns = [
        [round(value, places) for value in channel.tolist()]
        for channel, places in zip(channels, decimals, strict=True)
    ]
    return list(zip(*columns, strict=True))


def zwick_workbook(
    logs: Sequence[SyntheticLog], *, language: str = "en", decimals: Decimals = (5, 5, 5)
) -> bytes:
    """A testXpert workbook: a sheet of results, then one sheet a log under three head rows."""
    time, force, travel, gap, results = _WORDS[language]
    sheets: list[tuple[str, Sequence[Sequence[Cell]]]] = [
        (
            results,
            [["", "Fmax", "dL"], ["", "N", "mm"], ["synthetic 1", 12.5, 3.1], ["synthetic 2", 13.5, 3.4]],
        )
    ]
    for log in logs:
        head: list[Sequence[Cell]] = [
            [f"synthetic {log.name}"] * 4,
            [time, force, travel, gap],
            ["s", "N", "mm", "mm"],
        ]
        rows: list[Sequence[Cell]] = [(t, f, x, round(20.0 - x, 5)) for t, x, f in _rounded(log, decimals)]
        sheets.append((f"synthetic {log.name}", head + rows))
    return xlsx(sheets)


def bluehill_workbook(logs: Sequence[SyntheticLog], *, decimals: Decimals = (5, 5, 5)) -> bytes:
    """Bluehill's table as a workbook: header, names, units, a half-cycle counter, results below."""
    sheets: list[tuple[str, Sequence[Sequence[Cell]]]] = []
    for log in logs:
        rows = _rounded(log, decimals)
        sheet: list[Sequence[Cell]] = [
            ["Text Inputs : Specimen label", log.specimen],
            ["General : Sample note", "synthetic data"],
            ["Test : Rate 1", round(60.0 * log.truth["speed_mm_s"], 5), "mm/min"],
            [],
            ["Time", "Extension", "Load", "Cycle Count"],
            ["(sec)", "(mm)", "(N)", ""],
            *((*row, 0.5 * (2 * i // max(1, len(rows)))) for i, row in enumerate(rows)),
            [],
            ["Results Table 1"],
            ["", "Maximum Load", "Extension"],
            ["", "(N)", "(mm)"],
            ["1", 12.5, 3.1],
            ["Mean", 12.5, 3.1],
            ["Standard deviation", 0.5, 0.1],
        ]
        sheets.append((f"synthetic {log.name}", sheet))
    return xlsx(sheets)
