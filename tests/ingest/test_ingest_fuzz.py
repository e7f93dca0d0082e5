"""Twenty thousand spoilt files: read as an independent reader reads them, flagged, or refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from random import Random

import pytest
from fuzz_mutant import Mutant, Mutation, Outcome, judge, judge_parts, original, remarks
from fuzz_seeds import seeds
from fuzz_structure import STRUCTURE
from fuzz_values import MARKS, VALUES
from fuzz_workbooks import WORKBOOK_MUTATIONS, WorkbookMutant, judge_workbook
from ingest_files import put

from tissueid.errors import InputError
from tissueid.ingest import read_each
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
    """What is said of each sound seed, which reads as the oracle reads it."""
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
def test_mutants_are_read_right_or_refused(
    cases: Callable[[str, int, Path], Iterator[Case]], counts: dict[str, int], letter: str, tmp_path: Path
) -> None:
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
