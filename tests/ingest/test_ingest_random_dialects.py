"""Bluehill in random dialects: language, encoding, marks, head, results, order; each reads back exactly."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from tissueid.errors import InputError
from tissueid.ingest import read_each
from tissueid.synth import Dialect, SyntheticLog, bluehill_csv
from tissueid.synth.bluehill import LANGUAGES

_UNICODE = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be")
#: Code pages that hold the letters of a language.
CODE_PAGES = {
    "en": ("ascii", "latin-1", "cp1250", "gbk"),
    "pl": ("cp1250",),
    "zh": ("gbk",),
    "ja": ("cp932",),
    **dict.fromkeys(("de", "fr", "es", "pt", "it"), ("latin-1", "cp1252")),
}
#: Delimiter, decimal mark, thousands separator.
MARKS = (
    (",", ".", ""), (",", ".", ","), (",", ",", ""),
    (";", ",", ""), (";", ",", "."), (";", ",", "\u00a0"), (";", ",", "\u202f"), (";", ".", "'"),
    ("\t", ",", ""), ("\t", ".", ""),
)  # fmt: skip
COLUMNS = ((), (), (("Segment ID", "", "22476"),), (("Comment", "(text)", "no remark"),))
COUNTS = (2, 3, 5, 8, 40, 150, 600)
SPEED_MM_S = 0.5


def random_dialect(draw: random.Random) -> Dialect:
    """Any combination that an export could print."""
    language = draw.choice(list(LANGUAGES))
    encoding = draw.choice((*_UNICODE, *CODE_PAGES[language]))
    delimiter, decimal, thousands = draw.choice(MARKS)
    try:
        thousands.encode(encoding)
    except UnicodeEncodeError:
        thousands = ""
    newline = draw.choice(("\r\n", "\n", "\r"))
    windows = newline == "\r\n"
    names_carry_units = draw.random() < 0.3
    wrapped = draw.random() < 0.1
    return Dialect(
        delimiter=delimiter,
        decimal=decimal,
        thousands=thousands,
        quoted=bool(thousands) or delimiter == decimal or draw.random() < 0.4,
        encoding=encoding,
        names=LANGUAGES[language].names,
        header=draw.random() < 0.85,
        units_row=not names_carry_units,
        newline=newline,
        language=language,
        groups=draw.random() < 0.6,
        header_lines=draw.choice((0, 0, 5, 20, 48)),
        vertical=not wrapped and draw.random() < 0.25,
        units=("s", "mm", "N") if names_carry_units else ("(sec)", "(mm)", "(N)"),
        unit_in_names=names_carry_units,
        order=draw.choice(((0, 1, 2), (0, 2, 1), (2, 1, 0))),
        columns=draw.choice(COLUMNS),
        results=draw.choice(("", "", "before", "after")),
        wrapped=wrapped,
        lead=draw.choice(("", "\r\n")) if windows else "",
        end=draw.choice(("", "\r\r\n", "\r\n")) if windows else "",
    )


def log_of(count: int, start_s: float) -> SyntheticLog:
    i = np.arange(count)
    force = 4.319 - 12.5 * i
    truth = {"speed_mm_s": SPEED_MM_S, "depth_mm": 8.0, "hold_s": 30.0}
    return SyntheticLog("synthetic", "22L.3", start_s + 0.25 * i, -2.04726 - 0.01 * i, force, force, truth)


def fault(path: Path, dialect: Dialect, log: SyntheticLog) -> str | None:
    """What is wrong with the reading of one file, ``None`` where nothing is."""
    (item,) = read_each(path)
    if isinstance(item, InputError):
        return f"refused: {item}"
    recorded = (item.time_s, item.displacement_mm, item.force_N)
    for channel, written in zip(recorded, (log.time_s, log.displacement_mm, log.force_N), strict=True):
        if channel.tolist() != [float(f"{value:.5f}") for value in written.tolist()]:
            return "other numbers"
    if dialect.header and item.specimen != "22L.3":
        return f"specimen {item.specimen!r}"
    if dialect.header and item.protocol.speed_mm_s != SPEED_MM_S:
        return f"speed {item.protocol.speed_mm_s}, encoding {item.source.encoding}"
    return None


@pytest.mark.parametrize(("seed", "count"), [(11, 300), pytest.param(12, 4000, marks=pytest.mark.slow)])
def test_random_dialects_read_back_exactly(tmp_path: Path, seed: int, count: int) -> None:
    draw = random.Random(seed)
    path = tmp_path / "synthetic.csv"
    wrong = []
    for _ in range(count):
        dialect, log = random_dialect(draw), log_of(draw.choice(COUNTS), draw.choice((0.0, 990.0)))
        path.write_bytes(bluehill_csv(log, dialect=dialect))
        found = fault(path, dialect, log)
        if found is not None:
            wrong.append(f"{found}; {log.time_s.size} rows, {dialect}")
    assert not wrong, "\n".join([f"{len(wrong)} of {count} dialects were misread", *wrong[:5]])
