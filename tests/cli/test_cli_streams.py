"""Every command on a terminal, under NO_COLOR and in a pipe: colours, progress, quiet; no name steers it."""

import io
import re
import shutil
import subprocess
import sys

import click
import pytest
from command_line import QUICK, Ended, Terminal, log_text, run, run_on, write_log, write_workbook
from rendered_tissues import write_bundles

from tissueid.cli.flags import walk
from tissueid.cli.main import cli
from tissueid.cli.output import echo, terminal_line

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="such names are no file names there")

COLOUR = re.compile(r"\x1b\[(?:\d+;)*(?:[34]\d|9[0-7]|10[0-7])(?:;\d+)*m")
#: Clear the screen, a C1 control, directions turned around, and a line that was never printed.
HOSTILE = "liver\x1b[2J\x9b31m\u202eevil\u200f\u061c\x07"
FAKED = "tissueid: all is well"
LABEL = f"{HOSTILE}\n{FAKED}"
#: What the program itself sends: colours, ends of lines, and the cursor of its progress.
OWN = re.compile(r"\x1b\[(?:\d+;)*\d+m|\n|\r|\x1b\[(?:\?25[hl]|\d*[AK])")
STEERING = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u200e\u200f\u061c\u202a-\u202e\u2066-\u2069]")
STUDY = (
    'schema = "tissueid/study/1"\n[study]\ntitle = "cows\\u001b[2J\\u202e"\nlicence = "CC-BY-4.0"\n'
    '[[specimen]]\nname = "liver\\u001b[2J\\u009b31m\\u202eevil\\u200f\\u061c"\n'
    '[[exclude]]\nfile = "b.csv"\nbecause = "it\\u001b[2J slipped\\u202e\\nFAKE"\n'
)
BAD = f"bad{LABEL}.csv"
#: A press that takes no time.
PRESS = ("--device", "sim", "--script", "indent 2 mm at 250 mm/min", "--virtual")
#: Command -> exit code, and what to type in the prepared folder, in which every name is hostile; what takes
#: long is stopped by an input that is refused.
TYPED: dict[str, tuple[int, tuple[str, ...]]] = {
    "fit": (0, ("fit", "lab", "-o", "again", *QUICK)),
    "models": (0, ("models", "fung")),
    "cohort": (4, ("cohort", "out")),
    "rupture": (4, ("rupture", "lab", "-o", "ruptured", "--no-study")),
    "study init": (0, ("study", "init", "other")),
    "study check": (7, ("study", "check", "lab")),
    "study exclude": (0, ("study", "exclude", "lab/b.csv", "--because", LABEL)),
    "study include": (0, ("study", "include", "lab/b.csv")),
    "study export": (0, ("study", "export", "lab", "--crate", "crate")),
    "compare": (0, ("compare", "a.h5", "b.h5")),
    "design": (0, ("design", "a.h5", "--machine", "bench")),
    "calibrate": (2, ("calibrate", f"lab/b.csv/{LABEL}", "--simulations", "100")),
    "calibrate-frame": (0, ("calibrate-frame", "lab/b.csv", "-o", "frame.csv")),
    "inspect": (7, ("inspect", "lab", "meat.xlsx", BAD)),
    "report": (0, ("report", "out")),
    "export": (0, ("export", "out", "-o", "copy.json")),
    "status": (0, ("status", "out")),
    "validate": (6, ("validate", "out", BAD)),
    "migrate": (0, ("migrate", "out")),
    "watch": (0, ("watch", "lab", "--once")),
    "devices list": (0, ("devices", "list")),
    "devices info": (0, ("devices", "info", "sim")),
    "devices home": (0, ("devices", "home", "sim")),
    "devices test": (0, ("devices", "test", "sim", "--seconds", "0.1")),
    "devices calibrate-force": (2, ("devices", "calibrate-force", "--yes")),
    "devices calibrate-damping": (5, ("devices", "calibrate-damping", "--yes")),
    "devices calibrate-weight": (5, ("devices", "calibrate-weight", "--yes")),
    "devices emulate": (2, ("devices", "emulate", "--script", LABEL)),
    "synth": (0, ("synth", "paper-a-22", "-o", "synthetic", "--rate", "10")),
    "render": (0, ("render", "a.h5", *PRESS)),
    "control": (0, ("control", "a.h5", "--seconds", "1")),
    "training": (7, ("training", "a.h5")),
    "reproduce": (2, ("reproduce", "pires", "--set", f"{LABEL}=1")),
    "doctor": (0, ("doctor",)),
    "explain": (0, ("explain", "misfit")),
    "config": (0, ("config", "fit")),
    "completion": (0, ("completion", "bash")),
    "view": (6, ("view", f"{LABEL}.h5", "--no-browser")),
}
#: The same for other ways in which a command shows a name.
OTHERS: dict[str, tuple[int, tuple[str, ...]]] = {
    "inspect at length": (0, ("inspect", "lab", "-v")),
    "inspect as json": (0, ("inspect", "lab", "meat.xlsx", "--json")),
    "inspect with a study": (0, ("inspect", "lab/b.csv", "--study", "lab/study.toml")),
    "fit what is refused": (3, ("fit", BAD, "-o", "no")),
    "fit as json": (0, ("fit", "lab/b.csv", "--no-study", "-o", "one", "--json", *QUICK)),
    "fit what is not there": (2, ("fit", LABEL)),
    "fit with an odd option": (2, ("fit", "lab", "--draws", LABEL)),
    "an odd command": (2, (LABEL,)),
    "an odd parameter": (2, ("explain", LABEL)),
    "export json": (0, ("export", "out")),
    "export a table": (0, ("export", "out", "--format", "specimens")),
    "compare as json": (0, ("compare", "a.h5", "b.h5", "--json")),
    "render on an odd device": (2, ("render", "a.h5", "--device", LABEL)),
}
#: What these print is what was asked for, however quiet.
DATA = {"completion"}


