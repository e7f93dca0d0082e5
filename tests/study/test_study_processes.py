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


def test_whatever_a_task_does_is_its_own_fault_and_the_others_end_well(tmp_path):
    mark = str(tmp_path / "mark").encode()
    ends = ("doubled", "out_of_memory", "with_a_bug", "killed", "doubled", "threads_there")
    tasks = [*(task(number, name) for number, name in enumerate(ends)), task(6, "killed_once", mark)]
    found = outcomes(tasks)
    here = {one.number: one for one in InThisProcess().run(tasks[:3], lambda *_: None)}
    codes = ("", "out_of_memory", "job_failed", "worker_killed", "", "", "")
    for each in (found, here):
        assert [each[n].fault.code if each[n].fault else "" for n in sorted(each)] == list(codes[: len(each)])
        assert "IndexError" in str(each[2].fault)
        assert each[0].result == b"abab"
    assert (found[4].result, found[6].result) == (b"abab", b"second time")
    assert "died 2 times (signal 9, SIGKILL)" in found[3].fault.message
    assert "memory" in found[3].fault.message
    # a worker takes one processor, and so does who is asked to
    one, free = (next(InThisProcess(one=one).run(tasks[5:6], lambda *_: None)) for one in (True, False))
    assert found[5].result == one.result == b"1"
    assert free.result == str(min(os.cpu_count() or 1, 7)).encode()


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
