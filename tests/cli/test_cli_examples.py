"""The program explains itself: help that costs nothing, examples, flags and quantities, and this machine."""

from __future__ import annotations

import json
import os
import re
import shlex

import click
import pytest
from command_line import REPOSITORY, python, run
from reference_pages import api_page, examples_of, flags_page, options_page

import tissueid
from tissueid import doctor, errors
from tissueid.cli.devices_command import HANDS
from tissueid.cli.export_command import TABLES as FORMS
from tissueid.cli.flags import walk
from tissueid.cli.main import COMMANDS, GROUPS, cli, with_verb
from tissueid.cli.rupture_command import ASKED as OFFERED
from tissueid.explanations import EXIT_MEANINGS, explain, explanations
from tissueid.flags import FLAGS
from tissueid.haptics.hand import PRESETS
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.quantity_words import QUANTITIES
from tissueid.rendering import first_start
from tissueid.rupture.study import ASKED
from tissueid.store.tidy import TABLES
from tissueid.viewer import bundling

README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
WALKED = list(walk(cli))
EXAMPLES = [(line, name) for name, command in WALKED for line in examples_of(command)]


def words_of(line: str) -> list[str]:
    """The words of an example, without a remark, a redirection or a pipe behind it."""
    typed = re.split(r"\s{2,}|\s[>|]\s", line)[0]
    return shlex.split(typed)


