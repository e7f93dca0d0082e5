"""Tasks in processes of this machine: whatever happens to one, the others end well."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator

import pytest

from tissueid.study.tasks import InThisProcess, LocalProcesses, Outcome, Task

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by SIGKILL")


def task(number: int, name: str, payload: bytes = b"ab") -> Task:
    return Task(number, f"cohort_lab:{name}", payload)


def outcomes(tasks: list[Task], workers: int = 2) -> dict[int, Outcome]:
    with LocalProcesses(workers) as crew:
        return {one.number: one for one in crew.run(tasks, lambda *_: None)}


def test_a_task_that_kills_its_process_twice_is_named_and_the_others_end_well():
    found = outcomes([task(0, "killed"), *(task(number, "doubled") for number in range(1, 6))])
    assert [found[number].result for number in range(1, 6)] == [b"abab"] * 5
    fault = found[0].fault
    assert fault is not None
    assert fault.code == "worker_killed"
    assert "died 2 times (signal 9, SIGKILL)" in fault.message
    assert "memory" in fault.message


def test_a_task_whose_process_died_once_is_computed_in_another(tmp_path):
    found = outcomes([task(0, "killed_once", str(tmp_path / "mark").encode())], workers=1)
    assert found[0].result == b"second time"
    assert found[0].fault is None


def test_errors_are_faults_of_their_task_alone():
    tasks = [task(0, "out_of_memory"), task(1, "with_a_bug"), task(2, "doubled")]
    here = {one.number: one for one in InThisProcess().run(tasks, lambda *_: None)}
    for found in (outcomes(tasks), here):
        codes = [fault.code if (fault := found[n].fault) else None for n in range(3)]
        assert codes == ["out_of_memory", "job_failed", None]
        assert "IndexError" in str(found[1].fault)
        assert found[2].result == b"abab"


def test_every_task_is_taken_when_somebody_is_free_for_it_and_not_before():
    taken: list[int] = []

    def tasks() -> Iterator[Task]:
        for number in range(9):
            taken.append(number)
            yield task(number, "doubled")

    with LocalProcesses(2) as crew:
        ahead = [len(taken) - done for done, _ in enumerate(crew.run(tasks(), lambda *_: None), 1)]
    assert len(ahead) == 9
    # two are computed while a third has just been handed over
    assert max(ahead) <= 3


def test_a_worker_and_who_was_asked_for_one_take_one_processor():
    asked = task(0, "threads_there")
    (one,) = InThisProcess(one=True).run([asked], lambda *_: None)
    (free,) = InThisProcess().run([asked], lambda *_: None)
    expected = str(min(os.cpu_count() or 1, 7)).encode()
    assert (one.result, outcomes([asked])[0].result, free.result) == (b"1", b"1", expected)
