"""Plain words for every flag, parameter and exit code, and what this machine can do."""

from __future__ import annotations

import json
import os
import re

import pytest
from command_line import REPOSITORY, run
from reference_pages import flags_page

from tissueid import doctor, errors
from tissueid.explanations import EXIT_MEANINGS, explain, explanations
from tissueid.flags import FLAGS
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.quantity_words import QUANTITIES
from tissueid.rendering import first_start
from tissueid.viewer import bundling

MOST_LINES = 25


def test_every_flag_has_advice_and_nothing_else_has():
    for code, advice in FLAGS.items():
        assert advice.follows.endswith("."), code
        assert advice.remedy.endswith("."), code


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


@pytest.mark.parametrize("code", FLAGS)
def test_a_flag_is_explained_with_what_follows_and_what_to_do(code):
    ended = run("explain", code, code=0)
    said = " ".join(ended.stdout.split())
    assert FLAGS[code].means in said
    assert FLAGS[code].follows in said
    assert FLAGS[code].remedy in said


@pytest.mark.parametrize("name", ["clipped-force", "viscosity_N_s_per_mm_b2", "130", " 7 ", "tau2", "b1,3"])
def test_a_name_may_be_typed_loosely(name):
    assert run("explain", name).code == 0


@pytest.mark.parametrize("name", QUANTITIES)
def test_a_quantity_is_told_with_unit_dependence_and_interval_in_few_lines(name):
    words = QUANTITIES[name]
    ended = run("explain", words.symbol)
    said = " ".join(ended.stdout.split())
    assert ended.code == 0
    assert ended.stdout == run("explain", name).stdout
    for part in (words.symbol, words.unit, words.meaning, words.depends, words.interval):
        assert part in said
    assert len(ended.stdout.splitlines()) <= MOST_LINES


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


def test_the_page_is_that_of_the_program():
    assert (REPOSITORY / "docs" / "flags.md").read_text(encoding="utf-8") == flags_page(), (
        "scripts/write-docs"
    )


NAMES = [
    "tissueid", "machine", "libraries", "extras", "servo loop", "real time", "devices",
    "viewer page", "browser",
]  # fmt: skip


def test_every_check_is_told_with_what_to_do():
    ended = run("doctor", "--json")
    document = json.loads(ended.stdout)
    assert [check["name"] for check in document["checks"]] == NAMES
    assert ended.code == (7 if document["missing"] else 0), ended.stderr
    for check in document["checks"]:
        assert check["state"] in {"ok", "note", "missing"}
        assert check["words"]
    told = run("doctor").stdout
    for check in document["checks"]:
        assert check["name"] in told


def look(name: str) -> doctor.Check:
    return next(check for check in doctor.examine() if check.name == name)


def test_a_page_that_was_not_built_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(bundling, "BUNDLE", tmp_path)
    assert look("viewer page").state == "missing"
    (tmp_path / "index.html").touch()
    assert look("viewer page").state == "ok"


def test_a_loop_that_is_not_compiled_is_noted(monkeypatch):
    monkeypatch.setattr(first_start, "is_compiled", lambda: False)
    check = look("servo loop")
    assert (check.state, check.way_out) == ("note", "tissueid doctor --warm")


def test_a_library_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr(
        doctor, "requires", lambda _name: ["numpy>=1", "no-such-library>=2", "arviz; extra == 'arviz'"]
    )
    check = look("libraries")
    assert (check.state, check.way_out) == ("missing", "pip install no-such-library")


def test_asking_for_rights_changes_nothing_here():
    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    assert look("real time").state in {"ok", "note"}
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before


@pytest.mark.slow
def test_warming_leaves_nothing_to_compile():
    ended = run("doctor", "--warm", "--json")
    states = {check["name"]: check["state"] for check in json.loads(ended.stdout)["checks"]}
    assert states["servo loop"] == "ok"
