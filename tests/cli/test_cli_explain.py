"""Plain words for every flag, parameter and exit code, and what this machine can do."""

from __future__ import annotations

import os
import re

import pytest
from command_line import REPOSITORY, run

from tissueid import doctor, errors
from tissueid.explanations import EXIT_MEANINGS, explain, explanations
from tissueid.flags import FLAGS
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.quantity_words import QUANTITIES
from tissueid.rendering import first_start
from tissueid.viewer import bundling

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
