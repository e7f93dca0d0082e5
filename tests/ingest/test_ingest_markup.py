"""Tables that a program saved as HTML, or as the XML of old spreadsheets, under the name of a workbook."""

from __future__ import annotations

from pathlib import Path

import pytest
from ingest_files import codes, put, read, refusal

from tissueid.ingest import find_inputs

COUNT = 3_000  # more than the first 64 KiB
ROWS = [(k * 0.02, min(k * 0.01, 6.0), max(k * 0.01 - 1.0, 0.0) ** 2) for k in range(COUNT)]


def html(number: str, names: tuple[str, ...] = ("Time (s)", "Weg (µm)", "Load (N)")) -> str:
    def row(cells: tuple[str, ...], tag: str = "td") -> str:
        return "<TR>" + "".join(f"<{tag} class=x>{cell}</{tag}>" for cell in cells) + "</TR>\n"

    body = "".join(row((f"{t:.4f}", f"<b>{1e3 * x:.1f}</b>", number.format(f))) for t, x, f in ROWS)
    style = "<style>td {mso-number-format:1,2,3}</style><title>1 2 3</title>"
    table = f"<table border=1>{row(names, 'th')}{body}</table>"
    return f"<html><head>{style}</head><body>{table}</body></html>"


def xml(indexed: bool) -> str:
    def row(cells: tuple[object, ...], kind: str) -> str:
        index = ["", ' ss:Index="3"' if indexed else "", ""]
        return (
            "<Row>"
            + "".join(
                f'<Cell{at}><Data ss:Type="{kind}">{cell}</Data></Cell>'
                for at, cell in zip(index, cells, strict=True)
            )
            + "</Row>"
        )

    names = row(("Time (s)", "Extension (mm)", "Load (N)"), "String")
    body = "".join(row((round(t, 4), round(x, 4), round(f, 4)), "Number") for t, x, f in ROWS)
    opening = '<?xml version="1.0"?>\n<Workbook xmlns:ss="urn:schemas-microsoft-com:office:spreadsheet">'
    sheet = f'<Worksheet ss:Name="S"><Table><Column/>{names}{body}</Table></Worksheet>'
    return f"{opening}<DocumentProperties><Title>a</Title></DocumentProperties>{sheet}</Workbook>"


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_a_page_with_one_table_is_read_as_the_table(tmp_path: Path, encoding: str) -> None:
    path = put(tmp_path / "a.xls", html("{:.3f}"), encoding)
    trial = read(path)
    assert codes(trial) == []
    assert trial.time_s.size == COUNT
    assert (trial.displacement_mm[250], trial.force_N[250]) == pytest.approx((2.5, 2.25))


@pytest.mark.parametrize("indexed", [False, True])
def test_a_sheet_of_the_old_xml_is_read_with_its_empty_columns(tmp_path: Path, indexed: bool) -> None:
    path = put(tmp_path / "a.xls", xml(indexed))
    assert find_inputs([tmp_path]) == [path]
    trial = read(path)
    assert trial.time_s.size == COUNT
    assert (trial.displacement_mm[250], trial.force_N[250]) == pytest.approx((2.5, 2.25))


def test_a_number_that_a_page_damaged_is_refused(tmp_path: Path) -> None:
    text = html("{:.3f}").replace(">2.250<", ">2.2.50<")
    assert refusal(put(tmp_path / "a.xls", text)).code == "damaged_number"


@pytest.mark.parametrize("size", [10, 100_000])
def test_a_page_without_a_table_is_no_export(tmp_path: Path, size: int) -> None:
    error = refusal(put(tmp_path / "a.xls", "<html><body>" + "<p>1,2,3</p>\n" * size + "</body></html>"))
    assert error.code == "not_an_export"
    assert "HTML" in error.message
