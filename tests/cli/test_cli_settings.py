"""Configuration files and the environment, and completion: what counts, is refused, offered and told."""

import contextlib
import io
import os
import shutil
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest
from command_line import QUICK, REPOSITORY, run, write_log

from tissueid.cli.main import COMMANDS, cli


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working folder and an empty home."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("TISSUEID_CONFIG")
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    return tmp_path / "work"


def user(text: str) -> Path:
    path = Path.home() / ".config" / "tissueid" / "config.toml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def seed_of(*typed: str) -> int:
    ended = run("fit", write_log(Path("log.csv")), "--json", *QUICK, *typed, code=0)
    return int(ended.json()["provenance"]["options"]["seed"])


def test_typed_counts_before_environment_before_project_before_user(folder, monkeypatch):
    assert seed_of() == 0
    user("[fit]\nseed = 1\n")
    assert seed_of() == 1
    Path("tissueid.toml").write_text("[fit]\nseed = 2\n", encoding="utf-8")
    assert seed_of() == 2
    monkeypatch.setenv("TISSUEID_FIT_SEED", "3")
    assert seed_of() == 3
    assert seed_of("--seed", "4") == 4


def test_an_order_of_a_settings_file_gives_way_to_a_model_that_is_typed(folder):
    Path("tissueid.toml").write_text('[fit]\nbranches = "1"\nstiffness-degree = "0"\n', encoding="utf-8")
    log = write_log(Path("log.csv"))
    ended = run("fit", log, "--json", "--model", "power * prony:1", "--sampler", "none", code={0, 4})
    assert ended.json()["specimens"][0]["model"]["name"] == "power * prony:1"
    run("fit", log, "--model", "power * prony:1", "--branches", "2", code=2, said="--branches")


def test_a_project_may_keep_its_settings_in_pyproject_that_is_of_other_tools_as_well(folder):
    for text in ("[tool.other]\nseed = 5\n", "not toml at all"):
        Path("pyproject.toml").write_text(text, encoding="utf-8")
        assert run("config", "--json").json() == {"files": [], "settings": []}
    Path("pyproject.toml").write_text("[tool.tissueid.fit]\nseed = 5\n", encoding="utf-8")
    assert told()["fit", "seed"] == (5, "pyproject.toml, line 2")
    Path("tissueid.toml").write_text("[fit]\nseed = 2\n", encoding="utf-8")
    assert "keep them in one of the two" in refused("config")


def test_another_user_file_or_none(folder, monkeypatch):
    user("[fit]\nseed = 1\n")
    monkeypatch.setenv("TISSUEID_CONFIG", "")
    assert told() == {}
    Path("mine.toml").write_text("[fit]\nseed = 8\n", encoding="utf-8")
    monkeypatch.setenv("TISSUEID_CONFIG", "mine.toml")
    assert told() == {("fit", "seed"): (8, "mine.toml, line 2")}
    monkeypatch.setenv("TISSUEID_CONFIG", "gone.toml")
    assert "gone.toml: can't be read" in refused("config")


def refused(*args: str) -> str:
    ended = run(*args, code=2)
    assert len(ended.stderr.splitlines()) == 1
    return ended.stderr


