"""Nothing that a file, a label or study.toml holds steers the terminal, whatever the command."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import QUICK, Ended, Terminal, log_text, run_on, write_bundles
from openpyxl import Workbook

from tissueid.cli.output import echo, terminal_line

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="such names are no file names there")

#: Clear the screen, a C1 control, directions turned around, and a line that was never printed.
HOSTILE = "liver\x1b[2J\x9b31m\u202eevil\u200f\u061c\x07"
FAKED = "tissueid: all is well"
LABEL = f"{HOSTILE}\n{FAKED}"
#: What the program itself sends: colours, ends of lines, and the cursor of its progress.
OWN = re.compile(r"\x1b\[(?:\d+;)*\d+m|\n|\r|\x1b\[(?:\?25[hl]|\d*[AK])")
STEERING = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u200e\u200f\u061c\u202a-\u202e\u2066-\u2069]")
STUDY = (
    'schema = "tissueid/study/1"\n[study]\ntitle = "cows\\u001b[2J\\u202e"\n'
    '[[specimen]]\nname = "liver\\u001b[2J\\u009b31m\\u202eevil\\u200f\\u061c"\n'
    '[[exclude]]\nfile = "b.csv"\nbecause = "it\\u001b[2J slipped\\u202e\\nFAKE"\n'
)


def assert_harmless(ended: Ended) -> None:
    text = f"{ended.stdout}\n{ended.stderr}"
    left = OWN.sub("", text)
    found = STEERING.search(left)
    assert found is None, ascii(left[max(0, found.start() - 60) : found.end() + 60])
    assert not any(line.startswith(FAKED) for line in text.split("\n"))


def workbook(path: Path) -> Path:
    book = Workbook()
    sheet = book.active
    assert sheet is not None
    sheet.title = "FF1\u202eA\u200f\x85"
    for line in log_text(label=None, stride=16).splitlines():
        cells = line.split(",")
        sheet.append([float(cell) if re.fullmatch(r"-?[\d.]+", cell) else cell for cell in cells])
    book.save(path)
    return path


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    """A folder in which every name is hostile, its fit, and two bundles of such specimens."""
    folder = tmp_path_factory.mktemp("hostile")
    lab = folder / "lab"
    lab.mkdir()
    text = log_text(label=HOSTILE.replace("\x07", ""), stride=16)
    (lab / f"a{HOSTILE}\n{FAKED}.csv").write_text(text, encoding="utf-8")
    (lab / "b.csv").write_text(text, encoding="utf-8")
    (lab / "study.toml").write_text(STUDY, encoding="utf-8")
    (folder / f"bad{HOSTILE}\n{FAKED}.csv").write_text("no\n", encoding="utf-8")
    workbook(folder / "meat.xlsx")
    ended = run_on(Terminal, "fit", lab, folder / "meat.xlsx", "-o", folder / "out", "--no-study", *QUICK)
    assert ended.code in (0, 4, 7), ended.stderr
    assert_harmless(ended)
    write_bundles(folder, LABEL)
    return folder


#: Command -> what to type in the folder; each is run on a terminal and in a pipe.
TYPED: dict[str, Callable[[Path], list[object]]] = {
    "inspect": lambda f: ["inspect", f / "lab", "-v"],
    "inspect a sheet": lambda f: ["inspect", f / "meat.xlsx"],
    "inspect as json": lambda f: ["inspect", f / "lab", f / "meat.xlsx", "--json"],
    "inspect what is refused": lambda f: ["inspect", *f.glob("bad*")],
    "inspect with a study": lambda f: ["inspect", f / "lab" / "b.csv", "--study", f / "lab" / "study.toml"],
    "fit what is refused": lambda f: ["fit", *f.glob("bad*"), "-o", f / "no"],
    "fit with a study": lambda f: ["fit", f / "lab", "-o", f / "studied", "-v", *QUICK],
    "fit as json": lambda f: ["fit", f / "lab" / "b.csv", "--no-study", "-o", f / "one", "--json", *QUICK],
    "fit what is not there": lambda f: ["fit", f / LABEL],
    "fit with an odd option": lambda f: ["fit", f / "lab", "--draws", LABEL],
    "an odd command": lambda _: [LABEL],
    "an odd parameter": lambda _: ["explain", LABEL],
    "export json": lambda f: ["export", f / "out"],
    "export a table": lambda f: ["export", f / "out", "--format", "specimens"],
    "compare": lambda f: ["compare", f / "a.h5", f / "b.h5"],
    "compare as json": lambda f: ["compare", f / "a.h5", f / "b.h5", "--json"],
    "report": lambda f: ["report", f / "out"],
    "status": lambda f: ["status", f / "out"],
    "validate": lambda f: ["validate", f / "out", *f.glob("bad*")],
    "study check": lambda f: ["study", "check", f / "lab"],
    "watch": lambda f: ["watch", f / "lab", "--once"],
    "rupture": lambda f: ["rupture", f / "lab", "-o", f / "ruptured", "--no-study"],
    "cohort": lambda f: ["cohort", f / "out"],
    "calibrate": lambda f: ["calibrate", f / "lab" / "b.csv" / LABEL],
    "design": lambda f: ["design", f / "a.h5", "--machine", "bench"],
    "render": lambda f: ["render", f / "a.h5", "--device", LABEL],
}


#: Exit codes other than 0.
CODES = {
    "inspect what is refused": 3,
    "fit what is refused": 3,
    "fit what is not there": 2,
    "fit with an odd option": 2,
    "an odd command": 2,
    "an odd parameter": 2,
    "validate": 6,
    "study check": 7,
    "rupture": 4,
    "cohort": 4,
    "calibrate": 2,
    "render": 2,
}


@pytest.mark.parametrize("what", TYPED)
def test_what_a_name_holds_is_shown_and_steers_nothing(what, hostile):
    ended = run_on(Terminal, *map(str, TYPED[what](hostile)))
    assert ended.code == CODES.get(what, 0), ended.stderr
    assert ended.stdout + ended.stderr
    assert_harmless(ended)


def test_a_line_is_one_line_and_shows_what_was_in_it():
    shown = terminal_line(LABEL)
    assert shown == f"liver\\x1b[2J\\x9b31m\\u202eevil\\u200f\\u061c\\x07\\n{FAKED}"
    assert terminal_line("👩\u200d🔬 −1.5e-05 N") == "👩\u200d🔬 -1.5×10⁻⁵ N"


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [
        ("ascii", "5.2x10^-6 +- 1 N*s \\xfc"),
        ("latin-1", "5.2x10^-6 ± 1 N·s ü"),
        ("utf-8", "5.2×10⁻⁶ ± 1 N·s ü"),
    ],
)
def test_a_terminal_without_raised_digits_gets_plain_ones(encoding, shown, monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, write_through=True)
    monkeypatch.setattr(sys, "stdout", stream)
    echo("5.2×10⁻⁶ ± 1 N·s ü")
    assert stream.buffer.getvalue().decode(encoding) == f"{shown}\n"  # type: ignore[attr-defined]
