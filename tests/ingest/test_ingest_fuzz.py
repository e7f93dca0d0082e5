"""Spoilt exports are refused or read as they stand, and the fast reader is the slow one."""

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from random import Random

import numpy as np
import pytest
from fuzz_mutant import Mutant, Mutation, Outcome, judge, judge_parts, original, remarks
from fuzz_seeds import seeds
from fuzz_structure import STRUCTURE
from fuzz_values import MARKS, VALUES
from fuzz_workbooks import WORKBOOK_MUTATIONS, WorkbookMutant, judge_workbook
from hypothesis import given, settings
from hypothesis import strategies as st
from ingest_files import put

from tissueid.errors import InputError
from tissueid.ingest import body, read_each
from tissueid.ingest.body import make_plain
from tissueid.ingest.layout import Layout
from tissueid.ingest.refusals import Place
from tissueid.ingest.rows import RowReader
from tissueid.ingest.text import Text
from tissueid.trial import Trial

#: Of structure, of values, of units and marks.
CLASSES: dict[str, tuple[Mutation, ...]] = {"a": STRUCTURE, "b": VALUES, "c": MARKS}
#: Mutants of each class: 500 by default, 20,000 in all with the slow run; and of workbooks.
SHORT = {"a": 200, "b": 150, "c": 150}
LONG = {"a": 8000, "b": 6000, "c": 6000}
SHORT_WORKBOOKS, LONG_WORKBOOKS = dict.fromkeys(SHORT, 40), dict.fromkeys(SHORT, 700)
#: Shares: a reader that refuses all, or reads all, proves nothing.
LEAST_READ = 0.05
LEAST_REFUSED = {"a": 0.20, "b": 0.0, "c": 0.20}


def make(letter: str, index: int) -> Mutant:
    """The mutant of that number: the same on every machine."""
    rng = Random(f"{letter}-{index}")
    while True:
        mutation, seed = rng.choice(CLASSES[letter]), rng.choice(seeds())
        mutant = mutation(seed, rng)
        if mutant is not None:
            return mutant


def usual_flags(folder: Path) -> dict[str, frozenset[tuple[str, str]]]:
    """Remarks on each sound seed, which reads as the oracle reads it."""
    usual = {}
    for seed in seeds():
        (trial,) = read_each(put(folder / f"seed{seed.suffix}", seed.data))
        assert not isinstance(trial, InputError), f"{seed.name}: {trial}"
        sound = Mutant("seed", seed, seed.data, seed.intent, "original")
        usual[seed.name] = remarks(trial)
        judge(sound, trial, usual[seed.name])
        assert trial.time_s.size == len(original(seed)) > 50
    return usual


#: A mutant's kind, suffix and bytes, and the judge of what was read.
Case = tuple[str, str, bytes, Callable[[list[Trial | InputError]], Outcome]]


def judge_all(mutant: Mutant, items: list[Trial | InputError], usual: frozenset[tuple[str, str]]) -> Outcome:
    return judge(mutant, items[0], usual) if len(items) == 1 else judge_parts(mutant, items)


def judge_sheet(mutant: WorkbookMutant, items: list[Trial | InputError]) -> Outcome:
    (item,) = items
    return judge_workbook(mutant, item)


def texts(letter: str, count: int, folder: Path) -> Iterator[Case]:
    usual = usual_flags(folder)
    for index in range(count):
        mutant = make(letter, index)
        kind = f"{mutant.kind} of {mutant.seed.name!r}"
        judged = partial(judge_all, mutant, usual=usual[mutant.seed.name])
        yield kind, mutant.seed.suffix, mutant.data, judged


def workbooks(letter: str, count: int, _folder: Path) -> Iterator[Case]:
    for index in range(count):
        rng = Random(f"workbook-{letter}-{index}")
        mutant = rng.choice(WORKBOOK_MUTATIONS[letter])(rng)
        yield mutant.kind, ".xlsx", mutant.data, partial(judge_sheet, mutant)


@pytest.mark.parametrize("letter", CLASSES)
@pytest.mark.parametrize(
    ("cases", "counts"),
    [
        pytest.param(texts, SHORT, id="texts"),
        pytest.param(workbooks, SHORT_WORKBOOKS, id="workbooks"),
        pytest.param(texts, LONG, id="many texts", marks=pytest.mark.slow),
        pytest.param(workbooks, LONG_WORKBOOKS, id="many workbooks", marks=pytest.mark.slow),
    ],
)
def test_mutants_are_read_right_or_refused(cases, counts, letter, tmp_path) -> None:
    count, bugs, outcomes = counts[letter], [], Counter()
    for index, (kind, suffix, data, judged) in enumerate(cases(letter, count, tmp_path)):
        path = put(tmp_path / f"mutant{suffix}", data)
        try:
            outcomes[judged(list(read_each(path)))] += 1
        except Exception as error:  # noqa: BLE001 - a traceback is looked for as well
            bugs.append(f"{letter}-{index} {kind}: {type(error).__name__}: {error}")
    assert not bugs, "\n".join(bugs[:40])
    assert outcomes["read"] + outcomes["flagged"] >= LEAST_READ * count
    assert outcomes["refused"] >= LEAST_REFUSED[letter] * count


