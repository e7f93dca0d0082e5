"""Warnings of fit: the five of most harm a specimen, and once a batch what most of it shares."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from fit_factory import specimen_fit
from posterior_factory import sampled
from typed_call import typed_call

from tissueid.cli.fit_summary import _print_specimens
from tissueid.flags import FLAGS, MOST_WORDS, Flag, harm_rank
from tissueid.report.specimen_lines import (
    MOST_WARNINGS,
    WIDTH,
    block_lines,
    shared_codes,
    shared_lines,
    warning_lines,
)

_print_specimens = typed_call(_print_specimens)
block_lines = typed_call(block_lines)
shared_codes = typed_call(shared_codes)
shared_lines = typed_call(shared_lines)
warning_lines = typed_call(warning_lines)

#: Lines of a specimen without -v.
MOST_LINES = 12
CODES = ("corner_slow", "preload", "clipped_force", "gap", "units_assumed", "misfit", "spike", "no_hold")


def document(name: str = "cow", codes: tuple[str, ...] = CODES, **options: Any) -> dict[str, Any]:
    fit = replace(sampled(specimen_fit()), flags=(), specimen=name, **options)
    found: dict[str, Any] = fit.as_json()
    flags = [Flag(code, f"{code} was seen at 3 s").as_json() for code in codes]
    found["trials"] = [{**found["trials"][0], "flags": flags, "sheet": name}]
    return found


def test_the_five_of_most_harm_stand_first_and_the_rest_is_counted() -> None:
    lines = warning_lines(document())
    assert len(lines) == MOST_WARNINGS
    said = [line.split()[0] for _, line in lines]
    expected = sorted(set(CODES) - {"no_hold"}, key=harm_rank)
    assert said == expected[:MOST_WARNINGS]
    assert said[0] == "clipped_force"
    assert lines[0][0] == "serious"
    assert lines[-1][1].endswith("(2 more: -v)")
    for (_, line), code in zip(lines, said, strict=True):
        assert FLAGS[code].remedy in line
        assert len(line.replace("(2 more: -v)", "").split()) <= MOST_WORDS
    every = warning_lines(document(), verbose=1)
    told = " ".join(line for _, line in every)
    assert all(f"{code} was seen" in told for code in CODES)


def test_what_most_of_a_batch_shares_is_counted_once() -> None:
    names = [f"FF{k}" for k in range(124)]
    batch = [document(name, ("preload",)) for name in names[:-1]] + [document(names[-1], ("gap",))]
    shared = shared_codes(batch)
    assert shared == ("preload",)
    (line,) = shared_lines(batch, shared)
    assert line == "123 of 124 sheets start preloaded. Start in air, or state --contact."
    assert warning_lines(batch[0], shared=shared) == []
    (own,) = warning_lines(batch[-1], shared=shared)
    assert own[1].startswith("gap was seen")
    # two of a kind are no batch
    assert shared_codes(batch[:2]) == ()


def test_a_specimen_takes_few_lines_and_the_block_comes_first(capsys: pytest.CaptureFixture[str]) -> None:
    _print_specimens([document()], verbose=0)
    blank, head, *lines = capsys.readouterr().out.splitlines()
    assert not blank
    assert "NRMSD" in head
    block = [line.split()[0] for line in lines if not line.startswith("   ")][:4]
    assert block == ["relaxation", "viscosity", "static", "dynamic"]
    assert len([head, *lines[:-1]]) <= MOST_LINES
    assert lines[-1].startswith("In brackets: 95 % intervals")
    _print_specimens([document()], verbose=1)
    assert "95 % [" in capsys.readouterr().out


def test_the_block_names_what_is_not_identified_and_wraps_what_is_long() -> None:
    lines = block_lines(sampled(specimen_fit(identified=False)).as_json())
    assert any(line.endswith("tau not identified") for line in lines)
    assert all(len(line) <= WIDTH for line in lines)
    contradicted = block_lines(sampled(specimen_fit(), misfit=True).as_json())
    assert not any("[" in line or "±" in line for line in contradicted)
