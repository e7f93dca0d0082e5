"""The fast path reads a subset of the slow reader's grammar, to the same values, on any bytes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.errors import InputError
from tissueid.ingest import body
from tissueid.ingest.body import make_plain
from tissueid.ingest.layout import Layout
from tissueid.ingest.refusals import Place
from tissueid.ingest.rows import RowReader
from tissueid.ingest.text import Text

CELLS = [
    "0", "1.5", "-2.25", "+3", ".5", "1e3", "1,5", "-2,25", "1,234.5", "1.234,5", "12,345,678.5",
    "12.345.678,5",
    "2,11,0828.5", "0,123.5", "1234,567.5", "1,234", "1.234",
    '"1"5', "1 234,5", "1 2", "", " 7 ", "x", "nan", "inf",
    "1e999", '""', '"', "1.5,000", "1\u00a0234,5", "1'234.5", "1_0", "0x1",
    "--1", "1e5,000.5",
]  # fmt: skip


@st.composite
def tables(draw):
    delimiter, decimal = draw(st.sampled_from([(",", "."), (";", ","), (";", "."), ("\t", "."), (",", ",")]))
    sound = ["1.5", "-2.25", "1000.125", "0.5"] if decimal == "." else ["1,5", "-2,25", "1000,125"]
    cell = st.sampled_from(sound * 6 + CELLS)
    quoting = draw(st.sampled_from(["all", "none", "some"]))
    lines = []
    for _ in range(draw(st.integers(1, 6))):
        row = draw(st.lists(cell, min_size=3, max_size=3))
        if draw(st.integers(0, 9)) == 0:
            row = row[:-1] if draw(st.booleans()) else [*row, "1"]
        quoted = [quoting == "all" or (quoting == "some" and draw(st.booleans())) for _ in row]
        lines.append(delimiter.join(f'"{c}"' if q else c for c, q in zip(row, quoted, strict=True)))
        if draw(st.integers(0, 9)) == 0:
            lines.append("")
    ending = draw(st.sampled_from(["\n", "\r\n"]))
    return delimiter, decimal, ending.join(lines) + ending


@settings(max_examples=1500, deadline=None)
@given(tables(), st.booleans())
def test_what_the_fast_path_reads_the_slow_reader_reads_alike(table, last_is_text):
    delimiter, decimal, lines = table
    empty = ("",) * 3
    numeric = (True, True, not last_is_text)
    layout = Layout(delimiter, decimal, (), empty, empty, False, None, 1, 0, 3, numeric)
    wanted = (0, 1) if last_is_text else (0, 1, 2)
    reader = RowReader(Text(lines.encode(), "utf-8", "utf-8"), layout, wanted, Place("x.csv"))
    fast = body._read_fast(reader)
    if fast is None:
        return
    try:
        slow, flags = reader.read()
    except InputError as error:
        pytest.fail(f"the fast path read {lines!r} as {fast}, the slow reader refuses it: {error}")
    assert not [flag for flag in flags if flag.code == "cut_row"]
    for quick, exact in zip(fast, slow, strict=True):
        np.testing.assert_array_equal(quick, exact)


@pytest.mark.parametrize("count", [1, 7, 8, 63, 64, 65, 1000])
def test_quotes_and_groups_are_taken_out_across_word_borders(count):
    rows = "".join(f'"1,{i % 1000:03d}.5","-{i}.25"\r\n' for i in range(count))
    expected = "".join(f"1{i % 1000:03d}.5,-{i}.25\r\n" for i in range(count))
    assert make_plain(rows.encode(), delimiter=",", decimal=".") == expected.encode()


def test_pieces_of_a_large_file_meet_without_a_seam(tmp_path, monkeypatch):
    monkeypatch.setattr(body, "_PIECE_BYTES", 1 << 12)
    lines = "".join(f'"{i},000.5";"{i}.5";"-{i}.25"\n' for i in range(1, 900))
    layout = Layout(";", ".", (), ("",) * 3, ("",) * 3, False, None, 1, 0, 3, (True,) * 3)
    fast = body._read_fast(RowReader(Text(lines.encode(), "ascii", "ascii"), layout, (0, 1, 2), Place("x")))
    assert fast is not None
    np.testing.assert_array_equal(fast[0], [i * 1000 + 0.5 for i in range(1, 900)])
    np.testing.assert_array_equal(fast[2], [-i - 0.25 for i in range(1, 900)])