CELLS = [
    "0", "1.5", "-2.25", "+3", ".5", "1e3", "1,5", "-2,25", "1,234.5", "1.234,5", "12,345,678.5",
    "12.345.678,5",
    "2,11,0828.5", "0,123.5", "1234,567.5", "1,234", "1.234",
    '"1"5', "1 234,5", "1 2", "", " 7 ", "x", "nan", "inf",
    "1e999", '""', '"', "1.5,000", "1\u00a0234,5", "1'234.5", "1_0", "0x1",
    "--1", "1e5,000.5",
]  # fmt: skip


@st.composite
def tables(draw):
    delimiter, decimal = draw(st.sampled_from([(",", "."), (";", ","), (";", "."), ("\t", "."), (",", ",")]))
    sound = ["1.5", "-2.25", "1000.125", "0.5"] if decimal == "." else ["1,5", "-2,25", "1000,125"]
    cell = st.sampled_from(sound * 6 + CELLS)
    quoting = draw(st.sampled_from(["all", "none", "some"]))
    lines = []
    for _ in range(draw(st.integers(1, 6))):
        row = draw(st.lists(cell, min_size=3, max_size=3))
        if draw(st.integers(0, 9)) == 0:
            row = row[:-1] if draw(st.booleans()) else [*row, "1"]
        quoted = [quoting == "all" or (quoting == "some" and draw(st.booleans())) for _ in row]
        lines.append(delimiter.join(f'"{c}"' if q else c for c, q in zip(row, quoted, strict=True)))
        if draw(st.integers(0, 9)) == 0:
            lines.append("")
    ending = draw(st.sampled_from(["\n", "\r\n"]))
    return delimiter, decimal, ending.join(lines) + ending


@settings(max_examples=1500, deadline=None)
@given(tables(), st.booleans())
def test_what_the_fast_path_reads_the_slow_reader_reads_alike(table, last_is_text):
    delimiter, decimal, lines = table
    empty = ("",) * 3
    numeric = (True, True, not last_is_text)
    layout = Layout(delimiter, decimal, (), empty, empty, False, None, 1, 0, 3, numeric)
    wanted = (0, 1) if last_is_text else (0, 1, 2)
    reader = RowReader(Text(lines.encode(), "utf-8", "utf-8"), layout, wanted, Place("x.csv"))
    fast = body._read_fast(reader)
    if fast is None:
        return
    try:
        slow, flags = reader.read()
    except InputError as error:
        pytest.fail(f"the fast path read {lines!r} as {fast}, the slow reader refuses it: {error}")
    assert not [flag for flag in flags if flag.code == "cut_row"]
    for quick, exact in zip(fast, slow, strict=True):
        np.testing.assert_array_equal(quick, exact)


@pytest.mark.parametrize("count", [1, 7, 8, 63, 64, 65, 1000])
def test_quotes_and_groups_are_taken_out_across_word_borders(count):
    rows = "".join(f'"1,{i % 1000:03d}.5","-{i}.25"\r\n' for i in range(count))
    expected = "".join(f"1{i % 1000:03d}.5,-{i}.25\r\n" for i in range(count))
    assert make_plain(rows.encode(), delimiter=",", decimal=".") == expected.encode()


def test_pieces_of_a_large_file_meet_without_a_seam(tmp_path, monkeypatch):
    monkeypatch.setattr(body, "_PIECE_BYTES", 1 << 12)
    lines = "".join(f'"{i},000.5";"{i}.5";"-{i}.25"\n' for i in range(1, 900))
    layout = Layout(";", ".", (), ("",) * 3, ("",) * 3, False, None, 1, 0, 3, (True,) * 3)
    fast = body._read_fast(RowReader(Text(lines.encode(), "ascii", "ascii"), layout, (0, 1, 2), Place("x")))
    assert fast is not None
    np.testing.assert_array_equal(fast[0], [i * 1000 + 0.5 for i in range(1, 900)])
    np.testing.assert_array_equal(fast[2], [-i - 0.25 for i in range(1, 900)])
