"""Plain words for every flag, parameter and exit code."""

from __future__ import annotations

import re

import pytest
from command_line import REPOSITORY, run

from tissueid import errors
from tissueid.explanations import EXIT_MEANINGS, explain, explanations, flags_page
from tissueid.flags import FLAGS
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.quantity_words import QUANTITIES

MOST_LINES = 25


def test_every_flag_has_advice_and_nothing_else_has() -> None:
    assert set(FLAGS) == set(FLAGS)
    for code, advice in FLAGS.items():
        assert advice.follows.endswith("."), code
        assert advice.remedy.endswith("."), code


def test_every_exit_code_is_explained() -> None:
    used = {str(code) for code in (errors.EXIT_OK, errors.EXIT_INTERRUPTED, *errors.EXIT_PRECEDENCE)}
    assert set(EXIT_MEANINGS) == used


def test_options_and_files_that_advice_names_exist() -> None:
    options = (REPOSITORY / "docs" / "options.md").read_text(encoding="utf-8")
    told = " ".join(f"{one.follows} {one.remedy}" for one in explanations().values())
    for option in set(re.findall(r"--[a-z][a-z-]+", told)):
        assert f"{option}" in options, option
    for command in set(re.findall(r"`tissueid ([a-z-]+)", told)):
        assert f"## `tissueid {command}" in options, command


@pytest.mark.parametrize("code", FLAGS)
def test_a_flag_is_explained_with_what_follows_and_what_to_do(code: str) -> None:
    ended = run("explain", code)
    assert ended.code == 0
    said = " ".join(ended.stdout.split())
    assert FLAGS[code].means in said
    assert FLAGS[code].follows in said
    assert FLAGS[code].remedy in said


@pytest.mark.parametrize("name", ["clipped-force", "viscosity_N_s_per_mm_b2", "130", " 7 ", "tau2", "b1,3"])
def test_a_name_may_be_typed_loosely(name: str) -> None:
    assert run("explain", name).code == 0


@pytest.mark.parametrize("name", QUANTITIES)
def test_a_quantity_is_told_with_unit_dependence_and_interval_in_few_lines(name: str) -> None:
    words = QUANTITIES[name]
    ended = run("explain", words.symbol)
    said = " ".join(ended.stdout.split())
    assert ended.code == 0
    assert ended.stdout == run("explain", name).stdout
    for part in (words.symbol, words.unit, words.meaning, words.depends, words.interval):
        assert part in said
    assert len(ended.stdout.splitlines()) <= MOST_LINES


def test_every_parameter_of_the_model_is_a_quantity() -> None:
    printed = {one.name: one.symbol for one in kelvin_voigt(2, 2, 3.0).parameters}
    for name, symbol in printed.items():
        plain = re.sub(r"_b2$", "", name)
        assert explain(symbol).name == explain(name).name == plain


def test_what_is_none_is_answered_with_the_nearest() -> None:
    ended = run("explain", "not_identifed")
    assert ended.code == 2
    assert "did you mean not_identified" in ended.stderr
    assert ended.stdout == ""
    assert "lists what it knows" in run("explain", "xyzzy").stderr


def test_without_a_name_everything_is_listed() -> None:
    text = run("explain").stdout
    for name in explanations():
        assert re.search(rf"^\w.*\b{name}\b", text, flags=re.MULTILINE), name
    assert {one["name"] for one in run("explain", "--json").json()} == set(explanations())
    assert run("explain", "7", "-q").stdout == ""


def test_the_page_is_that_of_the_program() -> None:
    assert (REPOSITORY / "docs" / "flags.md").read_text(encoding="utf-8") == flags_page(), (
        "scripts/write-docs"
    )
