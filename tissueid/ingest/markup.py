"""Tables in HTML and in the XML of old spreadsheets, which programs save under the suffix .xls.

Their rows become lines of text whose cells are parted by tabs; all tables of a file follow each other, parted
by blank lines.
"""

from __future__ import annotations

import re
from html.parser import HTMLParser

_ROWS = frozenset({"tr", "row", "ss:row"})
_CELLS = frozenset({"td", "th", "cell", "ss:cell"})
_TABLES = frozenset({"table", "worksheet", "ss:worksheet"})
_HIDDEN = frozenset({"script", "style", "title", "o:documentproperties", "documentproperties"})
_CHARSET = re.compile(rb"(?:charset|encoding)\s*=\s*[\"\']?\s*([\w-]{2,20})", re.IGNORECASE)
_ROW_TAG = re.compile(rb"<(?:ss:)?(?:tr|row)\b", re.IGNORECASE)
#: A cell that stands further right than all of a sheet's columns is damaged.
_MOST_COLUMNS = 16_384


def holds_rows(head: bytes) -> bool:
    """True where the first bytes hold a row of a table."""
    return _ROW_TAG.search(head) is not None


class _Tables(HTMLParser):
    """Rows of all tables as lines."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.lines: list[str] = []
        self._row: list[str] | None = None
        self._cell: list[str] | None = None
        self._hidden = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Begin a row or a cell; an index or a span leaves cells empty."""
        if tag in _HIDDEN:
            self._hidden += 1
        elif tag in _ROWS:
            self._close_row()
            self._row = []
        elif tag in _CELLS and self._row is not None:
            self._close_cell()
            said = {key.rpartition(":")[2]: value or "" for key, value in attrs}
            index = int(said["index"]) if said.get("index", "").isdecimal() else 0
            if len(self._row) < index <= _MOST_COLUMNS:
                self._row += [""] * (index - 1 - len(self._row))
            self._cell = []

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """An empty cell."""
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        """End a cell, a row or a table."""
        if tag in _HIDDEN:
            self._hidden = max(0, self._hidden - 1)
        elif tag in _CELLS:
            self._close_cell()
        elif tag in _ROWS:
            self._close_row()
        elif tag in _TABLES:
            self._close_row()
            self.lines.append("")

    def handle_data(self, data: str) -> None:
        """Keep the text of a cell."""
        if self._cell is not None and not self._hidden:
            self._cell.append(data)

    def close(self) -> None:
        """Keep a last row that was cut."""
        super().close()
        self._close_row()

    def _close_cell(self) -> None:
        if self._cell is not None and self._row is not None:
            text = " ".join("".join(self._cell).split())
            self._row.append('"' + text.replace('"', '""') + '"' if '"' in text else text)
        self._cell = None

    def _close_row(self) -> None:
        self._close_cell()
        if self._row is not None:
            self.lines.append("\t".join(self._row))
        self._row = None


def lines_of_markup(data: bytes) -> bytes | None:
    """The rows of all tables as lines of UTF-8; ``None`` where there is no row of two cells."""
    stated = _CHARSET.search(data[:4096])
    names = ["utf-8", *([stated[1].decode()] if stated else []), "cp1252"]
    for name in names:
        try:
            text = data.decode(name)
            break
        except (UnicodeDecodeError, LookupError):
            continue
    else:
        text = data.decode("latin-1")
    tables = _Tables()
    tables.feed(text)
    tables.close()
    if not any("\t" in line for line in tables.lines):
        return None
    return ("\n".join(tables.lines) + "\n").encode()
