"""Twenty thousand spoilt files: read as an independent reader reads them, flagged, or refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest
from fuzz_marks import MARKS
from fuzz_mutant import Mutant, Mutation, Tally, judge, original, remarks
from fuzz_seeds import seeds
from fuzz_structure import STRUCTURE
from fuzz_values import VALUES
from fuzz_workbooks import WORKBOOK_MUTATIONS, judge_workbook
from ingest_files import put

from tissueid.errors import InputError
from tissueid.ingest import read_each

CLASSES: dict[str, tuple[Mutation, ...]] = {"a": STRUCTURE, "b": VALUES, "c": MARKS}
NAMES = {"a": "structure", "b": "values", "c": "units and marks"}
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


def run(letter: str, count: int, folder: Path) -> Tally:
    """Judge the mutants of one class."""
    usual, tally = usual_flags(folder), Tally()
    for index in range(count):
        mutant = make(letter, index)
        path = put(folder / f"mutant{mutant.seed.suffix}", mutant.data)
        try:
            (item,) = read_each(path)
            outcome = judge(mutant, item, usual[mutant.seed.name])
        except Exception as error:  # noqa: BLE001 - a traceback is looked for as well
            what = f"{letter}-{index} {mutant.kind} of {mutant.seed.name!r}"
            tally.bugs.append(f"{what}: {type(error).__name__}: {error}")
        else:
            tally.outcomes[mutant.kind, outcome] += 1
    return tally


def run_workbooks(letter: str, count: int, folder: Path) -> Tally:
    """Judge workbook mutants of one class."""
    tally, path = Tally(), folder / "mutant.xlsx"
    for index in range(count):
        rng = Random(f"workbook-{letter}-{index}")
        mutant = rng.choice(WORKBOOK_MUTATIONS[letter])(rng)
        path.write_bytes(mutant.data)
        try:
            outcome = judge_workbook(mutant, list(read_each(path)))
        except Exception as error:  # noqa: BLE001 - a traceback is what is looked for
            tally.bugs.append(f"{letter}-{index} {mutant.kind}: {type(error).__name__}: {error}")
        else:
            tally.outcomes[mutant.kind, outcome] += 1
    return tally


@pytest.mark.parametrize("letter", CLASSES)
@pytest.mark.parametrize(
    ("judged", "counts"),
    [
        pytest.param(run, SHORT, id="texts"),
        pytest.param(run_workbooks, SHORT_WORKBOOKS, id="workbooks"),
        pytest.param(run, LONG, id="many texts", marks=pytest.mark.slow),
        pytest.param(run_workbooks, LONG_WORKBOOKS, id="many workbooks", marks=pytest.mark.slow),
    ],
)
def test_mutants_are_read_right_or_refused(
    judged: Callable[[str, int, Path], Tally], counts: dict[str, int], letter: str, tmp_path: Path
) -> None:
    count = counts[letter]
    tally = judged(letter, count, tmp_path)
    read, flagged, refused = (tally.count(o) for o in ("read", "flagged", "refused"))
    told = f"{count} mutants, {read} read, {flagged} flagged, {refused} refused"
    print(f"\nclass ({letter}) {NAMES[letter]}: {told}\n{tally.table()}")  # noqa: T201
    assert not tally.bugs, "\n".join(tally.bugs[:40])
    assert read + flagged >= LEAST_READ * count
    assert refused >= LEAST_REFUSED[letter] * count
