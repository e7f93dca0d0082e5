"""Tables as a workbook that spreadsheets open: the least of Office Open XML (ECMA-376), without a library.

Numbers stay numbers, text is text (never a formula), what is not known is an empty cell.  Equal tables give
equal bytes.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

from tissueid.errors import printable

Cell = str | float | bool | None

#: Longest name of a sheet, and signs that it must not have.
_NAME_LENGTH = 31
_NOT_IN_NAMES = re.compile(r"[\[\]:*?/\\']")
#: What XML can't hold and :func:`printable` leaves.
_NOT_IN_XML = re.compile("[\ufffe\uffff]")
#: Characters of a cell, rows of a sheet, width of a column [characters].
_CELL_LENGTH, _MOST_ROWS = 32_767, 1_048_576
_NARROWEST, _WIDEST = 8, 48
#: Members carry the earliest date that a zip archive can hold.
_DATE = (1980, 1, 1, 0, 0, 0)
_HEAD = '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'
_MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_LINKS = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_KIND = "application/vnd.openxmlformats-officedocument.spreadsheetml"
#: Two formats of a cell: plain, and the bold of a head.
_STYLES = (
    f'{_HEAD}<styleSheet xmlns="{_MAIN}"><fonts count="2"><font><sz val="11"/><name val="Calibri"/></font>'
    '<font><b/><sz val="11"/><name val="Calibri"/></font></fonts><fills count="2"><fill><patternFill '
    'patternType="none"/></fill><fill><patternFill patternType="gray125"/></fill></fills><borders count="1">'
    '<border><left/><right/><top/><bottom/><diagonal/></border></borders><cellStyleXfs count="1"><xf '
    'numFmtId="0" fontId="0" fillId="0" borderId="0"/></cellStyleXfs><cellXfs count="2"><xf numFmtId="0" '
    'fontId="0" fillId="0" borderId="0" xfId="0"/><xf numFmtId="0" fontId="1" fillId="0" borderId="0" '
    'xfId="0" applyFont="1"/></cellXfs><cellStyles count="1"><cellStyle name="Normal" xfId="0" '
    'builtinId="0"/></cellStyles></styleSheet>'
)


@dataclass(frozen=True, slots=True)
class Sheet:
    """One table of a workbook."""

    name: str  # cut to what a spreadsheet allows
    head: tuple[str, ...]
    rows: Sequence[Sequence[Cell]]  # ``None`` and what is not finite are empty cells


def xlsx_bytes(sheets: Sequence[Sheet]) -> bytes:
    """A workbook of these sheets, each with its head in bold and kept in sight.

    Raises ValueError: without a sheet, or of more rows than a sheet can hold.
    """
    if not sheets:
        raise ValueError("a workbook needs a sheet")
    names, numbers = _names([sheet.name for sheet in sheets]), range(1, len(sheets) + 1)
    listed = "".join(
        f'<sheet name="{escape(name)}" sheetId="{k}" r:id="rId{k}"/>' for k, name in enumerate(names, 1)
    )
    members = {
        "[Content_Types].xml": _content_types(numbers),
        "_rels/.rels": _relations([("rId1", "officeDocument", "xl/workbook.xml")]),
        "xl/workbook.xml": (
            f'{_HEAD}<workbook xmlns="{_MAIN}" xmlns:r="{_LINKS}"><sheets>{listed}</sheets></workbook>'
        ),
        "xl/_rels/workbook.xml.rels": _relations(
            [(f"rId{k}", "worksheet", f"worksheets/sheet{k}.xml") for k in numbers]
            + [(f"rId{len(names) + 1}", "styles", "styles.xml")]
        ),
        "xl/styles.xml": _STYLES,
        **{f"xl/worksheets/sheet{k}.xml": _sheet(sheet) for k, sheet in zip(numbers, sheets, strict=True)},
    }
    found = io.BytesIO()
    with zipfile.ZipFile(found, "w") as archive:
        for name, text in members.items():
            entry = zipfile.ZipInfo(name, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, text.encode("utf-8"))
    return found.getvalue()


def _names(wanted: Iterable[str]) -> list[str]:
    """Names that a spreadsheet takes: short, without forbidden signs, each once (in any case)."""
    found: list[str] = []
    for name in wanted:
        plain = _NOT_IN_NAMES.sub(" ", _NOT_IN_XML.sub("", printable(name))).strip()[:_NAME_LENGTH] or "Sheet"
        given, number = plain, 1
        while given.casefold() in {one.casefold() for one in found}:
            number += 1
            end = f" {number}"
            given = plain[: _NAME_LENGTH - len(end)] + end
        found.append(given)
    return found


def _content_types(numbers: Iterable[int]) -> str:
    parts = [("/xl/workbook.xml", "sheet.main"), ("/xl/styles.xml", "styles")]
    parts += [(f"/xl/worksheets/sheet{k}.xml", "worksheet") for k in numbers]
    told = "".join(f'<Override PartName="{path}" ContentType="{_KIND}.{kind}+xml"/>' for path, kind in parts)
    return (
        f'{_HEAD}<Types xmlns="{_PACKAGE}/content-types"><Default Extension="rels" ContentType="application/'
        'vnd.openxmlformats-package.relationships+xml"/><Default Extension="xml" ContentType="application/'
        f'xml"/>{told}</Types>'
    )


def _relations(links: Iterable[tuple[str, str, str]]) -> str:
    told = "".join(
        f'<Relationship Id="{key}" Type="{_LINKS}/{kind}" Target="{target}"/>' for key, kind, target in links
    )
    return f'{_HEAD}<Relationships xmlns="{_PACKAGE}/relationships">{told}</Relationships>'


def _sheet(sheet: Sheet) -> str:
    if len(sheet.rows) >= _MOST_ROWS:
        msg = f"{sheet.name}: {len(sheet.rows):,} rows are more than a sheet holds; write CSV instead"
        raise ValueError(msg)
    longest = [len(text) for text in sheet.head]
    for row in sheet.rows:
        for k, value in enumerate(row[: len(longest)]):
            # a number is shown in ten characters whatever its digits
            longest[k] = max(longest[k], len(value) if isinstance(value, str) else 10)
    rows = [_row(1, sheet.head, ' s="1"'), *(_row(k, row) for k, row in enumerate(sheet.rows, 2))]
    widths = "".join(
        f'<col min="{k}" max="{k}" width="{min(max(length + 1, _NARROWEST), _WIDEST)}" customWidth="1"/>'
        for k, length in enumerate(longest, 1)
    )
    return (
        f'{_HEAD}<worksheet xmlns="{_MAIN}"><sheetViews><sheetView workbookViewId="0"><pane ySplit="1" '
        'topLeftCell="A2" activePane="bottomLeft" state="frozen"/></sheetView></sheetViews>'
        f"<cols>{widths}</cols><sheetData>{''.join(rows)}</sheetData></worksheet>"
    )


def _row(number: int, values: Iterable[Cell], style: str = "") -> str:
    return f'<row r="{number}">{"".join(_cell(value, style) for value in values)}</row>'


def _cell(value: Cell, own: str) -> str:
    if isinstance(value, str):
        text = escape(_NOT_IN_XML.sub("", printable(value))[:_CELL_LENGTH], quote=False)
        return f'<c t="inlineStr"{own}><is><t xml:space="preserve">{text}</t></is></c>'
    if isinstance(value, bool):
        return f'<c t="b"{own}><v>{int(value)}</v></c>'
    if value is None or not math.isfinite(value):
        return f"<c{own}/>"
    return f"<c{own}><v>{float(value)!r}</v></c>"
