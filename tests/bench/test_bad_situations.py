"""Mishaps at a bench: each situation ends in the right reading, or in one sentence with a way out.

A row is a situation: the files of a folder, what is typed there, the exit code, and words that
stdout and stderr must hold between them.  A further one is a row more.
"""

import contextlib
import io
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from tissueid.cli.main import main

REPOSITORY = Path(__file__).resolve().parents[2]
LOG = REPOSITORY / "datasets_synthetic" / "paper-a-hold-100Hz" / "hold-8-1.csv"
QUICK = ("--branches", "1", "--stiffness-degree", "0", "--sampler", "none", "-q")
#: Lines of a message: what is wrong and the way out need no more.
MOST_LINES = 3


@dataclass(frozen=True, slots=True)
class Situation:
    files: Mapping[str, str | bytes]  # what the folder holds: contents by path
    typed: tuple[str, ...]  # arguments; run in that folder
    code: int
    told: tuple[str, ...]  # words of the answer
    kept: tuple[str, ...] = ()  # files that must be there afterwards, as they were prepared
    linked: bool = False  # whether "link" leads to "lab"


LINES = LOG.read_text(encoding="ascii").splitlines()
LAB = {"lab/log.csv": "\n".join([*LINES[:6], *LINES[6:1606:8], ""])}
STUDY = LAB | {"lab/study.toml": 'schema = "tissueid/study/1"\n'}
NOTES = {"empty/notes.docx": "Dear colleague"}
PICTURE = {"photo.csv": b"\x89PNG\r\n\x1a\n" + bytes(64)}

SITUATIONS: dict[str, Situation] = {
    "the output folder is the input": Situation(
        LAB, ("fit", "lab", "-o", "lab"), 2, ("same folder", "-o results"), ("lab/log.csv",)
    ),
    "the output folder is the input, by a link": Situation(
        LAB, ("fit", "lab", "-o", "link"), 2, ("same folder",), ("lab/log.csv",), linked=True
    ),
    "the input is the output folder, by a link and a dot": Situation(
        LAB, ("fit", "link", "-o", "./lab/../lab"), 2, ("same folder",), ("lab/log.csv",), linked=True
    ),
    "the output folder is that of the study": Situation(
        STUDY, ("fit", "lab/study.toml", "-o", "lab"), 2, ("same folder",), ("lab/log.csv",)
    ),
    "a study of rupture is written into its input": Situation(
        LAB, ("rupture", "lab", "-o", "lab"), 2, ("same folder",), ("lab/log.csv",)
    ),
    "the output folder holds somebody's report": Situation(
        LAB | {"out/report.html": "mine"},
        ("fit", "lab", "-o", "out"),
        2,
        ("report.html", "another folder"),
        ("out/report.html",),
    ),
    "the output folder is a file": Situation(
        LAB | {"out": "a file"}, ("fit", "lab", "-o", "out"), 2, ("out", "file"), ("out",)
    ),
    "a folder without recordings": Situation(
        NOTES, ("fit", "empty", "-o", "out"), 3, ("empty", "no"), ("empty/notes.docx",)
    ),
    "a picture named .csv": Situation(PICTURE, ("inspect", "photo.csv"), 3, ("PNG", "test machine")),
    "a file that is not there": Situation(LAB, ("fit", "lab/lgo.csv"), 2, ("no such file",)),
    "a name that would steer the terminal": Situation(
        {"bad\x1b[2J\u202e\nok.csv": "nothing\n"},
        ("inspect", "."),
        3,
        ("bad\\x1b[2J\\u202e\\nok.csv", "line 1"),
    ),
    "an option that does not exist": Situation(LAB, ("fit", "lab", "--branch", "1"), 2, ("--branches",)),
    "a command that does not exist": Situation({}, ("fti", "lab"), 2, ("Did you mean 'fit'",)),
    "a flag that does not exist": Situation(
        {}, ("explain", "not_identifed"), 2, ("did you mean not_identified",)
    ),
    "a column that does not exist": Situation(
        LAB, ("inspect", "lab", "--columns", "force=Kraft"), 3, ("Kraft", "Load")
    ),
    "a pair of columns without a quantity": Situation(
        LAB, ("inspect", "lab", "--columns", "Kraft"), 2, ("time=Zeit", "'Kraft'")
    ),
    "a contact beyond any machine": Situation(
        LAB, ("inspect", "lab", "--contact", "1e9"), 2, ("--contact", "mm")
    ),
    "a pattern of specimens that fits nothing": Situation(
        LAB, ("fit", "lab", "--specimen-by", "cow([0-9]+)", *QUICK), 2, ("fits no recording", "log.csv")
    ),
    "results that were never written": Situation(LAB, ("report", "lab"), 6, ("lab",), ("lab/log.csv",)),
    "a bundle that is a table": Situation(
        {"liver.h5": "depth,force\n1,2\n"},
        ("compare", "liver.h5", "liver.h5"),
        6,
        ("liver.h5", "tissueid fit"),
    ),
}


@pytest.mark.skipif(sys.platform == "win32", reason="links and such names need rights there")
@pytest.mark.parametrize("what", SITUATIONS)
def test_a_bad_situation_ends_in_one_sentence_with_a_way_out(what, tmp_path, monkeypatch) -> None:
    one = SITUATIONS[what]
    for name, content in one.files.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content.encode("ascii") if isinstance(content, str) else content)
    if one.linked:
        (tmp_path / "link").symlink_to(tmp_path / "lab", target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    before = {name: Path(name).read_bytes() for name in one.kept}
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(one.typed))
    said = out.getvalue() + err.getvalue()
    assert code == one.code, said
    for words in one.told:
        assert words in said
    assert "Traceback" not in said
    assert "\x1b[2J" not in said
    # a usage line, a hint and an empty one may stand above what click says
    lines = [line for line in said.splitlines() if line and not line.startswith(("Usage:", "Try "))]
    assert len(lines) <= MOST_LINES
    for name, content in before.items():
        assert Path(name).read_bytes() == content
    # no result stands where nothing was done
    assert not list(Path().glob("*/identification.json"))