def harmless(ended: Ended) -> str:
    """The words of a command, in which nothing steers the terminal."""
    text = f"{ended.stdout}\n{ended.stderr}"
    left = OWN.sub("", text)
    found = STEERING.search(left)
    assert found is None, ascii(left[max(0, found.start() - 60) : found.end() + 60])
    assert not any(line.startswith(FAKED) for line in text.split("\n"))
    return text


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """A folder in which every name is hostile, its fit, and two bundles of such specimens."""
    folder = tmp_path_factory.mktemp("streams") / "hostile"
    lab = folder / "lab"
    lab.mkdir(parents=True)
    text = log_text(label=HOSTILE.replace("\x07", ""), stride=16)
    (lab / f"a{LABEL}.csv").write_text(text, encoding="utf-8")
    (lab / "b.csv").write_text(text, encoding="utf-8")
    (lab / "study.toml").write_text(STUDY, encoding="utf-8")
    (folder / BAD).write_text("no\n", encoding="utf-8")
    write_log(folder / "other" / "log.csv")
    write_workbook(folder / "meat.xlsx", "FF1\u202eA\u200f\x85", stride=16)
    ended = run_on(Terminal, "fit", lab, folder / "meat.xlsx", "-o", folder / "out", "--no-study", *QUICK)
    assert ended.code in (0, 4, 7), ended.stderr
    harmless(ended)
    write_bundles(folder, LABEL)
    return folder


@pytest.fixture
def place(prepared, tmp_path, monkeypatch):
    """A copy of the prepared folder to type in."""
    shutil.copytree(prepared, tmp_path / "here", symlinks=True)
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("TERM", "xterm-256color")
    for name in ("NO_COLOR", "FORCE_COLOR", "COLORTERM"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "here"


def test_every_command_is_looked_at():
    leaves = {" ".join(name) for name, command in walk(cli) if not isinstance(command, click.Group)}
    assert leaves == set(TYPED)


@pytest.mark.parametrize("name", [*TYPED, *OTHERS])
def test_a_name_steers_nothing_and_there_is_no_colour_where_none_is_wanted(name, place, monkeypatch):
    code, typed = (TYPED | OTHERS)[name]
    monkeypatch.setenv("NO_COLOR", "1")
    ended = run_on(Terminal, *typed)
    assert ended.code == code or (name == "doctor" and ended.code == 7), ended.stderr
    said = harmless(ended)
    assert said.strip()
    assert COLOUR.findall(said) == []


@pytest.mark.parametrize("name", TYPED)
def test_quiet_says_errors_only_and_a_pipe_sees_no_progress(name, place):
    # `run` itself refuses escapes and carriage returns
    ended = run(*TYPED[name][1], "-q")
    assert ended.code != 1, ended.stderr
    if name not in DATA:
        assert ended.stdout == ""
    if ended.code == 0:
        assert ended.stderr == ""
    else:
        assert ended.stderr != "" or name in {"doctor", "study check"}


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-"])
def test_a_stream_that_is_closed_is_no_bug(closed):
    shell = f"exec {sys.executable} -m tissueid models fung {closed}"
    ended = subprocess.run(["sh", "-c", shell], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize("name", ["inspect", "inspect at length", "fit", "report", "control"])
def test_a_terminal_sees_colours_or_progress(name, place):
    assert COLOUR.search(harmless(run_on(Terminal, *(TYPED | OTHERS)[name][1])))


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
