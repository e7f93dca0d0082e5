"""Logs as .xlsx workbooks, written part by part: no spreadsheet library, so none is trusted twice."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable, Sequence
from xml.sax.saxutils import escape

from tissueid.synth.simulate import SyntheticLog

Decimals = tuple[int, int, int]
Cell = float | str

_WORDS = {
    "en": ("Test time", "Standard force", "Standard travel", "Grip to grip separation", "Results"),
    "fr": ("Temps d'essai", "Force standard", "Allongement", "Ecartement entre outils", "Résultats"),
    "de": ("Prüfzeit", "Standardkraft", "Standardweg", "Werkzeugabstand", "Ergebnisse"),
}
_MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_RELATIONS = "http://schemas.openxmlformats.org/package/2006/relationships"
_OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_TYPES = "http://schemas.openxmlformats.org/package/2006/content-types"
_KIND = "application/vnd.openxmlformats-officedocument.spreadsheetml"
_XML = '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'


def _cell(value: Cell) -> str:
    if isinstance(value, str):
        return f'<c t="inlineStr"><is><t>{escape(value)}</t></is></c>' if value else "<c/>"
    return f"<c><v>{value!r}</v></c>"


def xlsx(sheets: Sequence[tuple[str, Iterable[Sequence[Cell]]]]) -> bytes:
    """A workbook; the same sheets give the same bytes.

    ``sheets``: a cell is a number or a text; the empty text is an empty cell.
    """
    numbers = range(1, len(sheets) + 1)
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{_TYPES}"><Default Extension="rels" '
        'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        f'<Override PartName="/xl/workbook.xml" ContentType="{_KIND}.sheet.main+xml"/>'
        + "".join(
            f'<Override PartName="/xl/worksheets/sheet{i}.xml" ContentType="{_KIND}.worksheet+xml"/>'
            for i in numbers
        )
        + "</Types>",
        "_rels/.rels": f'<Relationships xmlns="{_RELATIONS}"><Relationship Id="r1" '
        f'Type="{_OFFICE}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook xmlns="{_MAIN}" xmlns:r="{_OFFICE}"><sheets>'
        + "".join(
            f'<sheet name="{escape(name)}" sheetId="{i}" r:id="r{i}"/>'
            for i, (name, _) in zip(numbers, sheets, strict=True)
        )
        + "</sheets></workbook>",
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{_RELATIONS}">'
        + "".join(
            f'<Relationship Id="r{i}" Type="{_OFFICE}/worksheet" Target="worksheets/sheet{i}.xml"/>'
            for i in numbers
        )
        + "</Relationships>",
    }
    for i, (_, rows) in zip(numbers, sheets, strict=True):
        cells = "".join("<row>" + "".join(map(_cell, row)) + "</row>" for row in rows)
        parts[f"xl/worksheets/sheet{i}.xml"] = (
            f'<worksheet xmlns="{_MAIN}"><sheetData>{cells}</sheetData></worksheet>'
        )
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in parts.items():
            stamp = zipfile.ZipInfo(name, (2024, 1, 1, 0, 0, 0))
            archive.writestr(stamp, (_XML + text).encode(), zipfile.ZIP_DEFLATED)
    return packed.getvalue()


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
    """A testXpert workbook: a sheet of results, then one sheet a log under three head rows.

    ``language`` {"en", "fr", "de"}.
    """
    time, force, travel, gap, results = _WORDS[language]
    sheets: list[tuple[str, Iterable[Sequence[Cell]]]] = [
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
    sheets: list[tuple[str, Iterable[Sequence[Cell]]]] = []
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
