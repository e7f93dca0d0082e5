"""Every warning is at most 25 words with its way out and has a number: all places that raise one are read.

Messages are f-strings: an evaluator of their syntax trees gives the longest text each may be, a value
in braces as one word that holds a number; sentences that are put together from lists are raised for real.
"""

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import tissueid
from tissueid.flags import FLAGS, HARM, MOST_WORDS, NOTHING, Flag, flag_level, harm_rank, warning_line
from tissueid.inference import frame_effect
from tissueid.ingest.quality import below_resolution, spike

PACKAGE = Path(tissueid.__file__).parent
#: Code -> why its sentence needs no number of its own.
WITHOUT_NUMBER = {
    "column_choice": "it names the columns",
    "units_assumed": "it names column and unit",
    "unit_overridden": "it names both units",
    "undecoded_text": "it names the encoding",
    "normalised_axes": "it names the units",
    "decision_overridden": "it quotes the user",
    "no_ramp": "there is nothing to measure",
    "no_hold": "there is nothing to measure",
    "tension": "it quotes the file",
    "starts_in_contact": "there is nothing to measure",
    "rendered": "it names the tissue",
    "sampler_not_converged": "where nothing could be sampled there is no number",
    "interval_withheld": "the reason may be that there are no draws",
}
#: A name that a user or a file gives counts as one word; a joined list of symbols as few.
ONE = "7"


@dataclass(frozen=True, slots=True)
class Raised:
    """One place that raises a flag: its codes and the longest text of its message."""

    place: str
    codes: tuple[str, ...]
    message: str


def _assignments(function: ast.AST, name: str) -> list[ast.expr]:
    """All that a name may hold in a function; what is added to it follows what it was."""
    found: list[ast.expr] = []
    added: list[ast.expr] = []
    for node in ast.walk(function):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                if isinstance(target, ast.Name) and target.id == name:
                    found.append(node.value)
                elif isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    pairs = zip(target.elts, node.value.elts, strict=True)
                    found += [value for one, value in pairs if isinstance(one, ast.Name) and one.id == name]
        elif isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name) and node.target.id == name:
            added.append(node.value)
    if added and found:
        return [ast.JoinedStr([ast.FormattedValue(one, -1) for one in (found[0], *added)])]
    return found


def _longest(texts: list[str]) -> str:
    return max(texts, key=lambda text: len(text.split()), default=ONE)


def _text(node: ast.expr | None, function: ast.AST, depth: int = 0) -> str:
    """The longest text of an expression; a value that is no text is a number."""
    if depth > 12 or node is None:
        return ONE
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ONE
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(part, function, depth + 1) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        return ONE if node.format_spec is not None else _text(node.value, function, depth + 1)
    if isinstance(node, ast.IfExp):
        return _longest([_text(one, function, depth + 1) for one in (node.body, node.orelse)])
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _text(node.left, function, depth + 1) + _text(node.right, function, depth + 1)
    if isinstance(node, ast.Name):
        return _longest([_text(one, function, depth + 1) for one in _assignments(function, node.id)])
    return ONE


def _codes(node: ast.expr) -> tuple[str, ...]:
    return tuple(one.value for one in ast.walk(node) if isinstance(one, ast.Constant) and one.value in FLAGS)


def _functions(tree: ast.Module) -> Iterator[ast.AST]:
    yield from (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


@cache
def _raised() -> tuple[Raised, ...]:
    found = []
    for file in sorted(PACKAGE.rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        if "Flag(" not in text:
            continue
        for function in _functions(ast.parse(text)):
            for call in ast.walk(function):
                if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Flag":
                    where = f"{file.relative_to(PACKAGE)}:{call.lineno}"
                    found.append(Raised(where, _codes(call.args[0]), _text(call.args[1], function)))
    return tuple(found)


@pytest.mark.parametrize("one", _raised(), ids=lambda one: one.place)
def test_a_warning_is_short_and_has_a_number_and_a_way_out(one: Raised) -> None:
    assert one.codes, "the code of a flag is written where it is raised"
    for code in one.codes:
        line = warning_line(code, one.message)
        words = len(one.message.split()), len(FLAGS[code].remedy.split())
        assert " ..." not in line.removeprefix(one.message), f"{words} words: {one.message}"
        assert len(line.split()) <= MOST_WORDS
        assert code in WITHOUT_NUMBER or any(letter.isdigit() for letter in one.message), one.message


def _unstated(monkeypatch: pytest.MonkeyPatch, stated: Mapping[str, float]) -> Flag | None:
    monkeypatch.setattr(frame_effect, "frame_effect", lambda *_: SimpleNamespace(tau=0.05, viscosity=-0.04))
    return frame_effect._unknown(SimpleNamespace(), None, stated, 0.012)  # type: ignore[arg-type]


def test_sentences_that_are_put_together_are_short_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    time = np.arange(4000) * 0.01
    travel = np.sin(time)
    travel[1000] += 5.0
    force = np.cos(time)
    force[2000] += 5.0
    flags = [
        spike(time, travel, force),
        below_resolution(np.round(np.sin(time), 1), np.round(np.cos(time), 1)),
        _unstated(monkeypatch, {}),
        _unstated(monkeypatch, {"force_filter_s": 0.01}),
        _unstated(monkeypatch, {"force_filter_s": 0.01, "skew_s": 0.003}),
    ]
    for flag in flags:
        line = warning_line(flag.code, flag.message)
        assert len(line.split()) <= MOST_WORDS
        assert " ..." not in line, flag.message


def test_every_code_is_raised_somewhere() -> None:
    raised = {code for one in _raised() for code in one.codes}
    # kept for results of earlier versions
    assert set(FLAGS) - raised <= {"prior_dominated"}


def test_the_order_of_harm_holds_every_code_once() -> None:
    ordered = [code for codes in HARM.values() for code in codes]
    assert sorted(ordered) == sorted(FLAGS)
    assert [harm_rank(code) for code in ordered] == list(range(len(ordered)))
    assert {flag_level(code) for code in HARM["serious"]} == {"serious"}
    assert harm_rank("of a later version") > max(map(harm_rank, ordered))


@pytest.mark.parametrize("code", FLAGS)
def test_the_way_out_leaves_room_for_what_was_seen(code: str) -> None:
    advice = FLAGS[code]
    assert advice.remedy == NOTHING or len(advice.remedy.split()) <= 10
    assert advice.many
    counted = f"12 of 124 recordings {advice.many}"
    assert warning_line(code, counted).startswith(counted)


def test_words_of_a_user_are_cut_where_they_are_too_many() -> None:
    line = warning_line("decision_overridden", f"contact_mm = 3, because: {'it slipped ' * 40}")
    assert len(line.split()) <= MOST_WORDS + 1
    assert line.endswith(FLAGS["decision_overridden"].remedy)