@pytest.mark.parametrize(
    ("text", "command", "said"),
    [
        ("[fit]\n\nsedd = 1\n", "fit", "tissueid.toml, line 3: 'sedd' is no option of tissueid fit"),
        ("[fit]\n\nsedd = 1\n", "fit", "did you mean 'seed'?"),
        ("[fit]\nstiffness_degree = 1\n", "fit", "line 2: 'stiffness_degree'"),
        ("[fit]\nstiffness_degree = 1\n", "fit", "did you mean 'stiffness-degree'?"),
        ("# mine\n[fti]\nseed = 1\n", "fit", "line 2: 'fti' is no command and no general key"),
        ("seed = 1\n", "fit", "line 1: 'seed' is no command"),
        ("fit = 1\n", "fit", "line 1: fit is a command; its settings stand in a table"),
        ("[study]\ninit = 1\n", "study", "line 2: init is a command"),
        ("[study.innit]\nforce = true\n", "study", "line 1: 'innit' is no part of study"),
        ("[study.init]\nforce = true\n", "study", "line 2: force must be typed each time"),
        ("[render]\nyes = true\n", "render", "line 2: yes must be typed each time"),
        ("[fit]\nseed = \"one\"\n", "fit", "line 2: seed = 'one': must be a whole number, without quotes"),
        ("[fit]\nseed = 1.5\n", "fit", "line 2: seed = 1.5: must be a whole number"),
        ("[fit]\nseed = -1\n", "fit", "line 2: seed = -1: -1 is not in the range"),
        ("[fit]\npoisson = true\n", "fit", "line 2: poisson = True: must be a number"),
        ("[fit]\nno-rupture = 1\n", "fit", "line 2: no-rupture = 1: must be true or false, without quotes"),
        ("[fit]\nsampler = \"nuts\"\n", "fit", "line 2: sampler = 'nuts': 'nuts' is not one of"),
        ("[fit]\ntip = 3\n", "fit", "line 2: tip = 3: must be text in quotes"),
        ("[fit]\nrequire = \"static\"\n", "fit", "line 2: require = 'static': must be a list"),
        ("[fit]\nrequire = [\"nothing\"]\n", "fit", "line 2: require = ['nothing']: 'nothing' is not one of"),
        ("quiet = \"yes\"\n", "fit", "line 1: quiet = 'yes': must be true, false or a number from 0"),
        ("[fit\n", "fit", "tissueid.toml: is no valid TOML"),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused_with_its_line(folder, text, command, said):
    Path("tissueid.toml").write_text(text, encoding="utf-8")
    assert said in refused("config")
    args = {"fit": ("fit", "no.csv"), "study": ("study", "check", "."), "render": ("render", "--selftest")}
    assert said in refused(*args[command])


def test_help_and_doctor_work_whatever_a_file_says(folder):
    Path("tissueid.toml").write_text("[fit]\nsedd = 1\n", encoding="utf-8")
    run("fit", "--help", code=0)
    run("explain", "7", code=0)
    run("doctor", "--quiet", code={0, 7})


@pytest.mark.parametrize(
    ("variable", "value", "said"),
    [
        ("TISSUEID_FIT_SEDD", "1", "did you mean TISSUEID_FIT_SEED?"),
        ("TISSUEID_FIT_SEED", "one", "TISSUEID_FIT_SEED = 'one': 'one' is not a valid integer"),
        ("TISSUEID_FIT_NO_RUPTURE", "perhaps", "must be 1 or 0"),
        ("TISSUEID_FIT_REQUIRE", "static,nothing", "'nothing' is not one of"),
        # a consent is none
        ("TISSUEID_RENDER_YES", "1", "TISSUEID_RENDER_YES: tissueid render takes no such setting"),
    ],
)
def test_a_variable_that_cannot_be_meant_is_refused(folder, monkeypatch, variable, value, said):
    monkeypatch.setenv(variable, value)
    command = ("render", "--selftest") if "RENDER" in variable else ("fit", "no.csv")
    assert said in refused(*command)


def told(*args: str) -> dict[tuple[str, str], tuple[object, str]]:
    rows = run("config", "--json", *args, code=0).json()["settings"]
    return {(row["command"], row["option"]): (row["value"], row["source"]) for row in rows}


def test_what_is_in_force_is_told_with_its_source(folder, monkeypatch):
    mine = user("quiet = true\n[fit]\nseed = 1\ndraws = 500\n")
    Path("tissueid.toml").write_text(
        '[fit]\nseed = 2\nrequire = ["static"]\n[study.init]\ndecimal = "comma"\n', encoding="utf-8"
    )
    monkeypatch.setenv("TISSUEID_CALIBRATE_FRAME_DECIMAL", "point")
    found = told()
    assert found["fit", "seed"] == (2, "tissueid.toml, line 2")
    assert found["fit", "require"] == (["static"], "tissueid.toml, line 3")
    assert found["fit", "draws"] == (500, f"{mine}, line 4")
    assert found["study init", "decimal"] == ("comma", "tissueid.toml, line 5")
    assert found["calibrate-frame", "decimal"] == ("point", "TISSUEID_CALIBRATE_FRAME_DECIMAL")
    assert found["devices list", "quiet"] == (1, f"{mine}, line 1")
    fit = told("fit")
    assert fit["fit", "sampler"] == ("emcee", None)
    assert fit["fit", "seed"] == found["fit", "seed"]
    assert {command for command, _ in told("study")} >= {"study init", "study check"}
    run("config", shown=("fit --seed", "tissueid.toml, line 2"))


def test_a_value_of_a_subcommand_reaches_it(folder):
    write_log(Path("lab/log.csv"))
    for text, code in (('[study.init]\nsheet = "absent"\n', 2), ("", 0)):
        Path("tissueid.toml").write_text(text, encoding="utf-8")
        run("study", "init", "lab", code=code)


def test_a_user_without_a_home_has_no_file(folder, monkeypatch):
    monkeypatch.setattr(Path, "home", Mock(side_effect=RuntimeError("Could not determine home directory.")))
    assert run("config", "--json").json() == {"files": [], "settings": []}
    assert "no home folder" in refused("completion", "bash", "--install")


def test_nothing_set_is_told_so_and_a_command_that_is_none_is_refused(folder):
    run("config", shown=("nothing is set", str(Path.home() / ".config" / "tissueid" / "config.toml")))
    assert "there is no such command" in refused("config", "fti")
    assert "there is no such command" in refused("config", "fit", "more")


def offered(words: str, *, shell: str = "bash") -> list[str]:
    """Words that a shell would offer for the last one of a line."""
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
    known = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    words = ["bash", "-c", script]
    done = subprocess.run(words, cwd=tmp_path, env=known, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["emcee", "none"]
    assert done.stderr == ""