def any_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of examples need not be there."""
    monkeypatch.setattr(click.Path, "convert", lambda _self, value, _parameter, _context: value)


def unfit(line: str) -> str | None:
    """Why an example could not be typed; ``None`` where it can."""
    name, *rest = words_of(line)
    rest = with_verb(rest)
    command: click.Command = cli
    context: click.Context | None = None
    try:
        while isinstance(command, click.Group):
            context = command.make_context(name, rest, parent=context)
            name, found, rest = command.resolve_command(context, [*context._protected_args, *context.args])  # type: ignore[assignment]
            if found is None:
                return "no such command"
            command = found
        command.make_context(name, rest, parent=context)
    except click.exceptions.Exit:
        return None
    except click.UsageError as error:
        return error.format_message()
    return None


@pytest.mark.parametrize("name", [name for name, _ in WALKED], ids=" ".join)
def test_a_command_has_help_and_examples_of_itself(name):
    ended = run(*name, "--help", code=0)
    head, _, examples = ended.stdout.partition("Examples:")
    lines = [line.strip() for line in examples.strip().splitlines()]
    start = " ".join(("tissueid", *name))
    assert lines
    assert all(line == start or line.startswith(f"{start} ") for line in lines)
    # after the line of usage, at least one sentence
    assert re.search(r"\w[^\n]*\.", head.partition("\n")[2])


#: What can't be typed, so that a check of examples is one.
UNFIT = """\
tissueid fti lab_data/
tissueid fit lab_data/ --drawz 100
tissueid fit lab_data/ --draws ten
tissueid fit lab_data/ --sampler nuts
tissueid study lab_data/
tissueid study exclude lab_data/x.csv extra --because x
tissueid synth paper-a-30
tissueid reproduce everybody""".splitlines()


def test_an_example_can_be_typed_and_what_cannot_is_found(monkeypatch):
    any_path(monkeypatch)
    assert [line for line, _ in EXAMPLES if unfit(line) is not None] == []
    assert [line for line in UNFIT if unfit(line) is None] == []


def test_words_that_help_says_without_loading_the_code_are_those_of_the_code():
    assert (PRESETS, ASKED, tuple(TABLES)) == (HANDS, OFFERED, FORMS)


def test_every_option_has_words():
    silent = [
        f"{' '.join(name)} {option.opts[-1]}"
        for name, command in WALKED
        for option in command.params
        if isinstance(option, click.Option) and not option.help
    ]
    assert silent == []


@pytest.mark.parametrize(
    ("page", "made"), [("options", options_page), ("flags", flags_page), ("api", api_page)]
)
def test_a_page_is_that_of_the_program(page, made):
    written = (REPOSITORY / "docs" / f"{page}.md").read_text(encoding="utf-8")
    assert written == made(), "run scripts/write-docs"


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
    assert run("--version").stdout == f"tissueid {tissueid.__version__}\n"


MOST_LINES = 25


def test_every_exit_code_is_explained():
    used = {str(code) for code in (errors.EXIT_OK, errors.EXIT_INTERRUPTED, *errors.EXIT_PRECEDENCE)}
    assert set(EXIT_MEANINGS) == used


def test_options_and_files_that_advice_names_exist():
    options = (REPOSITORY / "docs" / "options.md").read_text(encoding="utf-8")
    told = " ".join(f"{one.follows} {one.remedy}" for one in explanations().values())
    for option in set(re.findall(r"--[a-z][a-z-]+", told)):
        assert f"{option}" in options, option
    for command in set(re.findall(r"`tissueid ([a-z-]+)", told)):
        assert f"## `tissueid {command}" in options, command


def test_a_flag_is_explained_with_what_follows_and_what_to_do():
    said = " ".join(run("explain", *FLAGS, code=0).stdout.split())
    for code, advice in FLAGS.items():
        assert {advice.follows[-1], advice.remedy[-1]} == {"."}, code
        own = said.partition(f"flag {code}: ")[2].partition(" flag ")[0]
        assert all(words in own for words in (advice.means, advice.follows, advice.remedy)), code


def test_a_quantity_is_told_with_unit_dependence_and_interval_in_few_lines():
    for name, words in QUANTITIES.items():
        ended = run("explain", words.symbol, code=0)
        said = " ".join(ended.stdout.split())
        assert ended.stdout == run("explain", name).stdout
        for part in (words.symbol, words.unit, words.meaning, words.depends, words.interval):
            assert part in said, name
        assert len(ended.stdout.splitlines()) <= MOST_LINES
    # a name may be typed loosely
    run("explain", "clipped-force", "viscosity_N_s_per_mm_b2", "130", " 7 ", "tau2", "b1,3", code=0)


def test_every_parameter_of_the_model_is_a_quantity():
    printed = {one.name: one.symbol for one in kelvin_voigt(2, 2, 3.0).parameters}
    for name, symbol in printed.items():
        plain = re.sub(r"_b2$", "", name)
        assert explain(symbol).name == explain(name).name == plain


def test_what_is_none_is_answered_with_the_nearest():
    ended = run("explain", "not_identifed", code=2, said="did you mean not_identified")
    assert ended.stdout == ""
    assert "lists what it knows" in run("explain", "xyzzy").stderr


def test_without_a_name_everything_is_listed():
    text = run("explain").stdout
    for name in explanations():
        assert re.search(rf"^\w.*\b{name}\b", text, flags=re.MULTILINE), name
    assert {one["name"] for one in run("explain", "--json").json()} == set(explanations())
    assert run("explain", "7", "-q").stdout == ""


NAMES = [
    "tissueid", "machine", "libraries", "extras", "servo loop", "real time", "devices",
    "viewer page", "browser",
]  # fmt: skip


def test_every_check_is_told_with_what_to_do():
    ended = run("doctor", "--json")
    document = ended.json()
    assert [check["name"] for check in document["checks"]] == NAMES
    assert ended.code == (7 if document["missing"] else 0), ended.stderr
    for check in document["checks"]:
        assert check["state"] in {"ok", "note", "missing"}
        assert check["words"]
    told = run("doctor").stdout
    for check in document["checks"]:
        assert check["name"] in told


def looks() -> dict[str, tuple[str, str]]:
    return {check.name: (check.state, check.way_out) for check in doctor.examine()}


def test_what_is_missing_is_found_and_asking_for_rights_changes_nothing(tmp_path, monkeypatch):
    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    monkeypatch.setattr(bundling, "BUNDLE", tmp_path)
    monkeypatch.setattr(first_start, "is_compiled", lambda: False)
    required = ["numpy>=1", "no-such-library>=2", "arviz; extra == 'arviz'"]
    monkeypatch.setattr(doctor, "requires", lambda _name: required)
    found = looks()
    assert found["viewer page"][0] == "missing"
    assert found["servo loop"] == ("note", "tissueid doctor --warm")
    assert found["libraries"] == ("missing", "pip install no-such-library")
    assert found["real time"][0] in {"ok", "note"}
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before
    (tmp_path / "index.html").touch()
    assert looks()["viewer page"][0] == "ok"


@pytest.mark.slow
def test_warming_leaves_nothing_to_compile():
    checks = run("doctor", "--warm", "--json").json()["checks"]
    assert {check["name"]: check["state"] for check in checks}["servo loop"] == "ok"
