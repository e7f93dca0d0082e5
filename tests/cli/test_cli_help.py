"""Help costs nothing, explains everything, and the documentation does what it says."""

from __future__ import annotations

import json
import re

import pytest
from command_line import REPOSITORY, python, run
from test_cli_documentation import commands_of

from tissueid import __version__
from tissueid.cli.main import COMMANDS, GROUPS

README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
HEAVY = ("numpy", "pandas", "lmfit", "rich", "scipy", "numba", "h5py", "plotly", "jinja2", "pint")
LISTING = "import sys, json; print(json.dumps(sorted({name.split('.')[0] for name in sys.modules})))"


def modules_after(code: str) -> set[str]:
    """Top-level modules loaded in a new process after some code."""
    return set(json.loads(python("-c", f"{code}\n{LISTING}").stdout.splitlines()[-1]))


def test_nothing_heavy_is_loaded_before_it_is_used():
    loaded = modules_after("from tissueid.cli.main import main; assert main(['--help']) == 0")
    assert "click" in loaded
    assert loaded.isdisjoint(HEAVY)
    assert modules_after("import tissueid; tissueid.__version__").isdisjoint({*HEAVY, "click"})
    loaded = modules_after("import tissueid; tissueid.read_trials")
    assert "numpy" in loaded
    assert loaded.isdisjoint({"lmfit", "numba", "plotly"})


def test_an_unknown_attribute_is_an_attribute_error():
    import tissueid

    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = tissueid.nonsense


def test_help_lists_every_command_with_what_it_does_and_every_group_keeps_one_promise():
    text = " ".join(run("--help", code=0, shown="Examples:").stdout.split())
    for name, meaning in COMMANDS.items():
        assert f"{name} {meaning}" in text
    assert len(COMMANDS) == sum(map(len, GROUPS.values()))
    vision = (REPOSITORY / "VISION.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [123] \| (.*) \|$", vision, flags=re.MULTILINE)
    promised = [name for row in rows for name in re.findall(r"(?<!of )\b[A-Z]\w+", row)]
    assert sorted(promised) == sorted(GROUPS)


def test_version_is_that_of_the_package():
    assert run("--version").stdout == f"tissueid {__version__}\n"


@pytest.fixture
def reader_folder(tmp_path, datasets, monkeypatch):
    """An empty folder with a few recordings where README says they are."""
    for target in ("lab_data", "datasets_synthetic/paper-a-hold-100Hz"):
        (tmp_path / target).mkdir(parents=True)
        source = datasets / "paper-a-hold-100Hz" / "hold-8-1.csv"
        (tmp_path / target / source.name).write_bytes(source.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_readme_runs_as_printed(reader_folder):
    commands = [one.words[1:] for one in commands_of(REPOSITORY / "README.md") if one.words[0] == "tissueid"]
    named = "lab_data/ inspect inspect study fit models validate report export watch synth render"
    assert [words[0] for words in commands] == named.split()
    for words in commands:
        run(*words, code=0)
    table = re.findall(r"^\| `([^`]+)` \|", README, flags=re.MULTILINE)
    for name in table:
        assert list((reader_folder / "out").glob(name.replace("<specimen>", "*"))), name
    found: dict[str, object] = {}
    for block in re.findall(r"^```python\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL):
        exec(compile(block, "README.md", "exec"), found)
    viscosity = found["sampled"]["eta"]  # type: ignore[index]
    # truth: 63.62 N/mm times 0.021 s
    low, high = viscosity.interval(0.95)
    assert low <= 63.62 * 0.021 <= high
    assert found["own"].result.model.name == "power * constant * creep"  # type: ignore[attr-defined]


def test_readme_names_every_exit_code_a_command_can_end_with():
    (text,) = re.findall(r"^Exit codes: (.*?)\n\n", README, flags=re.MULTILINE | re.DOTALL)
    assert {int(code) for code in re.findall(r"\b(\d+) ", text)} == {0, 1, 2, 3, 4, 5, 6, 7, 130}
