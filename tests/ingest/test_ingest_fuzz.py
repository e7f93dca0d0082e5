"""Twenty thousand spoilt files: read as an independent reader reads them, flagged, or refused."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest
from fuzz_marks import MARKS
from fuzz_mutant import Mutant, Mutation, Tally, WrongError, judge, original, remarks
from fuzz_seeds import seeds
from fuzz_structure import STRUCTURE
from fuzz_values import VALUES
from fuzz_workbooks import WORKBOOK_MUTATIONS, judge_workbook

from tissueid.errors import InputError
from tissueid.ingest import read_each

CLASSES: dict[str, tuple[Mutation, ...]] = {"a": STRUCTURE, "b": VALUES, "c": MARKS}
NAMES = {"a": "structure", "b": "values", "c": "units and marks"}
#: Mutants of each class: 500 by default, 20,000 in all with the slow run.
SHORT = {"a": 200, "b": 150, "c": 150}
LONG = {"a": 8000, "b": 6000, "c": 6000}
#: Shares of the issue: a reader that refuses all, or reads all, proves nothing.
LEAST_READ = {"a": 0.05, "b": 0.05, "c": 0.05}
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
        path = folder / f"seed{seed.suffix}"
        path.write_bytes(seed.data)
        (trial,) = read_each(path)
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
        path = folder / f"mutant{mutant.seed.suffix}"
        path.write_bytes(mutant.data)
        try:
            (item,) = read_each(path)
            outcome = judge(mutant, item, usual[mutant.seed.name])
        except WrongError as error:
            tally.bugs.append(f"{letter}-{index} {mutant.kind} of {mutant.seed.name!r}: {error}")
        except Exception as error:  # noqa: BLE001 - a traceback is what is looked for
            tally.bugs.append(
                f"{letter}-{index} {mutant.kind} of {mutant.seed.name!r}: {type(error).__name__}: {error}"
            )
        else:
            tally.outcomes[mutant.kind, outcome] += 1
    return tally


def shares(letter: str, count: int, tally: Tally, what: str = "") -> tuple[str, float, float]:
    """Print the counts; what was misread, and the shares that were read and refused."""
    read, flagged, refused = (tally.count(o) for o in ("read", "flagged", "refused"))
    counts = f"{count} mutants, {read} read, {flagged} flagged, {refused} refused"
    print(f"\nclass ({letter}) {what}{NAMES[letter]}: {counts}\n{tally.table()}")  # noqa: T201
    return "\n".join(tally.bugs[:40]), (read + flagged) / count, refused / count


@pytest.mark.parametrize("letter", CLASSES)
def test_five_hundred_mutants_are_read_right_or_refused(letter: str, tmp_path: Path) -> None:
    misread, read, refused = shares(letter, SHORT[letter], run(letter, SHORT[letter], tmp_path))
    assert misread == ""
    assert read >= LEAST_READ[letter]
    assert refused >= LEAST_REFUSED[letter]


@pytest.mark.slow
@pytest.mark.parametrize("letter", CLASSES)
def test_twenty_thousand_mutants_are_read_right_or_refused(letter: str, tmp_path: Path) -> None:
    misread, read, refused = shares(letter, LONG[letter], run(letter, LONG[letter], tmp_path))
    assert misread == ""
    assert read >= LEAST_READ[letter]
    assert refused >= LEAST_REFUSED[letter]


#: Workbook mutants of each class, in the short and the slow run.
SHORT_WORKBOOKS, LONG_WORKBOOKS = 40, 700


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
def test_workbook_mutants_are_read_right_or_refused(letter: str, tmp_path: Path) -> None:
    misread, read, refused = shares(
        letter, SHORT_WORKBOOKS, run_workbooks(letter, SHORT_WORKBOOKS, tmp_path), "workbooks, "
    )
    assert misread == ""
    assert read >= LEAST_READ[letter]
    assert refused >= LEAST_REFUSED[letter]


@pytest.mark.slow
@pytest.mark.parametrize("letter", CLASSES)
def test_two_thousand_workbook_mutants_are_read_right_or_refused(letter: str, tmp_path: Path) -> None:
    misread, read, refused = shares(
        letter, LONG_WORKBOOKS, run_workbooks(letter, LONG_WORKBOOKS, tmp_path), "workbooks, "
    )
    assert misread == ""
    assert read >= LEAST_READ[letter]
    assert refused >= LEAST_REFUSED[letter]
