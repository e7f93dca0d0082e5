"""A cohort on Dask finds what this process finds, through lost workers and schedulers."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from cohort_lab import numbers_of, write_cohort
from command_line import QUICK, REPOSITORY, run
from study_folder import SAMPLED

from tissueid.errors import BundleError, UsageError
from tissueid.store.index import read_status
from tissueid.study import cluster
from tissueid.study.cluster import DaskWorkers
from tissueid.study.tasks import Task, versions

pytest.importorskip("distributed", reason="Dask is not installed: pip install 'tissueid[cluster]'")

PATIENCE_S = 120.0


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def dask(*args: str) -> subprocess.Popen[bytes]:
    """A process of the cluster, which finds tissueid and the tasks of these tests."""
    paths = os.pathsep.join(map(str, (REPOSITORY, REPOSITORY / "tests", Path(__file__).parent)))
    words = [sys.executable, "-m", "dask", *args, "--no-dashboard"]
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(words, start_new_session=True, env=os.environ | {"PYTHONPATH": paths}, **silent)


def scheduler(port: int) -> subprocess.Popen[bytes]:
    return dask("scheduler", "--host", "127.0.0.1", "--port", str(port))


def worker(address: str) -> subprocess.Popen[bytes]:
    return dask("worker", address, "--nthreads", "1", "--no-nanny", "--death-timeout", "60")


def end(*processes: subprocess.Popen[bytes]) -> None:
    for process in processes:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(PATIENCE_S)


def when_done(out: Path, number: int, disturb: Callable[[], object]) -> threading.Thread:
    """A thread, begun, that disturbs a run once so many specimens are done."""

    def wait() -> None:
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            with contextlib.suppress(BundleError):
                if read_status(out)["specimens"]["done"] >= number:
                    break
            time.sleep(0.02)
        disturb()

    thread = threading.Thread(target=wait)
    thread.start()
    return thread


@pytest.fixture
def address():
    """A scheduler with one worker, in processes of their own."""
    port = free_port()
    found = f"tcp://127.0.0.1:{port}"
    processes = [scheduler(port), worker(found)]
    yield found
    end(*processes)


def test_tasks_on_a_cluster_end_well_and_badly_as_here_and_other_versions_are_refused(address):
    tasks = [Task(number, "cohort_lab:doubled", bytes([number])) for number in range(9)]
    tasks.append(Task(9, "cohort_lab:with_a_bug", b""))
    with DaskWorkers(address) as crew:
        found = {one.number: one for one in crew.run(tasks, lambda *_: None)}
    assert [found[number].result for number in range(9)] == [bytes([number]) * 2 for number in range(9)]
    fault = found[9].fault
    assert fault.code == "job_failed"
    other = DaskWorkers(address)
    other._versions = versions() | {"numpy": "1.0"}
    with pytest.raises(UsageError, match=r"other versions: tcp://.*numpy .* \(here 1.0\)"):
        other.__enter__()


def test_an_address_without_a_scheduler_is_refused_with_the_way_out(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)
    with pytest.raises(UsageError, match="dask scheduler"):
        DaskWorkers(f"tcp://127.0.0.1:{free_port()}").__enter__()
    with pytest.raises(UsageError, match="tcp://HOST:8786"):
        DaskWorkers("localhost:8786")


@pytest.mark.slow
def test_posteriors_of_one_process_of_two_and_of_a_cluster_are_the_same_bits(address, tmp_path):
    lab = write_cohort(tmp_path / "lab", 3)
    ways = {"one": ("--workers", "1"), "two": ("--workers", "2"), "cluster": ("--scheduler", address)}
    for out, way in ways.items():
        run("fit", lab, "-o", tmp_path / out, *SAMPLED, "-q", *way, code={0, 4})
    one = numbers_of(tmp_path / "one")
    assert [entry["sampler"]["name"] for entry in one["document"]["specimens"]] == ["emcee"] * 3
    assert numbers_of(tmp_path / "two") == one
    assert numbers_of(tmp_path / "cluster") == one


@pytest.mark.slow
@pytest.mark.parametrize("lost", ["worker", "scheduler"])
def test_a_cluster_that_loses_a_part_goes_on_when_it_is_back(tmp_path, lost):
    lab = write_cohort(tmp_path / "lab", 6)
    run("fit", lab, "-o", tmp_path / "here", *QUICK, "-q", code={0, 4})
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    processes = [scheduler(port), worker(address), worker(address)]

    def disturb() -> None:
        if lost == "worker":
            end(processes[1])
        else:
            end(*processes)
            processes[:] = [scheduler(port), worker(address), worker(address)]

    thread = when_done(tmp_path / "there", 1, disturb)
    try:
        run("fit", lab, "-o", tmp_path / "there", *QUICK, "-q", "--scheduler", address, code={0, 4})
        thread.join()
    finally:
        end(*processes)
    assert numbers_of(tmp_path / "there") == numbers_of(tmp_path / "here")


@pytest.mark.slow
def test_a_scheduler_that_stays_away_ends_the_run_with_what_is_finished_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "RECONNECT_S", 0.2)
    lab = write_cohort(tmp_path / "lab", 6)
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    processes = [scheduler(port), worker(address)]
    out = tmp_path / "out"
    thread = when_done(out, 2, lambda: end(*processes))
    fit = ("fit", lab, "-o", out, *QUICK, "-q")
    run(*fit, "--scheduler", address, code=6, said="what was finished is kept")
    thread.join()
    run(*fit, code={0, 4})
    assert read_status(out)["specimens"]["known_before"] >= 2
