"""A workbook is read back by two readers that did not write it; nothing in a cell is lost or run."""

from __future__ import annotations

import io
import math
import zipfile
from xml.etree import ElementTree as ET

import openpyxl
import pytest
from python_calamine import CalamineWorkbook

from tissueid.store.xlsx import Sheet, xlsx_bytes

ROWS = [
    ["liver <1> & 'co'", 0.1, True, None],
    ["=1+1", 1.25e-300, False, math.nan],
    ["a\nb\x07\u202e\uffff", -7, "", math.inf],
    ["  äöü µ  ", 5_000_000.25, "x" * 40_000, 0],
]


def test_two_readers_find_every_cell():
    raw = xlsx_bytes([Sheet("numbers", ("name", "value", "known", "rest"), ROWS)])
    (head, *rows) = openpyxl.load_workbook(io.BytesIO(raw)).active.iter_rows()
    assert [cell.value for cell in head] == ["name", "value", "known", "rest"]
    assert all(cell.font.bold for cell in head)
    assert [row[1].value for row in rows] == [0.1, 1.25e-300, -7, 5_000_000.25]
    assert [row[2].value for row in rows[:2]] == [True, False]
    assert [row[3].value for row in rows] == [None, None, None, 0]
    # text that begins with a sign of equality is no formula, and control characters are spelt out
    assert (rows[1][0].value, rows[1][0].data_type) == ("=1+1", "s")
    assert rows[0][0].value == "liver <1> & 'co'"
    assert rows[2][0].value == "a\\nb\\x07\\u202e"
    assert rows[3][0].value == "  äöü µ  "
    assert len(rows[3][2].value) == 32_767
    again = CalamineWorkbook.from_filelike(io.BytesIO(raw)).get_sheet_by_index(0).to_python()
    assert [row[1] for row in again[1:]] == [0.1, 1.25e-300, -7, 5_000_000.25]


def test_names_of_sheets_are_cut_cleaned_and_told_apart():
    wanted = ["a/b:c", "A b c", "x" * 40, "x" * 50, "", "'"]
    raw = xlsx_bytes([Sheet(name, ("h",), []) for name in wanted])
    names = openpyxl.load_workbook(io.BytesIO(raw)).sheetnames
    assert names == ["a b c", "A b c 2", "x" * 31, "x" * 29 + " 2", "Sheet", "Sheet 2"]


def test_equal_tables_give_equal_bytes_and_every_part_is_well_formed():
    sheets = [Sheet("one", ("a",), [[1.0]]), Sheet("two", ("b",), [["x"]])]
    raw = xlsx_bytes(sheets)
    assert raw == xlsx_bytes(sheets)
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        for name in archive.namelist():
            ET.fromstring(archive.read(name))
    with pytest.raises(ValueError, match="needs a sheet"):
        xlsx_bytes([])
