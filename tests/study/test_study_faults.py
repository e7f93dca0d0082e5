"""Killed at any moment, a run over several processes is resumed by the same command, and ends the same.

Tasks in processes of this machine: whatever happens to one, the others end well.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cohort_lab import numbers_of, write_cohort
from command_line import QUICK, run, start, until

from tissueid.errors import BundleError
from tissueid.store.index import read_status
from tissueid.study.tasks import InThisProcess, LocalProcesses, Outcome, Task

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by SIGKILL")

SPECIMENS = 4
PATIENCE_S = 300.0


def started(lab: Path, out: Path) -> subprocess.Popen[str]:
    """The fit by two processes, in a group of its own so that all of it can be killed."""
    return start("fit", lab, "-o", out, *QUICK, "-q", "--workers", "2", start_new_session=True)


def fitted(lab: Path, out: Path) -> Any:
    run("fit", lab, "-o", out, *QUICK, "-q", code={0, 4})
    return numbers_of(out)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A cohort, and what a run that nothing disturbs finds."""
    folder = tmp_path_factory.mktemp("undisturbed")
    lab = write_cohort(folder / "lab", SPECIMENS)
    return lab, fitted(lab, folder / "out")


def progress_of(out: Path) -> Any:
    try:
        return read_status(out)
    except BundleError:
        return None


def wait_for(out: Path, process: subprocess.Popen[str], *, done: int) -> Any:
    """The status once so many specimens are done and another is running; ``None`` where the run has ended."""
    end = time.monotonic() + PATIENCE_S
    while process.poll() is None and time.monotonic() < end:
        status = progress_of(out) if out.is_dir() else None
        if status is not None and status["running"] and status["specimens"]["done"] >= done:
            return status
        time.sleep(0.01)
    return None


def kill_workers(status: Any) -> list[int]:
    """Kill one process that computes; which ones were there."""
    pids = [int(row["worker"].split()[1]) for row in (status or {}).get("running", [])]
    if pids:
        os.kill(pids[0], signal.SIGKILL)
    return pids


def test_a_run_that_loses_worker_client_and_everything_in_turn_ends_as_if_nothing_had_been(
    undisturbed, tmp_path
):
    lab, expected = undisturbed
    out = tmp_path / "out"
    with started(lab, out) as process:
        assert kill_workers(wait_for(out, process, done=0))
        run("fit", lab, "-o", out, *QUICK, "-q", code=6, said=f"process {process.pid} on")
        assert run("status", out, "--json", code=0).json()["specimens"]["total"] == SPECIMENS
        status = wait_for(out, process, done=1)
        process.kill()
    pids = [int(row["worker"].split()[1]) for row in status["running"]]
    # a worker does not outlive who it works for
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids), seconds=10.0)
    assert read_status(out)["state"] == "stopped"
    with started(lab, out) as process:
        assert wait_for(out, process, done=2) is not None
        os.killpg(process.pid, signal.SIGKILL)
    assert not (out / "identification.json").exists()
    assert fitted(lab, out) == expected
    assert read_status(out)["specimens"]["known_before"] >= 2
    run("validate", out, code=0)


@pytest.mark.slow
@pytest.mark.parametrize("who", ["worker", "client", "everything"])
def test_kills_at_twenty_random_moments(undisturbed, tmp_path, who):
    lab, expected = undisturbed
    rng = np.random.default_rng([23, len(who)])
    begin = time.monotonic()
    with started(lab, tmp_path / "timed") as process:
        assert process.wait(PATIENCE_S) in (0, 4)
    seconds = time.monotonic() - begin
    runs, killed, same = 0, 0, 0
    while killed < 20 and runs < 60:
        out = tmp_path / str(runs)
        runs += 1
        with started(lab, out) as process:
            time.sleep(seconds * float(rng.uniform(0.2, 1.0)))
            # a run that ended before its moment came is none of the twenty
            if who == "worker":
                killed += bool(kill_workers(progress_of(out) if out.is_dir() else None))
                assert process.wait(PATIENCE_S) in (0, 4)
            elif process.poll() is None:
                killed += 1
                process.kill() if who == "client" else os.killpg(process.pid, signal.SIGKILL)
        same += fitted(lab, out) == expected
        assert not list(out.rglob(".tmp-*"))
    assert same == runs
    assert killed == 20


@pytest.mark.slow
def test_ctrl_c_ends_in_one_line_and_the_same_command_goes_on(undisturbed, tmp_path):
    lab, expected = undisturbed
    out = tmp_path / "out"
    with started(lab, out) as process:
        assert wait_for(out, process, done=1) is not None
        # as a terminal does: to the whole group
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert errors.strip() == "tissueid: interrupted; what was finished is kept"
    assert read_status(out)["state"] == "interrupted"
    assert fitted(lab, out) == expected


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
