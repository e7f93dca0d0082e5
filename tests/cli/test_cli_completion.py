"""Completion in the shells: asked for as they ask, installed where they look."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import subprocess
import sys

import pytest
from command_line import REPOSITORY, run

from tissueid.cli.main import COMMANDS, cli


def offered(words: str, *, shell: str = "bash") -> list[str]:
    """What a shell would offer for the last word of a line."""
    typed, said = words.split(" "), io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
    with pytest.MonkeyPatch.context() as patched, contextlib.redirect_stdout(said):
        patched.setenv("_TISSUEID_COMPLETE", f"{shell}_complete")
        patched.setenv("COMP_WORDS", words)
        patched.setenv("COMP_CWORD", typed[-1] if shell == "fish" else str(len(typed) - 1))
        with pytest.raises(SystemExit) as ended:
            cli.main(args=[], prog_name="tissueid")
    assert ended.value.code == 0
    return said.buffer.getvalue().decode("utf-8").splitlines()  # type: ignore[attr-defined]


def test_commands_are_offered_with_what_they_do():
    assert offered("tissueid ") == [f"plain,{name}" for name in COMMANDS]
    assert offered("tissueid calibrate-") == ["plain,calibrate-frame"]
    lines = offered("tissueid insp", shell="zsh")
    assert lines[:2] == ["plain", "inspect"]
    assert COMMANDS["inspect"] in lines[2]


#: The end of a line, and what is offered there.
ENDS = {
    "fit --samp": "plain,--sampler",
    "fit --sampler n": "plain,none",
    "fit --require rel": "plain,relaxation-time",
    "fit --recipe mts": "plain,mts-793",
    "fit lab": "file,lab",
    "report o": "dir,o",
    "cohort o": "dir,o",
    "study ch": "plain,check",
    "explain not_id": "plain,not_identified",
    "explain viscos": "plain,viscosity_N_s_per_mm",
    "synth paper-a-2": "plain,paper-a-22",
    "synth paper-a-22 --dialect testx": "plain,testxpert-tra-de",
    "render --preset pap": "plain,paper-a",
    "render --scene hip": "plain,hip-resurfacing",
    "config fi": "plain,fit",
    "config study in": "plain,init",
    "--ver": "plain,--version",
}


def test_what_can_follow_is_offered():
    assert {typed: want for typed, want in ENDS.items() if want not in offered(f"tissueid {typed}")} == {}
    # fish asks in its own way
    lines = offered("tissueid fit --samp", shell="fish")
    assert any(line.startswith("plain,") and "--sampler" in line for line in lines)


@pytest.mark.parametrize(
    ("shell", "place"),
    [
        ("bash", ".local/share/bash-completion/completions/tissueid"),
        ("zsh", ".zfunc/_tissueid"),
        ("fish", ".config/fish/completions/tissueid.fish"),
    ],
)
def test_a_script_is_printed_or_installed_where_the_shell_looks(tmp_path, monkeypatch, shell, place):
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME", "ZDOTDIR"):
        monkeypatch.delenv(name, raising=False)
    printed = run("completion", shell, code=0, shown=f"_TISSUEID_COMPLETE={shell}_complete")
    assert list(tmp_path.iterdir()) == []
    installed = run("completion", shell, "--install", code=0)
    assert (tmp_path / place).read_text(encoding="utf-8") == printed.stdout
    assert str(tmp_path / place) in installed.stderr
    assert run("completion", shell, "--install", "-q").stderr == ""


def test_a_place_that_cannot_be_written_and_another_shell_are_refused(tmp_path, monkeypatch):
    (tmp_path / ".zfunc").write_text("a file", encoding="ascii")
    monkeypatch.setenv("ZDOTDIR", str(tmp_path))
    run("completion", "zsh", "--install", code=2, said="print the script and place it yourself")
    run("completion", "tcsh", code=2, said="'bash', 'zsh', 'fish'")


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_bash_completes_with_the_printed_script(tmp_path):
    command = tmp_path / "tissueid"
    command.write_text(
        f'#!/bin/sh\nPYTHONPATH={REPOSITORY} exec {sys.executable} -m tissueid "$@"\n', encoding="ascii"
    )
    command.chmod(0o755)
    (tmp_path / "completion").write_text(run("completion", "bash").stdout, encoding="utf-8")
    script = (
        "source completion; COMP_WORDS=(tissueid fit --sampler ''); COMP_CWORD=3; "
        '_tissueid_completion tissueid; echo "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=tmp_path,
        env=os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["emcee", "none"]
    assert done.stderr == ""


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_accept_the_script(tmp_path, shell):
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    path = tmp_path / "script"
    path.write_text(run("completion", shell).stdout, encoding="utf-8")
    assert subprocess.run([shell, "-n", str(path)], check=False).returncode == 0
