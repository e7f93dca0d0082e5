"""What a large cohort costs the process that asks: bytes and time a file, not a square of files."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from tissueid.cli.reading import PatternCheck
from tissueid.manifest import Entry, Study
from tissueid.result import Refusal
from tissueid.study.inventory import files_a_task
from tissueid.study.recordings import FileList, Named, StudyParts

FOLDER = Path(os.path.realpath("/")) / "cohort"


def names(count: int) -> list[str]:
    return [str(FOLDER / f"head-{number // 22:05d}" / f"hold-{number % 22}.csv") for number in range(count)]


def study(count: int) -> Study:
    """One table that names all files, one each for every second of them, and an exclusion."""
    files = tuple(names(count))
    trials = [Entry({"file": "*", "speed_mm_s": 4.0}, files, 1)]
    trials += [Entry({"file": one, "specimen": "s"}, (one,), 2) for one in files[::2]]
    return Study("study.toml", trials=tuple(trials), exclusions=(Entry({"because": "x"}, files[:1], 3),))


def test_a_list_of_files_gives_back_what_was_put_in():
    refusal = Refusal("b.csv", None, "no_recording", "nothing there")
    odd = Path(os.fsdecode(b"\xff\xc3\xa9.csv"))
    items: list[Named | Refusal] = [(Path("a.csv"), None), refusal, (Path("meat.xlsx"), "FF1A"), (odd, None)]
    found = FileList(items)
    assert list(found) == items
    assert len(found) == 4


def test_a_task_looks_into_many_short_recordings_or_a_few_long_ones():
    short, long = 4e3, 4e5
    assert files_a_task(220_000, short) == 64
    assert files_a_task(220_000, long) == 8
    # every worker has its share of a small cohort, and a file of unknown size may be long
    assert files_a_task(17 * 22, short) == 8
    assert files_a_task(2_000, short) == 20
    assert files_a_task(220_000, 0.0) == 8


def test_a_list_of_files_takes_little_more_than_their_paths():
    # in an interpreter of its own: memory of other tests and of their tracing is not that of the list
    code = (
        "import gc, tracemalloc\n"
        "from pathlib import Path\n"
        "from tissueid.study.recordings import FileList\n"
        f"files = {names(20_000)!r}\n"
        "FileList((Path(file), None) for file in files)\n"
        "gc.collect()\n"
        "tracemalloc.start()\n"
        "found = FileList((Path(file), None) for file in files)\n"
        "gc.collect()\n"
        # the interpreter's own table of interned strings may grow meanwhile, by a megabyte at once
        "own = tracemalloc.take_snapshot().filter_traces([tracemalloc.Filter(True, '*recordings.py')])\n"
        "held = sum(one.size for one in own.statistics('filename'))\n"
        "print(len(found), held, sum(map(len, files)))\n"
    )
    shown = subprocess.run([sys.executable, "-"], input=code, capture_output=True, text=True, check=True)
    count, held, length = map(int, shown.stdout.split())
    assert count == 20_000
    # 8 bytes of place, an eighth of room to grow in each of two arrays, and half as much again for safety
    assert held / count < 1.5 * (length / count + 8.0)


def test_a_part_of_a_study_decides_as_the_whole_of_it():
    whole = study(60)
    parts = StudyParts(whole)
    for file in names(62):
        assert parts.of_file(file).decision(file, None) == whole.decision(file, None)
    two = names(2)
    part = parts.of_specimen("s", [(file, None) for file in two])
    assert [entry.files for entry in part.trials] == [tuple(two), tuple(two[:1])]


def test_asking_of_every_file_costs_a_time_for_each_and_not_for_each_pair():
    def seconds(count: int) -> float:
        check = PatternCheck(r"head-\d+", study(count))
        begin = time.process_time()
        for file in names(count):
            check.add(file, None)
        return time.process_time() - begin

    seconds(100)
    # eight times the files: 8 times the time, or 64
    assert seconds(4_000) < 24.0 * seconds(500)
