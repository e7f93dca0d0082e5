"""Colours, progress and quiet: on a terminal, under NO_COLOR and in a pipe, for every command."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable

import pytest
from command_line import QUICK, Terminal, run, run_on, write_bundles, write_log

from tissueid.cli.flags import walk
from tissueid.cli.main import cli

COLOUR = re.compile(r"\x1b\[(?:\d+;)*(?:[34]\d|9[0-7]|10[0-7])(?:;\d+)*m")
#: A press that takes no time.
PRESS = ("--device", "sim", "--script", "indent 2 mm at 250 mm/min", "--virtual")
#: Command -> what to type in the prepared folder; what takes long is stopped by an input that is refused.
TYPED: dict[str, tuple[str, ...]] = {
    "fit": ("fit", "lab", "-o", "again", *QUICK),
    "models": ("models", "fung"),
    "cohort": ("cohort", "out"),
    "rupture": ("rupture", "lab", "-o", "ruptured"),
    "study init": ("study", "init", "other"),
    "study check": ("study", "check", "lab"),
    "study exclude": ("study", "exclude", "lab/log.csv", "--because", "it slipped"),
    "study include": ("study", "include", "lab/log.csv"),
    "study export": ("study", "export", "lab", "--crate", "crate"),
    "compare": ("compare", "a.h5", "b.h5"),
    "design": ("design", "a.h5"),
    "calibrate": ("calibrate", "nothing.csv", "--simulations", "100"),
    "calibrate-frame": ("calibrate-frame", "lab/log.csv", "-o", "frame.csv"),
    "inspect": ("inspect", "lab", "bad.csv"),
    "report": ("report", "out"),
    "export": ("export", "out", "-o", "copy.json"),
    "status": ("status", "out"),
    "validate": ("validate", "out"),
    "migrate": ("migrate", "out"),
    "watch": ("watch", "lab", "--once"),
    "devices list": ("devices", "list"),
    "devices info": ("devices", "info", "sim"),
    "devices home": ("devices", "home", "sim"),
    "devices test": ("devices", "test", "sim", "--seconds", "0.1"),
    "devices calibrate-force": ("devices", "calibrate-force", "--yes"),
    "devices calibrate-damping": ("devices", "calibrate-damping", "--yes"),
    "devices calibrate-weight": ("devices", "calibrate-weight", "--yes"),
    "devices emulate": ("devices", "emulate", "--script", "nonsense"),
    "synth": ("synth", "paper-a-22", "-o", "synthetic", "--rate", "10"),
    "render": ("render", "a.h5", *PRESS),
    "control": ("control", "a.h5", "--seconds", "1"),
    "training": ("training", "a.h5"),
    "reproduce": ("reproduce", "pires", "--set", "nonsense=1"),
    "doctor": ("doctor",),
    "explain": ("explain", "misfit"),
    "config": ("config", "fit"),
    "completion": ("completion", "bash"),
    "view": ("view", "nothing.h5", "--no-browser"),
}
#: What these print is what was asked for, however quiet.
DATA = {"completion"}


@pytest.fixture(scope="module")
def prepared(fitted_once, tmp_path_factory):
    folder = shutil.copytree(fitted_once, tmp_path_factory.mktemp("streams") / "fitted", symlinks=True)
    write_log(folder / "other" / "log.csv")
    (folder / "bad.csv").write_text("Dear colleague\n", encoding="ascii")
    assert run("study", "init", folder / "lab", "-q").code == 0
    write_bundles(folder)
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
    import click

    leaves = {" ".join(name) for name, command in walk(cli) if not isinstance(command, click.Group)}
    assert leaves <= set(TYPED)


LOOKED_AT = [" ".join(name) for name, _ in walk(cli) if " ".join(name) in TYPED]


@pytest.mark.parametrize("name", LOOKED_AT)
def test_no_colour_where_none_is_wanted(name, place, monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    ended = run_on(Terminal, *TYPED[name])
    assert COLOUR.findall(ended.stdout + ended.stderr) == []
    assert ended.code != 1, ended.stderr


@pytest.mark.parametrize("name", LOOKED_AT)
def test_quiet_says_errors_only_and_a_pipe_sees_no_progress(name, place):
    # `run` itself refuses escapes and carriage returns
    ended = run(*TYPED[name], "-q")
    assert ended.code != 1, ended.stderr
    if name not in DATA:
        assert ended.stdout == ""
    if ended.code == 0:
        assert ended.stderr == ""
    else:
        assert ended.stderr != "" or name in {"doctor", "study check", "validate"}


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-"])
def test_a_stream_that_is_closed_is_no_bug(closed):
    shell = f"exec {sys.executable} -m tissueid models fung {closed}"
    ended = subprocess.run(["sh", "-c", shell], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize(
    "args",
    [("inspect", "bad.csv"), ("fit", "lab", "-o", "again", *QUICK), ("report", "out"), TYPED["control"]],
)
def test_a_terminal_sees_colours_or_progress(args, place, monkeypatch):
    seen: Callable[[], str] = lambda: run_on(Terminal, *args).stderr  # noqa: E731
    assert COLOUR.search(seen())
    monkeypatch.setenv("NO_COLOR", "1")
    assert not COLOUR.search(seen())
